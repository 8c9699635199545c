"""What ``shape-obs bench`` measures on the user's machine, and a generator of scenes whose truth is known."""
