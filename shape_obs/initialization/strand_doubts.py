"""Why a strand of several ropes may be wrong: it ends on another rope, or turns more sharply than ropes do."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.geometry.polyline import arc_length, interpolate
from shape_obs.image.region import Region
from shape_obs.initialization.gaps import lead

Array = npt.NDArray[np.float64]
Ends = tuple[bool, bool]

# A rope that ends on another one: of the strands there the two that go straight on must bend less than any others by so
# much, squared radians. Where a rope meets another one at 70 degrees it is 0.37.
_CLEAR_END: Final = 0.35
_NEAR: Final = 5.0  # widths: two ropes that end on others so near to each other are one rope
# A rope turns by less between two chords of so many widths.
_CHORD: Final = 1.5
_SHARP: Final = np.deg2rad(70)
_PROBES: Final = 4  # in a chord
# Straight on beyond its end on another rope, the mask of a rope that ends there reaches to the other one's border: half
# of that one's width from its axis, and so much farther at an angle; with a bump by so many widths more.
_SLANT: Final = 1.2
_STICKS_OUT: Final = 0.3
_BEYOND: Final = 5.0  # widths that are looked at


def strand_doubts(
    curves: Sequence[Array], inside: Sequence[Ends], margins: Sequence[tuple[float, float]], width: float
) -> list[list[str]]:
    """Return why each strand may be wrong, in words.

    Args:
        curves: ``(P_i, 2)`` pixels each.
        inside: Whether the first and the last end of each lie on another strand.
        margins: By how much more the strands where each end lies would bend, if it was this one that went on.
        width: Of the typical strand, pixels.
    """
    doubts: list[list[str]] = [[] for _ in curves]
    ends = [(k, e) for k, lies in enumerate(inside) for e in (0, 1) if lies[e]]
    for k, e in ends:
        if margins[k][e] < _CLEAR_END:
            doubts[k].append("it ends on another rope, and may as well go on there")
    for (k, e), (other, f) in combinations(ends, 2):
        if k != other and np.linalg.norm(curves[k][-e] - curves[other][-f]) < _NEAR * width:
            for each in (k, other):
                doubts[each].append("it ends where another rope ends: the two may be one")
    for k, curve in enumerate(curves):
        if sharpest_turn(curve, _CHORD * width) > _SHARP:
            doubts[k].append("it turns sharply where ropes meet")
    return doubts


def goes_on_beyond(curve: Array, width: float, region: Region) -> bool:
    """Return whether a mask sticks out of the rope on which a strand ends, straight on at the other side.

    Args:
        curve: ``(P, 2)`` pixels, from the end that lies on another rope.
        width: Of the strand, pixels.
        region: The mask.
    """
    ahead = -lead(curve, 1.5 * width).heading
    reach = int(_BEYOND * width) + 2
    column, row = int(curve[0, 0]) - region.window.left, int(curve[0, 1]) - region.window.top
    left, top = max(column - 2 * reach, 0), max(row - 2 * reach, 0)
    near = np.pad((region.mask[top : row + 2 * reach, left : column + 2 * reach] > 0).view(np.uint8), 1)
    depth = np.asarray(cv2.distanceTransform(near, cv2.DIST_L2, 5))
    places = curve[0] - (region.window.left + left - 1, region.window.top + top - 1)
    steps = np.rint(places + np.arange(reach)[:, None] * ahead).astype(np.intp)
    steps = steps[(steps >= 0).all(axis=1) & (steps < near.shape[::-1]).all(axis=1)]
    along = depth[steps[:, 1], steps[:, 0]]
    stop = int(np.argmin(along > 0)) if (along == 0).any() else len(along)
    if stop < 2:
        return False
    axis = int(np.argmax(along[: min(stop, int(2 * width) + 2)]))
    return stop - axis > _SLANT * float(along[axis]) + _STICKS_OUT * width


def sharpest_turn(curve: Array, chord: float) -> float:
    """Return the largest angle between two chords of a curve that meet, radians; 0 for a curve that is too short.

    Args:
        curve: ``(P, 2)`` pixels.
        chord: The length of curve that each spans, pixels.
    """
    curve = np.ascontiguousarray(curve)
    arc = arc_length(curve)
    points = interpolate(curve, arc, np.arange(0.0, float(arc[-1]), chord / _PROBES))
    if len(points) <= 2 * _PROBES:
        return 0.0
    before = points[_PROBES:-_PROBES] - points[: -2 * _PROBES]
    after = points[2 * _PROBES :] - points[_PROBES:-_PROBES]
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    return float(np.abs(np.arctan2(cross, np.sum(before * after, axis=1))).max())
