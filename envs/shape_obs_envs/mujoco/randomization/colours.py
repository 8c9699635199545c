"""Colours by hue, and those that nobody takes for the object's."""

from __future__ import annotations

import colorsys
from typing import NamedTuple

import numpy as np

HUES = 180
#: Hues nearer than this to the object's belong to it, and only greys have them elsewhere.
FAMILY = 30.0
#: Largest saturation of a grey: coloured light makes at most twice as much of it, which no rule takes for a colour.
GREY = 0.12


class Colour(NamedTuple):
    """A colour: hue 0 ... 180 as OpenCV counts, saturation and value 0 ... 1."""

    hue: float
    saturation: float
    value: float

    @classmethod
    def of(cls, red: float, green: float, blue: float) -> Colour:
        """The colour of red, green and blue, 0 ... 1 each."""
        hue, saturation, value = colorsys.rgb_to_hsv(red, green, blue)
        return cls(hue * HUES, saturation, value)

    @property
    def rgb(self) -> tuple[float, float, float]:
        """Red, green and blue, 0 ... 1 each."""
        return colorsys.hsv_to_rgb(self.hue % HUES / HUES, self.saturation, self.value)

    def away_from(self, hue: float) -> Colour:
        """This colour, or a grey where its hue belongs to the family of `hue`."""
        near = hue_distance(self.hue, hue) < FAMILY
        return self._replace(saturation=min(self.saturation, GREY)) if near else self


def hue_distance(one: float, other: float) -> float:
    """How far apart two hues are, 0 ... 90."""
    apart = abs(one - other) % HUES
    return min(apart, HUES - apart)


def draw_other(rng: np.random.Generator, hue: float, darkest: float = 0.15, greys: float = 0.3) -> Colour:
    """Draw a colour that is not of the family of `hue`.

    Args:
        rng: Draws it.
        hue: The object's.
        darkest: Least value.
        greys: Share of greys among all.
    """
    value = rng.uniform(darkest, 1.0)
    if rng.random() < greys:
        return Colour(rng.uniform(0, HUES), rng.uniform(0, GREY), value)
    return Colour((hue + rng.uniform(FAMILY, HUES - FAMILY)) % HUES, rng.uniform(0.15, 0.9), value)
