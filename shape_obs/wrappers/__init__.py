"""Gymnasium wrappers."""

from shape_obs.wrappers.shape_goal import ShapeGoal
from shape_obs.wrappers.shape_observation import ShapeObservation
from shape_obs.wrappers.target import Target, record_goal, record_goals

__all__ = ["ShapeGoal", "ShapeObservation", "Target", "record_goal", "record_goals"]
