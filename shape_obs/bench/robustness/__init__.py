"""Measure what must hold under faults, attacks and kills: ``shape-obs bench claims --only robustness``."""
