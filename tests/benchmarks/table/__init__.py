"""Reproduce the paper's table and figure: clusterers side by side on the same frames."""
