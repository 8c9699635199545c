"""Pixels: the raw image in place of a shape, for comparison."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs

from shape_obs.wrappers.env_protocol import GOALS, has_goals


class Pixels(gym.ObservationWrapper[Any, Any, Any], RecordConstructorArgs):
    """The camera's image as ``observation``, beside the goals of a goal-conditioned simulated env.

    ``achieved_goal`` is the simulator's, since an image tells no points: it is there for the reward and for hindsight
    replay, and a policy that is to be compared must not read it (``ImageAndGoal`` does not). ``desired_goal`` are the
    points of the goal, which such a policy is told.

    Args:
        env: Goal-conditioned, with an RGB image.
        key: Of the image, (H, W, 3) uint8.

    Raises:
        ValueError: The env has no goals, or no such image.
    """

    def __init__(self, env: gym.Env[Any, Any], key: str = "rgb") -> None:
        RecordConstructorArgs.__init__(self, key=key)
        gym.ObservationWrapper.__init__(self, env)
        space = env.observation_space
        if not isinstance(space, spaces.Dict) or not has_goals(space):
            raise ValueError(f"Pixels needs an environment with goals, got the observation space {space}.")
        if key not in space.spaces or space[key].dtype != np.uint8 or len(space[key].shape or ()) != 3:
            raise ValueError(f"key: expected an image (H, W, 3) uint8 of {list(space)}, got {key!r}.")
        self.observation_space = spaces.Dict({"observation": space[key], **{name: space[name] for name in GOALS}})
        self._key = key

    def observation(self, observation: Any) -> dict[str, Any]:
        """Image and goals."""
        return {"observation": observation[self._key], **{name: observation[name] for name in GOALS}}

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """The env's own."""
        return self.env.get_wrapper_attr("compute_reward")(achieved_goal, desired_goal, info)
