"""Colours, and what ropes and cloth are made of: braids, twists, stripes, prints and their shading."""

from __future__ import annotations

from collections.abc import Callable
from colorsys import hsv_to_rgb

import numpy as np
from curves import Array, Random, noise, rotation

Range = tuple[float, float]
# Colours ``(K, 3)``, 0...255, of points on a rope: the arc in widths, the place across and the part of the light from
# that side, -1...1, each ``(K,)``.
Strand = Callable[[Array, Array, Array], Array]


def from_hsv(rng: Random, saturation: Range, value: Range, hue: Range = (0, 1)) -> Array:
    """Draw a colour ``(3,)``, RGB 0...255."""
    return 255 * np.array(hsv_to_rgb(rng.uniform(*hue), rng.uniform(*saturation), rng.uniform(*value)), np.float32)


def colour(rng: Random) -> Array:
    """Draw the colour of an object: vivid, dull, white, black or grey."""
    saturations = ((0.45, 1), (0.1, 0.5), (0, 0.15), (0, 0.3), (0, 0.12))
    values = ((0.3, 1), (0.2, 1), (0.75, 1), (0.03, 0.2), (0.25, 0.7))
    kind = rng.choice(5, p=[0.5, 0.2, 0.12, 0.1, 0.08])
    return from_hsv(rng, saturations[kind], values[kind])


def strand(rng: Random, base: Array) -> Strand:
    """Draw what a rope or wire of colour ``base`` is made of, or a flat band, which has no round shading."""
    kinds = ["plain", "twist", "braid", "spiral", "line", "rings", "pair", "halves"]
    kind = rng.choice(kinds, p=[0.38, 0.16, 0.14, 0.06, 0.08, 0.08, 0.05, 0.05])
    second = colour(rng) if rng.random() < 0.5 else base * rng.uniform(0.3, 0.8)
    change = rng.uniform(0.25, 1) * (second - base) * (kind in ("spiral", "line", "halves") or rng.random() < 0.35)
    period, phase, middle, wide = rng.uniform(0.5, 3), rng.uniform(0, 9), rng.uniform(-0.5, 0.5), rng.uniform(0.1, 0.35)
    slope, depth = rng.uniform(0.3, 1.3) * float(rng.choice([-1, 1])), rng.uniform(0.1, 0.6)
    ambient, edge = min(1, rng.uniform(0.35, 1.1)), max(0, rng.uniform(-0.2, 0.5))  # flat bands have 1 and 0
    gloss, spread = rng.uniform(0.1, 0.9) if rng.random() < 0.45 else 0, rng.uniform(0.08, 0.35)

    def paint(arc: Array, across: Array, light: Array) -> Array:
        bow = np.arcsin(across) * (2 / np.pi)  # the place on the round surface, -1...1
        one, two = arc / period + slope * bow + phase, arc / period - slope * bow  # windings to the right, to the left
        none, woven = np.zeros_like(arc), np.abs(np.sin(np.pi * one) * np.sin(np.pi * two))
        groove, other = {  # how deep the groove is, and where the second colour is
            "twist": (np.abs(np.cos(np.pi * one)) ** 3, one % 3 < 1),
            "braid": (1 - woven, (np.floor(one) + 2 * np.floor(two)) % 4 < 1),
            "spiral": (none, one / 4 % 1 < 0.4),
            "line": (none, np.abs(across - middle) < wide),
            "rings": (np.cos(np.pi * arc / period) ** 2, none),  # of a corrugated tube
            "pair": (np.exp(-((across / 0.2) ** 2)), none),  # two wires side by side
            "halves": (none, arc > 20 * period),
        }.get(kind, (none, none))
        facing = across - 0.6 * light
        shade = ambient + (1 - ambient) * np.sqrt(np.clip(1 - 0.6 * facing**2, 0, 1)) - edge * across**4
        shine = 255 * gloss * np.exp(-((facing / spread) ** 2)) * (1 - groove)
        shade *= 1 - depth * groove
        return np.clip((base + other[:, None] * change) * shade[:, None] + shine[:, None], 0, 255)

    return paint


def cloth(rng: Random, base: Array, shape: tuple[int, int], scale: float) -> Array:
    """Draw cloth of colour ``base`` without its wrinkles, ``(h, w, 3)``, for an object ``scale`` pixels wide."""
    second = colour(rng) if rng.random() < 0.6 else base * rng.uniform(0.4, 0.85)
    place, warp = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32), noise(rng, shape, 0.6 * scale) * 0.02 * scale
    u, v = np.tensordot(rotation(rng), place, 1) + warp
    period, part, fine = scale * rng.uniform(0.06, 0.5), rng.uniform(0.15, 0.6), 2 * np.pi / rng.uniform(2, 6)
    in_u, in_v = u / period % 1, v / period % 1
    share = {  # of the second colour
        "stripes": in_u < part,
        "checks": (in_u < part) * np.float32(0.5) + (in_v < part) * np.float32(0.5),
        "dots": np.hypot(in_u - 0.5, in_v - 0.5) < 0.6 * part,
        "figures": noise(rng, shape, 0.15 * scale) > 0.6,
        "plain": np.zeros_like(u),
    }[rng.choice(["stripes", "checks", "dots", "figures", "plain"], p=[0.2, 0.2, 0.1, 0.12, 0.38])]
    picture = base + (second - base) * (share * np.float32(rng.uniform(0.3, 1)))[..., None]
    return picture * (1 + max(0, rng.uniform(-0.1, 0.1)) * np.sin(u * fine) * np.sin(v * fine))[..., None]  # the weave
