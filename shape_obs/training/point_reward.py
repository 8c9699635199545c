"""Reward policies that read any features by the distance of points in metres."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs

from shape_obs.features import Points3D
from shape_obs.utils.lengths import warn_unless_metres
from shape_obs.wrappers import ShapeGoal
from shape_obs.wrappers.env_protocol import GOALS
from shape_obs.wrappers.shape_goal import RewardType


class PointReward(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Compute the reward from the points of a ``ShapeGoal``, while the policy reads its other features.

    Rewards in different features cannot be compared, nor can the policies that maximise them. With this wrapper, every
    policy gets the reward of the environment, the distance of the detected points from those of the goal, for any
    features that it reads. The last feature of the ``ShapeGoal`` must be ``points3d``. ``observation`` holds the
    features of the detected shape without the points. The first ``visible`` numbers of the goals are these features,
    and a policy may read no others (see ``GoalDifference``); hindsight replay replaces features and points together.

    ``info`` has ``goal/distance`` in metres, and ``is_success``: the distance is below the threshold, and the shape is
    ok.

    Args:
        env: An environment in ``ShapeObservation`` and ``ShapeGoal``.
        reward_type: ``"sparse"``: 0 if the mean distance of corresponding points is below the threshold, else -1.
            ``"dense"``: the negative distance in metres.
        threshold: Threshold in metres.

    Attributes:
        visible: How many numbers of a goal a policy may read.

    Raises:
        ValueError: The last feature of the goals is not points in metres, or is the only one; several shapes have a
            goal; or another argument is invalid.
    """

    visible: int

    def __init__(self, env: ShapeGoal, reward_type: RewardType = "sparse", threshold: float = 0.01) -> None:
        if reward_type not in ("dense", "sparse") or not 0 < threshold < np.inf:
            raise ValueError(
                f"expected reward_type 'dense' or 'sparse' and a threshold above 0 m, got {reward_type!r}, {threshold}."
            )
        warn_unless_metres("PointReward: threshold", threshold, most=1.0)
        RecordConstructorArgs.__init__(self, reward_type=reward_type, threshold=float(threshold))
        gym.Wrapper.__init__(self, env)
        self.reward_type, self.threshold = reward_type, float(threshold)
        *features, last = env.goal_features
        if not isinstance(last, Points3D) or not features:
            kinds = [feature.kind for feature in env.goal_features]
            raise ValueError(f"PointReward needs goals in some features and 'points3d' after them, got {kinds}.")
        if len(env.names) > 1:
            raise ValueError(
                f"PointReward needs the goal of one shape, got {list(env.names)}; pass ShapeGoal a shape=."
            )
        goal = env.observation_space["desired_goal"]  # type: ignore[index]
        assert isinstance(goal, spaces.Box)
        self.visible = goal.shape[0] - 3 * env.goal_configurations[0].layout.size
        seen = spaces.Box(goal.low[: self.visible], goal.high[: self.visible], dtype=np.float32)
        self.observation_space = spaces.Dict({"observation": seen, **dict.fromkeys(GOALS, goal)})

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._observe(observation, info), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment; the reward is that of the points."""
        observation, _, terminated, truncated, info = self.env.step(action)
        seen = self._observe(observation, info)
        reward = self.compute_reward(seen["achieved_goal"], seen["desired_goal"], info)
        return seen, reward, terminated, truncated, info

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """Return the reward of goals ``(..., D)``: a float for a single goal, else ``(...,)``. ``info`` is ignored."""
        distance = self._distance(achieved_goal, desired_goal)
        reward = -distance if self.reward_type == "dense" else np.where(distance < self.threshold, 0.0, -1.0)
        return float(reward) if reward.ndim == 0 else reward

    def _distance(self, achieved_goal: Any, desired_goal: Any) -> npt.NDArray[np.float64]:
        offset = np.asarray(achieved_goal, np.float64) - np.asarray(desired_goal, np.float64)
        points = offset[..., self.visible :].reshape(*offset.shape[:-1], -1, 3)
        return np.linalg.norm(points, axis=-1).mean(axis=-1)

    def _observe(self, observation: Any, info: dict[str, Any]) -> dict[str, Any]:
        goals = {key: observation[key] for key in GOALS}
        info["goal/distance"] = float(self._distance(*goals.values()))
        info["is_success"] = info["goal/distance"] < self.threshold and bool(info["shape/ok"])
        return {"observation": goals["achieved_goal"][: self.visible].copy(), **goals}
