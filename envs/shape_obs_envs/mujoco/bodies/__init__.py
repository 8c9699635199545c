"""The deformable objects: their MJCF, their state and their true shape."""
