"""A hand: palm, fingers, thumb and forearm, made of ellipsoids and capsules, with its looks and pose drawn."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.engine import mujoco
from shape_obs_envs.mujoco.randomization.colours import FAMILY, GREY, Colour, hue_distance
from shape_obs_envs.mujoco.randomization.factor import choose
from shape_obs_envs.mujoco.randomization.props import prop, shape

Array = NDArray[np.float64]

HAND: Final = "hand"
#: Geom group of the hand, so that rays can be cast at it alone.
HAND_GROUP: Final = 2
_PALM, _FOREARM, _FINGERS = 0, 1, 2  # the first of the fingers' geoms, two for each of five
GEOMS: Final = _FINGERS + 10

# Skin from pale to dark, and gloves.
_LOOKS: Final = (
    Colour(10, 0.30, 0.92), Colour(9, 0.40, 0.80), Colour(9, 0.48, 0.62), Colour(8, 0.52, 0.42), Colour(8, 0.50, 0.28),
    Colour(0, 0.02, 0.95), Colour(0, 0.02, 0.15), Colour(105, 0.65, 0.75), Colour(60, 0.55, 0.60),
    Colour(23, 0.70, 0.85), Colour(140, 0.45, 0.55),
)  # fmt: skip
# Roots of thumb, index, middle, ring and little finger, x forward and y to the left, right hand palm down; lengths [m].
_ROOTS: Final = ((-0.120, 0.034), (-0.075, 0.029), (-0.070, 0.009), (-0.073, -0.011), (-0.082, -0.030))
_LENGTHS: Final = (0.060, 0.070, 0.078, 0.072, 0.056)
_SPREAD: Final = (0.75, 0.14, 0.03, -0.08, -0.20)  # heading of each finger [rad]


def hand_body() -> str:
    """MJCF of the hand, unseen."""
    return prop(HAND, GEOMS, HAND_GROUP)


def draw_colours(rng: np.random.Generator, hue: float) -> tuple[Any, Any]:
    """Colours (3,) of hand and sleeve, neither of the family of `hue`."""
    looks = [look for look in _LOOKS if look.saturation <= GREY or hue_distance(look.hue, hue) >= FAMILY]
    skin = choose(rng, looks)
    skin = skin._replace(value=float(np.clip(skin.value * rng.uniform(0.85, 1.1), 0.1, 1.0)))
    sleeve = Colour((hue + rng.uniform(FAMILY, 180 - FAMILY)) % 180, rng.uniform(0.0, 0.7), rng.uniform(0.15, 0.9))
    return skin.rgb, (sleeve.rgb if rng.random() < 0.5 else skin.rgb)


def form_hand(rng: np.random.Generator, model: Any) -> float:
    """Give the hand its form: x is forward, the tip of the middle finger of an open hand about the origin.

    Returns:
        How far below the hand's plane its lowest point is [m].
    """
    first, scale = int(model.body(HAND).geomadr[0]), rng.uniform(0.85, 1.1)
    side = choose(rng, (-1.0, 1.0))
    palm = [0.052 * scale, 0.043 * scale, 0.016 * scale]
    shape(model, first + _PALM, "ellipsoid", palm, pos=(-0.11 * scale, 0.0, 0.0))
    _capsule(model, first + _FOREARM, scale * np.array([-0.16, 0, 0]), np.array([-0.8, 0, 0.05]), 0.032 * scale)
    spread, bend = rng.uniform(0.3, 1.6), rng.uniform(0.05, 0.7) + rng.uniform(0, 0.5, 5)
    lowest = 0.016 * scale
    for i, (root, length, heading) in enumerate(zip(_ROOTS, _LENGTHS, _SPREAD, strict=True)):
        heading = (heading if i == 0 else heading * spread) * side
        start, radius = scale * np.array([root[0], side * root[1], 0.0]), scale * (0.0105 if i == 0 else 0.009)
        for part, (share, pitch) in enumerate(((0.55, 0.4 * bend[i]), (0.45, 1.3 * bend[i]))):
            way = np.array([np.cos(heading) * np.cos(pitch), np.sin(heading) * np.cos(pitch), -np.sin(pitch)])
            end = start + scale * length * share * way
            _capsule(model, first + _FINGERS + 2 * i + part, start, end, radius)
            start = end
        lowest = max(lowest, radius - start[2])
    return float(lowest)


def _capsule(model: Any, geom: int, start: Array, end: Array, radius: float) -> None:
    """Make a geom a capsule from `start` to `end` (3,) [m]."""
    way, quaternion = end - start, np.empty(4)
    mujoco.mju_quatZ2Vec(quaternion, way)
    shape(model, geom, "capsule", [radius, float(np.linalg.norm(way)) / 2], (start + end) / 2, quaternion)
