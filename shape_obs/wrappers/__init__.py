"""Gymnasium wrappers."""

from shape_obs.wrappers.shape_observation import ShapeObservation

__all__ = ["ShapeObservation"]
