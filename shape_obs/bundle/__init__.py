"""Bundles: a trained policy with all that it takes to run it elsewhere."""
