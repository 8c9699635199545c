"""The table: a colour away from the object's, a pattern, and light that falls on it unevenly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.randomization.colours import Colour, draw_other
from shape_obs_envs.mujoco.randomization.factor import Factor, Scene, choose
from shape_obs_envs.mujoco.randomization.patterns import PATTERNS, draw_pattern, smooth_noise

_NAME: Final = "table"
#: Texels along a side of the texture, and what they cover [m]: more than the camera sees.
_SIDE, _SPAN = 512, 1.6


@dataclass(frozen=True)
class Table(Factor):
    """How the table varies.

    Attributes:
        textured: Probability of a pattern; else it has one colour.
        contrast: Largest difference of a pattern's two colours, in value, 0 ... 1.
        cell: Smallest and largest size of a pattern's parts [m].
        shade: Largest part by which light is less in one place than in another.
    """

    textured: float = 0.8
    contrast: float = 0.5
    cell: tuple[float, float] = (0.01, 0.08)
    shade: float = 0.3

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check(textured=(0, 1), contrast=(0, 1), shade=(0, 0.9))
        if not 0.004 <= self.cell[0] <= self.cell[1] <= 0.4:
            raise ValueError(f"table.cell: expected two sizes within 0.004 ... 0.4 m, got {self.cell}.")

    def sections(self) -> str:
        """MJCF of the table's material; its size is that of a patch about the origin, repeated."""
        return (
            f'<asset><texture name="{_NAME}" type="2d" builtin="flat" width="{_SIDE}" height="{_SIDE}"/>'
            f'<material name="{_NAME}" texture="{_NAME}" texuniform="true" texrepeat="{2 / _SPAN} {2 / _SPAN}" '
            'specular="0" shininess="0"/></asset>'
        )

    def apply(self, rng: np.random.Generator, scene: Scene) -> dict[str, Any]:
        """Draw a table and lay it under the object."""
        first = draw_other(rng, scene.hue, darkest=0.25)
        kind = choose(rng, [*PATTERNS][1:]) if rng.random() < self.textured else "plain"
        cell = float(np.exp(rng.uniform(*np.log(self.cell))))
        second = _companion(rng, first, self.contrast).away_from(scene.hue)
        pattern = draw_pattern(rng, kind, (_SIDE, _SIDE), cell * _SIDE / _SPAN)
        shade = 1 - self.shade * rng.random() * smooth_noise(rng, (_SIDE, _SIDE), _SIDE / 5)
        model = scene.model
        texture = model.texture(_NAME)
        start, size = int(texture.adr[0]), _SIDE * _SIDE * 3
        model.tex_data[start : start + size] = _print(pattern, shade, first, second).ravel()
        table = model.geom("table").id
        model.geom_matid[table], model.geom_rgba[table] = model.material(_NAME).id, 1.0
        return {"pattern": kind, "cell": cell, "colours": [list(first.rgb), list(second.rgb)]}


def _companion(rng: np.random.Generator, colour: Colour, contrast: float) -> Colour:
    """A second colour of nearly the same hue: what lies between two hues on a blurred edge may be a third one's."""
    darker, paler = contrast * rng.uniform(-1, 1), rng.uniform(0.5, 1.2)
    value = colour.value + darker if 0.1 < colour.value + darker < 1 else colour.value - darker
    return Colour(colour.hue + rng.uniform(-8, 8), min(colour.saturation * paler, 0.9), float(np.clip(value, 0.1, 1.0)))


def _print(pattern: NDArray[Any], shade: NDArray[Any], first: Colour, second: Colour) -> NDArray[np.uint8]:
    """The texture (H, W, 3) of two colours mixed by `pattern` (H, W), 0 ... 1, under light `shade` (H, W)."""
    mix = np.linspace(0, 1, 256)[:, None]
    palette = np.rint(255 * ((1 - mix) * np.array(first.rgb) + mix * np.array(second.rgb))).astype(np.uint8)
    colours = cv2.LUT(cv2.merge(3 * [np.rint(255 * pattern).astype(np.uint8)]), palette[None])
    light = cv2.merge(3 * [np.rint(255 * shade).astype(np.uint8)])
    return np.asarray(cv2.multiply(colours, light, scale=1 / 255), np.uint8)
