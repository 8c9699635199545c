"""Knots of ropes, from the crossings of their curves in the image."""

from shape_obs.geometry.knots.decision import are_hooked, is_knotted, lifts_off, reduced_code

__all__ = ["are_hooked", "is_knotted", "lifts_off", "reduced_code"]
