"""Shape servoing measured: features, laws and goals, from the camera and from the true points, on the same episodes."""
