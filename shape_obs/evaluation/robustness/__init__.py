"""Faults, attacks and kills: what must hold whatever happens, measured by ``shape-obs bench claims --only robustness``."""
