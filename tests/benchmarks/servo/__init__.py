"""Compare features and laws of shape servoing on simulated objects."""
