"""Appearance of the object and the table: colours, printed patterns and uneven light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.randomization.factors import HUES, Colour, Factor, Scene, choose, draw_other

Field = NDArray[Any]  # float32
Shape = tuple[int, int]
Rng = np.random.Generator

_OBJECT_PATTERNS: Final = ("plain", "noise", "stripes", "speckle")
_TABLE: Final = "table"
#: Texels along a side of the table's texture, and the length in metres that they cover: more than the camera sees.
_SIDE, _SPAN = 512, 1.6


@dataclass(frozen=True)
class ObjectAppearance(Factor):
    """Variation of the object's colour.

    Attributes:
        hue: Largest shift of its hue, out of 180.
        saturation: Largest fraction by which its saturation is reduced.
        value: Largest fraction by which its value is reduced.
        tone: Largest fraction of its value by which parts of it are darker than others.
    """

    factor: ClassVar[str] = "object"
    hue: float = 6.0
    saturation: float = 0.3
    value: float = 0.4
    tone: float = 0.25

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check(hue=(0, 12), saturation=(0, 0.5), value=(0, 0.6), tone=(0, 0.5))

    def apply(self, rng: Rng, scene: Scene) -> dict[str, Any]:
        """Draw the object's colours and set them."""
        known = Colour.of(*scene.body.colour)
        less = 1 - np.array([self.saturation, self.value]) * rng.random(2)
        colour = Colour(
            (known.hue + self.hue * rng.uniform(-1, 1)) % HUES,
            known.saturation * float(less[0]),
            known.value * float(less[1]),
        )
        kind, shape = choose(rng, _OBJECT_PATTERNS), scene.body.tone_shape
        pattern = draw_pattern(rng, kind, shape, rng.uniform(0.04, 0.15) * max(shape))
        scene.body.set_colours(colour.rgb, 1 - self.tone * rng.random() * pattern)
        return {"colour": list(colour.rgb), "pattern": kind}


@dataclass(frozen=True)
class TableAppearance(Factor):
    """Variation of the table: its colours, away from the object's, a pattern, and uneven light.

    Attributes:
        textured: Probability of a pattern; otherwise the table has one colour.
        contrast: Largest difference of a pattern's two colours in value, 0 ... 1.
        cell: Smallest and largest size of a pattern's parts in metres.
        shade: Largest fraction by which one place is darker than another.
    """

    factor: ClassVar[str] = "table"
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
        """Return MJCF of the table's material; its size is that of a patch about the origin, repeated."""
        return (
            f'<asset><texture name="{_TABLE}" type="2d" builtin="flat" width="{_SIDE}" height="{_SIDE}"/>'
            f'<material name="{_TABLE}" texture="{_TABLE}" texuniform="true" texrepeat="{2 / _SPAN} {2 / _SPAN}" '
            'specular="0" shininess="0"/></asset>'
        )

    def apply(self, rng: Rng, scene: Scene) -> dict[str, Any]:
        """Draw the table's appearance and set it."""
        first = draw_other(rng, scene.hue, darkest=0.25)
        kind = choose(rng, [*PATTERNS][1:]) if rng.random() < self.textured else "plain"
        cell = float(np.exp(rng.uniform(*np.log(self.cell))))
        second = _companion(rng, first, self.contrast).away_from(scene.hue)
        pattern = draw_pattern(rng, kind, (_SIDE, _SIDE), cell * _SIDE / _SPAN)
        shade = 1 - self.shade * rng.random() * _smooth_noise(rng, (_SIDE, _SIDE), _SIDE / 5)
        model = scene.model
        texture = model.texture(_TABLE)
        start, size = int(texture.adr[0]), _SIDE * _SIDE * 3
        model.tex_data[start : start + size] = _table_texture(pattern, shade, first, second).ravel()
        table = model.geom("table").id
        model.geom_matid[table], model.geom_rgba[table] = model.material(_TABLE).id, 1.0
        return {"pattern": kind, "cell": cell, "colours": [list(first.rgb), list(second.rgb)]}


def widened_rule(rule: dict[str, Any]) -> dict[str, Any]:
    """Return an HSV rule ({"kind", "low", "high"}) that still matches the object under varying colour and light."""
    (hue, saturation, value), (top, *rest) = rule["low"], rule["high"]
    low = [(hue - 4) % HUES, max(saturation - 30, 0), max(value - 15, 0)]
    return {**rule, "low": low, "high": [(top + 5) % HUES, *rest]}


def _companion(rng: Rng, colour: Colour, contrast: float) -> Colour:
    """Draw a second colour of nearly the same hue: a blurred edge between two hues could show a third one."""
    darker, paler = contrast * rng.uniform(-1, 1), rng.uniform(0.5, 1.2)
    value = colour.value + darker if 0.1 < colour.value + darker < 1 else colour.value - darker
    return Colour(colour.hue + rng.uniform(-8, 8), min(colour.saturation * paler, 0.9), float(np.clip(value, 0.1, 1.0)))


