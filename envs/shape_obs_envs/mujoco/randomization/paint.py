"""The object's looks: its colour within the family that it is known by, and tones along it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from shape_obs_envs.mujoco.randomization.colours import HUES, Colour
from shape_obs_envs.mujoco.randomization.factor import Factor, Scene, choose
from shape_obs_envs.mujoco.randomization.patterns import draw_pattern

_KINDS = ("plain", "noise", "stripes", "speckle")


@dataclass(frozen=True)
class Paint(Factor):
    """How the object's looks vary.

    Attributes:
        hue: Largest shift of its hue, of 180.
        saturation: Largest part of its saturation that is taken away.
        value: Largest part of its value that is taken away.
        tone: Largest part of its value by which one place of it is darker than another.
    """

    hue: float = 6.0
    saturation: float = 0.3
    value: float = 0.4
    tone: float = 0.25

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check(hue=(0, 12), saturation=(0, 0.5), value=(0, 0.6), tone=(0, 0.5))

    def apply(self, rng: np.random.Generator, scene: Scene) -> dict[str, Any]:
        """Draw the object's colours and paint it."""
        known = Colour.of(*scene.body.colour)
        less = 1 - np.array([self.saturation, self.value]) * rng.random(2)
        colour = Colour(
            (known.hue + self.hue * rng.uniform(-1, 1)) % HUES,
            known.saturation * float(less[0]),
            known.value * float(less[1]),
        )
        kind, shape = choose(rng, _KINDS), scene.body.tone_shape
        pattern = draw_pattern(rng, kind, shape, rng.uniform(0.04, 0.15) * max(shape))
        scene.body.paint(colour.rgb, 1 - self.tone * rng.random() * pattern)
        return {"colour": list(colour.rgb), "pattern": kind}


def widened(rule: dict[str, Any]) -> dict[str, Any]:
    """An HSV rule that still fits an object whose colour and light vary: {"kind", "low", "high"}."""
    (hue, saturation, value), (top, *rest) = rule["low"], rule["high"]
    low = [(hue - 4) % HUES, max(saturation - 30, 0), max(value - 15, 0)]
    return {**rule, "low": low, "high": [(top + 5) % HUES, *rest]}
