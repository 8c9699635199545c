"""The light: where the lamp stands, how bright it is, how much of its light comes from all around, and its colour."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from shape_obs_envs.mujoco.randomization.factor import Factor, Scene


@dataclass(frozen=True)
class Light(Factor):
    """How the light varies.

    Attributes:
        tilt: Largest angle between the lamp's rays and the vertical [rad], in any direction.
        level: Largest part by which it is darker; it is never so bright that a colour would be cut off.
        ambient: Largest deviation of the part of the light that comes from all around; without, 0.5 does.
        cast: Largest part by which red, green and blue differ from white, each by itself.
    """

    tilt: float = 0.7
    level: float = 0.3
    ambient: float = 0.2
    cast: float = 0.08

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check(tilt=(0, 1.3), level=(0, 0.8), ambient=(0, 0.5), cast=(0, 0.3))

    def apply(self, rng: np.random.Generator, scene: Scene) -> dict[str, Any]:
        """Draw a light and switch it on."""
        # uniform over the cap of directions
        down = rng.uniform(np.cos(self.tilt), 1.0)
        turn, side = rng.uniform(-np.pi, np.pi), np.sqrt(1 - down**2)
        share = 0.5 + self.ambient * rng.uniform(-1, 1)
        around, lamp = np.array([[share], [1 - share]]) * (1 + self.cast * rng.uniform(-1, 1, (2, 3)))
        level = (1 - self.level * rng.random()) / (around + lamp).max()
        drawn = {
            "direction": [float(side * np.cos(turn)), float(side * np.sin(turn)), float(-down)],
            "ambient": (level * around).tolist(),
            "diffuse": (level * lamp).tolist(),
        }
        model = scene.model
        model.light_dir[0] = drawn["direction"]
        model.light_ambient[0], model.light_diffuse[0] = drawn["ambient"], drawn["diffuse"]
        return drawn
