"""Command lines of the measurements."""
