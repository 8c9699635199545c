"""Gymnasium environments of `shape_obs`; importing this module registers their ids.

Example:
    >>> import gymnasium as gym
    >>> env = gym.make("shape_obs_envs:ShapeObs/Cable-v0")
"""

from __future__ import annotations

import gymnasium as gym
from gymnasium.envs.registration import WrapperSpec

__all__: list[str] = []

gym.register(
    id="ShapeObs/Cable-v0",
    # A string: MuJoCo is imported by the first environment that is made.
    entry_point="shape_obs_envs.mujoco.cable:CableEnv",
    max_episode_steps=50,
)

gym.register(
    id="ShapeObs/CableShape-v0",
    entry_point="shape_obs_envs.mujoco.cable:CableEnv",
    max_episode_steps=50,
    # What ShapeObservation.wrapper_spec() returns, without importing the wrapper; it takes `shape_obs_defaults` from
    # the environment.
    additional_wrappers=(WrapperSpec("ShapeObservation", "shape_obs.wrappers.shape_observation:ShapeObservation", {}),),
)