def _table_texture(pattern: Field, shade: Field, first: Colour, second: Colour) -> NDArray[np.uint8]:
    """Return a texture ``(H, W, 3)`` of two colours, mixed by ``pattern`` ``(H, W)`` and scaled by ``shade``."""
    mix = np.linspace(0, 1, 256)[:, None]
    palette = np.rint(255 * ((1 - mix) * np.array(first.rgb) + mix * np.array(second.rgb))).astype(np.uint8)
    colours = cv2.LUT(cv2.merge(3 * [np.rint(255 * pattern).astype(np.uint8)]), palette[None])
    light = cv2.merge(3 * [np.rint(255 * shade).astype(np.uint8)])
    return np.asarray(cv2.multiply(colours, light, scale=1 / 255), np.uint8)


# ---- patterns


def draw_pattern(rng: Rng, kind: str, shape: Shape, cell: float) -> Field:
    """Draw a pattern.

    Args:
        rng: Random generator.
        kind: One of ``PATTERNS``.
        shape: Size ``(H, W)`` of the field.
        cell: Size of the pattern's parts in texels.

    Returns:
        Field of shape ``(H, W)``, float32, 0 ... 1.
    """
    return np.clip(PATTERNS[kind](rng, shape, max(cell, 1.0)), np.float32(0), np.float32(1))


def _smooth_noise(rng: Rng, shape: Shape, cell: float) -> Field:
    """Draw smooth noise ``(H, W)``, 0 ... 1, with maxima about ``cell`` texels apart."""
    coarse = [max(2, round(side / cell) + 1) for side in shape]
    grid = rng.random(coarse, np.float32)
    return np.clip(cv2.resize(grid, shape[::-1], interpolation=cv2.INTER_CUBIC), 0, 1)  # cubic interpolation overshoots


def _plain(rng: Rng, shape: Shape, cell: float) -> Field:
    return np.zeros(shape, np.float32)


def _noise(rng: Rng, shape: Shape, cell: float) -> Field:
    octaves = [_smooth_noise(rng, shape, size * cell) for size in (2.0, 1.0, 0.5)]
    return (4 * octaves[0] + 2 * octaves[1] + octaves[2]) / 7


def _checker(rng: Rng, shape: Shape, cell: float) -> Field:
    along, across = _rotated_axes(rng, shape, cell)
    return _fraction(np.float32(0.5) * (np.floor(along) + np.floor(across))) * np.float32(2)


def _stripes(rng: Rng, shape: Shape, cell: float) -> Field:
    along, _ = _rotated_axes(rng, shape, 2 * cell)
    return (_fraction(along) < rng.uniform(0.2, 0.8)).astype(np.float32)


def _tiles(rng: Rng, shape: Shape, cell: float) -> Field:
    along, across = _rotated_axes(rng, shape, 2 * cell)
    return (np.minimum(_fraction(along), _fraction(across)) < np.float32(0.08)).astype(np.float32)


def _wood(rng: Rng, shape: Shape, cell: float) -> Field:
    """Draw annual rings cut along the trunk: stripes that are stretched and bent by noise."""
    along, across = _rotated_axes(rng, shape, cell)
    bend = np.float32(4) * _smooth_noise(rng, shape, 12 * cell)
    grain = _smooth_noise(rng, shape, max(1.0, cell / 8))
    rings = np.sin(np.float32(2 * np.pi) * (np.float32(0.7) * across + np.float32(0.03) * along + bend))
    return np.float32(0.4) + np.float32(0.4) * rings + np.float32(0.2) * grain


def _speckle(rng: Rng, shape: Shape, cell: float) -> Field:
    return np.clip(8 * (_smooth_noise(rng, shape, cell / 2) - 0.7), 0, 1)


def _fraction(values: Field) -> Field:
    """Return the fractional part."""
    return values - np.floor(values)


def _rotated_axes(rng: Rng, shape: Shape, cell: float) -> tuple[Field, Field]:
    """Return coordinates ``(H, W)`` along two perpendicular axes, in cells, rotated and shifted at random."""
    turn = rng.uniform(0, np.pi)
    u, v = (np.arange(side, dtype=np.float32) / cell for side in shape[::-1])
    cos, sin = np.float32(np.cos(turn)), np.float32(np.sin(turn))
    first, second = rng.random(2, np.float32)
    return cos * u + sin * v[:, None] + first, cos * v[:, None] - sin * u + second


PATTERNS: Final[dict[str, Callable[[Rng, Shape, float], Field]]] = {
    "plain": _plain,
    "noise": _noise,
    "checker": _checker,
    "stripes": _stripes,
    "tiles": _tiles,
    "wood": _wood,
    "speckle": _speckle,
}
