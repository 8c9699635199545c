"""Gymnasium wrappers."""

from shape_obs.wrappers.shape_goal import ShapeGoal, record_goal
from shape_obs.wrappers.shape_observation import ShapeObservation
from shape_obs.wrappers.target import Target

__all__ = ["ShapeGoal", "ShapeObservation", "Target", "record_goal"]
