"""What the object is made of: how thick, stiff and damped it is, and how much the table holds it back."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from shape_obs_envs.mujoco.bodies.base import MaterialFactors
from shape_obs_envs.mujoco.randomization.factor import Factor, Scene


@dataclass(frozen=True)
class Material(Factor):
    """How the material varies. A factor f stands for 1/f ... f, evenly in its logarithm; 1 leaves it.

    Attributes:
        thickness: Largest part by which it is thinner or thicker; of a cloth there is no such thing.
        stiffness: Factor of the stiffness of a bend.
        damping: Factor of the damping of a bend.
        friction: Factor of what the table does: the medium's viscosity, or the friction of a cloth.
    """

    thickness: float = 0.25
    stiffness: float = 2.0
    damping: float = 2.0
    friction: float = 1.6

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check(thickness=(0, 0.4), stiffness=(1, 4), damping=(1, 4), friction=(1, 3))

    def apply(self, rng: np.random.Generator, scene: Scene) -> dict[str, Any]:
        """Draw a material and make the object of it."""
        thickness = 1 + self.thickness * rng.uniform(-1, 1)
        others = np.array([self.stiffness, self.damping, self.friction]) ** rng.uniform(-1, 1, 3)
        factors = MaterialFactors(thickness, *others.tolist())
        scene.body.set_material(factors)
        return asdict(factors)
