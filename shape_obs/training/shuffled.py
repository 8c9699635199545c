"""Shuffled: points without their order, as a control."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs

from shape_obs.wrappers.env_protocol import GOALS

Vector = npt.NDArray[np.float32]


class Shuffled(gym.ObservationWrapper[Any, Any, Any], RecordConstructorArgs):
    """Shows the points of a goal-conditioned env in another order in every frame, as an unordered clustering would.

    ``observation`` and the first ``visible`` numbers of the two goals, all that a policy may read of them, are the
    points, seen and desired, shuffled apart; the points in their order follow them for the reward.

    Args:
        env: Goal-conditioned, goals of flat points (x, y, z).

    Attributes:
        visible: How many numbers of a goal a policy may read.

    Raises:
        ValueError: The env has no such goals.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        RecordConstructorArgs.__init__(self)
        gym.ObservationWrapper.__init__(self, env)
        space = env.observation_space
        if not isinstance(space, spaces.Dict) or not all(key in space.spaces for key in GOALS):
            raise ValueError(f"Shuffled needs an environment with goals, got the observation space {space}.")
        points = space["desired_goal"]
        if not isinstance(points, spaces.Box) or len(points.shape) != 1 or points.shape[0] % 3:
            raise ValueError(f"Shuffled needs goals of flat points (x, y, z), got {points}.")
        # One box for all points: each of them may stand anywhere.
        low, high = points.low.reshape(-1, 3), points.high.reshape(-1, 3)
        anywhere = np.tile(low.min(axis=0), len(low)), np.tile(high.max(axis=0), len(high))
        self.visible = points.shape[0]
        goal = spaces.Box(
            np.concatenate([anywhere[0], points.low]), np.concatenate([anywhere[1], points.high]), dtype=np.float32
        )
        seen = spaces.Box(*anywhere, dtype=np.float32)
        self.observation_space = spaces.Dict({"observation": seen, **dict.fromkeys(GOALS, goal)})
        self._rng = np.random.default_rng()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the env; a seed starts the shuffling anew."""
        if seed is not None:
            self._rng = np.random.default_rng(seed)
        return super().reset(seed=seed, options=options)

    def observation(self, observation: Any) -> dict[str, Any]:
        """Points in another order, then in theirs."""
        achieved, desired = (np.asarray(observation[key], np.float32) for key in GOALS)
        seen, wanted = self._shuffle(achieved), self._shuffle(desired)
        return {
            "observation": seen,
            "achieved_goal": np.concatenate([seen, achieved]),
            "desired_goal": np.concatenate([wanted, desired]),
        }

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """The env's own, of the points in their order."""
        achieved, desired = (np.asarray(goal)[..., self.visible :] for goal in (achieved_goal, desired_goal))
        return self.env.get_wrapper_attr("compute_reward")(achieved, desired, info)

    def _shuffle(self, points: Vector) -> Vector:
        return self._rng.permutation(points.reshape(-1, 3)).ravel()
