"""Name the actions and the state of an environment, and flatten them for recordings."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from shape_obs.recording import RobotInfo
from shape_obs.recording.transition import plain
from shape_obs.wrappers import env_protocol


class EnvSteps:
    """Flatten the actions and states of an environment.

    The state consists of the vectors of a Dict observation, such as the poses of grippers or joint angles, in the order
    of the keys. Images and goals are left out: achieved goals hold the true shape, which no robot knows.

    Args:
        env: The environment.
        name: Name of the environment.

    Attributes:
        info: Names of the values. Actions have the names of the environment's ``action_spec`` if it publishes one,
            and so has the entry ``robot`` of an observation.
    """

    def __init__(self, env: gym.Env[Any, Any], name: str) -> None:
        self._space, seen = env.action_space, env.observation_space
        entries = seen.spaces.items() if isinstance(seen, spaces.Dict) else ()
        vectors = {key: space for key, space in entries if isinstance(space, spaces.Box) and len(space.shape) < 2}
        self._keys = {key: spaces.flatdim(box) for key, box in vectors.items() if key not in env_protocol.GOALS}
        spec = env_protocol.published(env, "action_spec")
        if spec is None:
            spec = getattr(env_protocol.published(env, "robot"), "action_spec", None)
        size = 1 if isinstance(self._space, spaces.Discrete) else spaces.flatdim(self._space)
        self.info = RobotInfo(
            name,
            spec.names if spec is not None and len(spec) == size else _names("action", size),
            tuple(
                label
                for key, count in self._keys.items()
                for label in (
                    spec.names if key == "robot" and spec is not None and len(spec) == count else _names(key, count)
                )
            ),
            spec,
        )

    def action(self, action: Any) -> tuple[float, ...]:
        """Return an action as numbers ``(A,)``; that of a discrete space is its index."""
        if isinstance(self._space, spaces.Discrete):
            return (float(action),)
        return plain(np.asarray(spaces.flatten(self._space, action)).ravel())

    def state(self, observation: Any) -> tuple[float, ...] | None:
        """Return the state ``(S,)`` in an observation; None if it has no vectors."""
        if not self._keys:
            return None
        return plain(np.concatenate([np.ravel(observation[key]) for key in self._keys]))


def _names(key: str, count: int) -> tuple[str, ...]:
    return (key,) if count == 1 else tuple(f"{key}/{i}" for i in range(count))
