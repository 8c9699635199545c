"""Gymnasium environments of `shape_obs`; importing this module registers their ids.

Example:
    >>> import gymnasium as gym
    >>> env = gym.make("shape_obs_envs:ShapeObs/Cable-v0")
"""

from __future__ import annotations

import gymnasium as gym
from gymnasium.envs.registration import WrapperSpec

__all__: list[str] = []

# What ShapeObservation.wrapper_spec() returns, without importing the wrapper; it takes `shape_obs_defaults` from the
# environment.
_SHAPE = WrapperSpec("ShapeObservation", "shape_obs.wrappers.shape_observation:ShapeObservation", {})
# Strings: MuJoCo is imported by the first environment that is made.
_ENTRY_POINTS = {
    "Cable": "shape_obs_envs.mujoco.cable:CableEnv",
    "Ring": "shape_obs_envs.mujoco.ring:RingEnv",
    "Cloth": "shape_obs_envs.mujoco.cloth:ClothEnv",
}

for _name, _entry_point in _ENTRY_POINTS.items():
    gym.register(id=f"ShapeObs/{_name}-v0", entry_point=_entry_point, max_episode_steps=50)
    gym.register(
        id=f"ShapeObs/{_name}Shape-v0",
        entry_point=_entry_point,
        max_episode_steps=50,
        additional_wrappers=(_SHAPE,),
    )

# A real camera gives no two equal images.
gym.register(id="ShapeObs/D455-v0", entry_point="shape_obs_envs.cell:D455Env", nondeterministic=True)
