"""Follow a shape from frame to frame: prediction, matching, occlusion, validation, missing data."""
