"""A deployment with the parts of `cell_parts`, and a controller with constant actions."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from cell_parts import HEIGHT, ROPE, WIDTH, ListRobot, RopeSource

from shape_obs import ShapeObservation
from shape_obs.deploy import Limits

PATIENT = Limits(max_age=9.0, watchdog=9.0)  # no delay of a busy machine holds an action back


def cell(robot=None, source=None, rate=50.0, **options) -> Any:
    robot = robot or ListRobot()
    source = source or RopeSource(robot)
    env = gym.make(
        "shape_obs_envs:ShapeObs/D455-v0",
        source=source,
        robot=robot,
        rate=rate,
        size=[WIDTH, HEIGHT],
        timeout=0.2,
        disable_env_checker=True,
        **options,
    )
    return ShapeObservation(env, **ROPE), robot, source


class Always:
    """A controller with a constant action; `at` maps steps to functions that replace it."""

    def __init__(self, at=None):
        self._at, self._step = at or {}, -1

    def act(self, observation):
        self._step += 1
        if self._step in self._at:
            return self._at[self._step]()
        return np.array([1.0, 0.0])
