"""Ground truth and scores: what the tests and ``shape-obs bench`` measure with."""
