"""What the factors of the randomisation share: checked numbers, and the scene that they change."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from shape_obs.spec import Spec
from shape_obs_envs.mujoco.bodies.base import Body
from shape_obs_envs.mujoco.randomization.colours import Colour
from shape_obs_envs.mujoco.scene import CameraSpec

Array = NDArray[np.float64]
T = TypeVar("T")
#: A corner of a box (x, y, z) [m], base frame.
Corner = tuple[float, float, float]


class Factor(Spec):
    """Base of the specs of one factor each; numbers are checked where the spec is made."""

    def _check(self, **limits: tuple[float, float]) -> None:
        """Look whether fields lie within their limits, (least, most).

        Raises:
            ValueError: One does not.
        """
        for name, (least, most) in limits.items():
            value = getattr(self, name)
            if not least <= value <= most:
                where = f"{type(self).__name__.lower()}.{name}"
                raise ValueError(f"{where}: expected a number from {least:g} to {most:g}, got {value!r}.")


def choose(rng: np.random.Generator, options: Sequence[T]) -> T:
    """One of `options`, each as likely as the others."""
    return options[int(rng.integers(len(options)))]


@dataclass(frozen=True)
class Scene:
    """What a factor may look at and change.

    Attributes:
        body: The object with its compiled model and state.
        camera: Size and lens of the observation's camera.
        reach: Two corners (x, y, z) [m] of a box that the object never leaves, base frame.
        points: The object's points (n, 3) [m] at this moment, base frame.
    """

    body: Body
    camera: CameraSpec
    reach: tuple[Corner, Corner]
    points: Callable[[], Array]

    @property
    def model(self) -> Any:
        """The compiled model."""
        return self.body.model

    @property
    def hue(self) -> float:
        """Hue of the object as it was modelled, 0 ... 180."""
        return Colour.of(*self.body.colour).hue

    @property
    def data(self) -> Any:
        """Its state."""
        return self.body.data
