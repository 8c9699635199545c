"""PointReward: goals in any features, scored in metres."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs

from shape_obs.features import Points3D
from shape_obs.wrappers import ShapeGoal
from shape_obs.wrappers.env_protocol import GOALS
from shape_obs.wrappers.shape_goal import RewardType


class PointReward(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Over a ``ShapeGoal`` whose last feature is ``points3d``: a policy reads the others, the reward is of the points.

    Rewards in different features cannot be compared, nor the policies that follow them. Here every policy gets the
    reward of the env itself, of the points that the camera saw and the goal's, whatever features it reads; hindsight
    replay puts both in together. ``observation`` are the features of the seen shape without the points; the first
    ``visible`` numbers of the two goals are theirs, and all that a policy may read of them (``GoalDifference``).

    ``info`` has ``goal/distance`` [m], and ``is_success`` by it: below the threshold, and the shape is ok.

    Args:
        env: An environment in ``ShapeObservation`` and ``ShapeGoal``.
        reward_type: ``"sparse"``: 0 where the mean distance of corresponding points is below the threshold, else -1.
            ``"dense"``: minus that distance [m].
        threshold: Metres.

    Attributes:
        visible: How many numbers of a goal a policy may read.

    Raises:
        ValueError: The last feature of the goals are not points in metres, or the only ones; or another argument is
            not understood.
    """

    def __init__(self, env: ShapeGoal, reward_type: RewardType = "sparse", threshold: float = 0.01) -> None:
        if reward_type not in ("dense", "sparse") or not 0 < threshold < np.inf:
            raise ValueError(
                f"expected reward_type 'dense' or 'sparse' and a threshold above 0 m, got {reward_type!r}, {threshold}."
            )
        RecordConstructorArgs.__init__(self, reward_type=reward_type, threshold=float(threshold))
        gym.Wrapper.__init__(self, env)
        self.reward_type, self.threshold = reward_type, float(threshold)
        *features, last = env.goal_features
        if not isinstance(last, Points3D) or not features:
            kinds = [feature.kind for feature in env.goal_features]
            raise ValueError(f"PointReward needs goals in some features and 'points3d' after them, got {kinds}.")
        goal = env.observation_space["desired_goal"]  # type: ignore[index]
        assert isinstance(goal, spaces.Box)
        self.visible = goal.shape[0] - 3 * env.goal_configuration.layout.size
        seen = spaces.Box(goal.low[: self.visible], goal.high[: self.visible], dtype=np.float32)
        self.observation_space = spaces.Dict({"observation": seen, **dict.fromkeys(GOALS, goal)})

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the env."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._observe(observation, info), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the env; the reward is that of the points."""
        observation, _, terminated, truncated, info = self.env.step(action)
        seen = self._observe(observation, info)
        reward = self.compute_reward(seen["achieved_goal"], seen["desired_goal"], info)
        return seen, reward, terminated, truncated, info

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """The reward of the points in goals (..., D): a float for single ones, else (...,). ``info`` is not used."""
        distance = self._distance(achieved_goal, desired_goal)
        reward = -distance if self.reward_type == "dense" else np.where(distance < self.threshold, 0.0, -1.0)
        return float(reward) if reward.ndim == 0 else reward

    def _distance(self, achieved_goal: Any, desired_goal: Any) -> npt.NDArray[np.float64]:
        apart = np.asarray(achieved_goal, np.float64) - np.asarray(desired_goal, np.float64)
        points = apart[..., self.visible :].reshape(*apart.shape[:-1], -1, 3)
        return np.linalg.norm(points, axis=-1).mean(axis=-1)

    def _observe(self, observation: Any, info: dict[str, Any]) -> dict[str, Any]:
        goals = {key: observation[key] for key in GOALS}
        info["goal/distance"] = float(self._distance(*goals.values()))
        info["is_success"] = info["goal/distance"] < self.threshold and bool(info["shape/ok"])
        return {"observation": goals["achieved_goal"][: self.visible].copy(), **goals}
