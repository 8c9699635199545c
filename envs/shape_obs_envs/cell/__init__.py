"""The real cell: an RGB-D source that looks and a robot that moves, as the environment `ShapeObs/D455-v0`."""

from __future__ import annotations

from shape_obs_envs.cell.env import D455Env

__all__ = ["D455Env"]
