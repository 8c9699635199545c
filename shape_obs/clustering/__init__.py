"""Clusterers: samples and a start -> centres, one file each."""
