"""The real robot as an environment: an RGB-D source observes, a robot acts; registered as ``ShapeObs/D455-v0``."""

from __future__ import annotations

from shape_obs_envs.real.env import D455Env

__all__ = ["D455Env"]
