"""Where the nodes start when there is no previous frame."""
