"""Colours, and what ropes and cloth are made of: braids, twists, stripes, prints and their shading."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from curves import Array, Random, direction, noise

#: Colours of points on a rope: the arc in widths, the place across -1...1, the part of the light from that side -1...1,
#: each ``(K,)``; returns ``(K, 3)``, 0...255.
Strand = Callable[[Array, Array, Array], Array]


def from_hsv(rng: Random, saturation: tuple[float, float], value: tuple[float, float]) -> Array:
    """Draw a colour ``(3,)`` of any hue, RGB 0...255."""
    hsv = np.array([[[rng.uniform(0, 360), rng.uniform(*saturation), rng.uniform(*value)]]], np.float32)
    return cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)[0, 0] * 255


def colour(rng: Random) -> Array:
    """Draw the colour of an object: vivid, dull, white, black or grey."""
    saturations = ((0.45, 1), (0.1, 0.5), (0, 0.15), (0, 0.3), (0, 0.12))
    values = ((0.3, 1), (0.2, 1), (0.75, 1), (0.03, 0.2), (0.25, 0.7))
    kind = rng.choice(5, p=[0.5, 0.2, 0.12, 0.1, 0.08])
    return from_hsv(rng, saturations[kind], values[kind])


def brown(rng: Random) -> Array:
    """Draw a colour of wood or skin."""
    return rng.uniform(60, 235) * np.array([1, rng.uniform(0.62, 0.88), rng.uniform(0.4, 0.78)], np.float32)


def strand(rng: Random, base: Array, flat: bool = False) -> Strand:
    """Draw what a rope or wire of colour ``base`` is made of, or a ``flat`` band, which has no round shading."""
    kinds = ["plain", "twist", "braid", "spiral", "line", "rings", "pair", "halves"]
    kind = rng.choice(kinds, p=[0.38, 0.16, 0.14, 0.06, 0.08, 0.08, 0.05, 0.05])
    second = colour(rng) if rng.random() < 0.5 else base * rng.uniform(0.3, 0.8)
    second = base + (second - base) * rng.uniform(0.25, 1)
    two_coloured = kind in ("spiral", "line", "halves") or rng.random() < 0.35
    period, phase, change = rng.uniform(0.5, 3), rng.uniform(0, 9), rng.uniform(5, 60)  # in widths
    slope, depth = rng.uniform(0.3, 1.3) * float(rng.choice([-1, 1])), rng.uniform(0.1, 0.6)
    ambient, edge, worn = rng.uniform(0.35, 0.9), 0 if flat else rng.uniform(0, 0.5), rng.uniform(0, 0.08)
    gloss, spread = rng.uniform(0.1, 0.9) if rng.random() < 0.45 else 0, rng.uniform(0.08, 0.35)
    middle, wide = rng.uniform(-0.5, 0.5), rng.uniform(0.1, 0.35)

    def paint(arc: Array, across: Array, light: Array) -> Array:
        bow = np.arcsin(across) * (2 / np.pi)  # the place on the round surface, -1...1
        one, two = arc / period + slope * bow + phase, arc / period - slope * bow  # windings to the right, to the left
        grooves = {
            "twist": np.abs(np.cos(np.pi * one)) ** 3,
            "braid": 1 - np.abs(np.sin(np.pi * one) * np.sin(np.pi * two)),
            "rings": np.cos(np.pi * arc / period) ** 2,  # of a corrugated tube
            "pair": np.exp(-((across / 0.2) ** 2)),  # between two wires side by side
        }
        seconds = {  # where the second colour is
            "twist": one % 3 < 1,
            "braid": (np.floor(one) + 2 * np.floor(two)) % 4 < 1,
            "spiral": one / 4 % 1 < 0.4,
            "line": np.abs(across - middle) < wide,
            "halves": arc > change,
        }
        groove, other = grooves.get(kind, np.zeros_like(arc)), seconds.get(kind, np.zeros(len(arc), bool))
        facing = across - 0.6 * light
        rounding = 1 if flat else np.sqrt(np.clip(1 - 0.6 * facing**2, 0, 1))
        shade = (ambient + (1 - ambient) * rounding - edge * across**4) * (1 - depth * groove)
        shade *= 1 + worn * np.sin(arc * 0.7 + phase)
        shine = 255 * gloss * np.exp(-((facing / spread) ** 2)) * (1 - groove)
        colours = np.where((other & two_coloured)[:, None], second, base)
        return np.clip(colours * shade[:, None] + shine[:, None], 0, 255)

    return paint


def cloth(rng: Random, base: Array, shape: tuple[int, int], scale: float) -> Array:
    """Draw cloth of colour ``base`` without its wrinkles, ``(h, w, 3)``, for an object ``scale`` pixels wide."""
    second = colour(rng) if rng.random() < 0.6 else base * rng.uniform(0.4, 0.85)
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32)
    (cosine, sine), warp = direction(rng), noise(rng, shape, 0.6 * scale) * 0.02 * scale
    u, v = x * cosine + y * sine + warp, y * cosine - x * sine + warp
    period, part, fine = scale * rng.uniform(0.06, 0.5), rng.uniform(0.15, 0.6), 2 * np.pi / rng.uniform(2, 6)
    in_u, in_v = u / period % 1, v / period % 1
    kind = rng.choice(["plain", "stripes", "checks", "dots", "figure", "word"], p=[0.38, 0.2, 0.2, 0.1, 0.07, 0.05])
    share: Array = np.zeros(shape, np.float32)  # of the second colour
    if kind == "stripes":
        share = in_u < part
    elif kind == "checks":
        share = (in_u < part) * np.float32(0.5) + (in_v < part) * np.float32(0.5)
    elif kind == "dots":
        share = np.hypot(in_u - 0.5, in_v - 0.5) < 0.6 * part
    elif kind == "figure":
        share = noise(rng, shape, 0.15 * scale) > 0.6
    elif kind == "word":
        word = "".join(rng.choice(list("ABEKMNORSTXYZ0123"), rng.integers(2, 7)))
        at = (int(shape[1] * rng.uniform(0.25, 0.5)), int(shape[0] * rng.uniform(0.35, 0.65)))
        ink, thick = np.zeros(shape, np.uint8), max(1, int(scale / 40))
        cv2.putText(ink, word, at, cv2.FONT_HERSHEY_DUPLEX, scale / 90, 255, thick, cv2.LINE_AA)
        share = ink / np.float32(255)
    picture = base + (second - base) * (share * np.float32(rng.uniform(0.3, 1)))[..., None]
    return picture * (1 + max(0, rng.uniform(-0.1, 0.1)) * np.sin(u * fine) * np.sin(v * fine))[..., None]  # the weave
