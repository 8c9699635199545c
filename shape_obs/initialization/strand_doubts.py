"""Why a strand of several ropes may be wrong: how it ends on another rope, how it turns, and what it runs through."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.image.region import Region
from shape_obs.initialization.gaps import CLEAR, NEAR, NOISE, lead, sharp_turns
from shape_obs.initialization.junctions import Overlap

Array = npt.NDArray[np.float64]
Ends = tuple[bool, bool]
Row = Sequence[tuple[float, Any]]  # what each way to pair the strands of a zone bends, and the pairs; least first

_WIDE: Final = 3.0  # times a strand's median width: places where ropes meet are narrower, other things may be wider
_SLANT: Final = 1.2  # times half a rope's width over the sine of the angle: how far its border may be, straight on
_STICKS_OUT: Final = 0.3  # widths that a mask reaches beyond a rope's border if something sticks out, not noise
_LEAST_SINE: Final = 0.35  # of the angle of two ropes, 20 degrees: at a smaller one the border is too far away to see


def strand_doubts(
    curves: Sequence[Array],
    inside: Sequence[Ends],
    margins: Sequence[tuple[float, float]],
    radii: Sequence[Array],
    width: float,
) -> list[list[str]]:
    """Return why each strand may be wrong, in words.

    Args:
        curves: ``(P_i, 2)`` pixels each.
        inside: Whether the first and the last end of each lie on another strand.
        margins: By how much more the strands where each end lies would bend, if it was this one that went on.
        radii: ``(R_i,)`` along the branches of each, to the nodes at their ends, pixels.
        width: Of the typical strand, pixels.
    """
    doubts: list[list[str]] = [[] for _ in curves]
    ends = [(k, e) for k, lies in enumerate(inside) for e in (0, 1) if lies[e]]
    for k, e in ends:
        if margins[k][e] < CLEAR:
            doubts[k].append("it ends on another rope, and may as well go on there")
    for (k, e), (other, f) in combinations(ends, 2):
        if k != other and np.linalg.norm(curves[k][-e] - curves[other][-f]) < NEAR * width:
            for each in (k, other):
                doubts[each].append("it ends where another rope ends: the two may be one")
    for k, curve in enumerate(curves):
        if sharp_turns(np.ascontiguousarray(curve), width):
            doubts[k].append("it turns sharply where ropes meet")
        own = np.sort(radii[k])
        if own[-1] > _WIDE * own[len(own) // 2]:
            doubts[k].append(f"it runs through something {own[-1] / own[len(own) // 2]:.1f} times as wide")
    return doubts


def zone_doubts(
    options: Mapping[int, Row], chosen: Mapping[int, int], overlaps: Mapping[int, Overlap]
) -> Iterator[tuple[int, str]]:
    """Return the zones whose strands may go on otherwise, and why."""
    for zone, row in options.items():
        if zone in overlaps:
            if overlaps[zone].doubt:
                yield zone, overlaps[zone].doubt
        elif margin_of(row, chosen[zone]) < NOISE:
            yield zone, "at a crossing, two ways to go on are about equally straight"


def margin_of(row: Row, chosen: int) -> float:
    """Return by how much the best of the other pairings bends more than the chosen one; inf without another one."""
    return row[1 if chosen == 0 else 0][0] - row[chosen][0] if len(row) > 1 else np.inf


class Beyond(NamedTuple):
    """What lies straight on beyond the end of a strand on another rope.

    Args:
        border: How far from the end the mask reaches, pixels.
        sticks_out: Whether that is farther than the other rope's border.
    """

    border: float
    sticks_out: bool


def reach_beyond(curve: Array, width: float, region: Region) -> Beyond:
    """Return how far a mask goes straight on where a strand ends on another rope.

    Args:
        curve: ``(P, 2)`` pixels, from the end that lies on another rope.
        width: Of the strand, pixels.
        region: The mask.
    """
    ahead = -lead(curve, width).heading
    reach = int(NEAR * width) + 2
    column, row = int(curve[0, 0]) - region.window.left, int(curve[0, 1]) - region.window.top
    left, top = max(column - 2 * reach, 0), max(row - 2 * reach, 0)
    near = np.pad((region.mask[top : row + 2 * reach, left : column + 2 * reach] > 0).view(np.uint8), 1)
    depth = np.asarray(cv2.distanceTransform(near, cv2.DIST_L2, 5))
    places = curve[0] - (region.window.left + left - 1, region.window.top + top - 1)
    along = _values(depth, places + np.arange(reach)[:, None] * ahead)
    stop = int(np.argmin(along > 0)) if (along == 0).any() else len(along)
    if stop < 2:
        return Beyond(float(stop), False)
    axis = int(np.argmax(along[: min(stop, int(2 * width) + 2)]))
    radius = float(along[axis])
    # The other rope runs where the mask is thick to both sides; its border is a radius over the sine from its axis.
    angles = np.deg2rad(np.arange(0.0, 180.0, 6.0))
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    sides = [_values(depth, places + axis * ahead + side * 2 * radius * ways) for side in (-1, 1)]
    way = ways[int(np.argmax(sides[0] + sides[1]))]
    sine = max(abs(float(ahead[0] * way[1] - ahead[1] * way[0])), _LEAST_SINE)
    return Beyond(float(stop), stop - axis > _SLANT * radius / sine + _STICKS_OUT * width)


def _values(image: npt.NDArray[Any], places: Array) -> Array:
    """Return an image's values at ``(N, 2)`` places, 0 outside."""
    column, row = np.rint(places).astype(np.intp).T
    inside = (row >= 0) & (column >= 0) & (row < image.shape[0]) & (column < image.shape[1])
    return np.where(inside, image[np.where(inside, row, 0), np.where(inside, column, 0)], 0.0)
