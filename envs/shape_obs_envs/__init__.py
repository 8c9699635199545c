"""Gymnasium environments of ``shape_obs``; importing this module registers their ids.

Example:
    >>> import gymnasium as gym
    >>> env = gym.make("shape_obs_envs:ShapeObs/Cable-v0")
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import WrapperSpec

__all__: list[str] = []

# The result of ShapeObservation.wrapper_spec(), without importing the wrapper; the wrapper takes its arguments from the
# environment's `shape_obs_defaults`.
_SHAPE = WrapperSpec("ShapeObservation", "shape_obs.wrappers.shape_observation:ShapeObservation", {})
# Strings, so that MuJoCo is imported only when an environment is made.
_ENTRY_POINTS = {
    "Cable": "shape_obs_envs.mujoco.cable:CableEnv",
    "Cables": "shape_obs_envs.mujoco.cables:CablesEnv",
    "Ring": "shape_obs_envs.mujoco.ring:RingEnv",
    "Cloth": "shape_obs_envs.mujoco.cloth:ClothEnv",
    "Hanging": "shape_obs_envs.mujoco.hanging:HangingEnv",
}
#: Modules that were renamed: saved environment specs contain the old entry points.
_RENAMED = {"shape_obs_envs.cell": "shape_obs_envs.real"}


class _RenamedModule(ModuleType):
    """A module under its old name; it is imported when a name is read from it."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(import_module(_RENAMED[self.__name__]), name)


for _name, _entry_point in _ENTRY_POINTS.items():
    gym.register(id=f"ShapeObs/{_name}-v0", entry_point=_entry_point, max_episode_steps=50)
    gym.register(
        id=f"ShapeObs/{_name}Shape-v0",
        entry_point=_entry_point,
        max_episode_steps=50,
        additional_wrappers=(_SHAPE,),
    )

# Nondeterministic: a real camera never returns two equal images.
gym.register(id="ShapeObs/D455-v0", entry_point="shape_obs_envs.real:D455Env", nondeterministic=True)

for _old in _RENAMED:
    sys.modules[_old] = _RenamedModule(_old)
