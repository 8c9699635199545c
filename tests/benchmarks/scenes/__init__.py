"""Draw photos, motions and tables with known truth."""
