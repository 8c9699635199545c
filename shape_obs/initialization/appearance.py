"""By what ropes differ where they meet: how wide a strand is next to the place, and which colour it has there."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.observed import MAD_SIGMA
from shape_obs.geometry.polyline import arc_length
from shape_obs.initialization.skeleton import Branch

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]

_ALONG: Final = 6.0  # widths from where a strand is clear of the others, over which it is measured
_UNEVEN: Final = 0.07  # share of a rope's width by which two of its pieces differ (standard deviation)
_PIXELS: Final = 0.9  # pixels by which they differ as well: the error of two widths in a mask
_GREY: Final = 9.0  # grey levels by which the colours of two pieces of a rope differ
# Brightness, red against green, yellow against blue: brightness counts less, it changes with the direction of light.
_OPPONENT: Final = np.array([[0.12, 0.12, 0.12], [0.7, -0.7, 0.0], [0.4, 0.4, -0.8]]).T  # grey levels from RGB


class Look(NamedTuple):
    """What a strand looks like near one of its ends.

    Args:
        width: Pixels; 0 if it is not known.
        uneven: Standard deviation of the width along the strand, pixels.
        colour: ``(3,)`` brightness and two differences of colours, grey levels; None if it is not known.
        mixed: Standard deviation of the colour along the strand, grey levels.
    """

    width: float = 0.0
    uneven: float = 0.0
    colour: Array | None = None
    mixed: float = 0.0


def misfit(one: Look, other: Look) -> float:
    """Return how unlike two strands are, nats: half the squared standard deviations of what is known of both."""
    found = 0.0
    if one.width and other.width:
        error = math.hypot(_UNEVEN * (one.width + other.width) / 2, _PIXELS, one.uneven, other.uneven)
        found += 0.5 * ((one.width - other.width) / error) ** 2
    if one.colour is not None and other.colour is not None:
        apart, error = np.linalg.norm(one.colour - other.colour), math.hypot(_GREY, one.mixed, other.mixed)
        found += 0.5 * float(apart / error) ** 2
    return found


def looks_of_ends(branches: list[Branch], ends: list[int], free: set[int], picture: Picture | None) -> dict[int, Look]:
    """Return what each end of the places where strands meet looks like.

    Args:
        branches: With the skeleton's radii.
        ends: Of branches: 2 i and 2 i + 1 are those of branch i.
        free: Those where a rope ends.
        picture: ``(H, W, 3)`` RGB; None without one.
    """
    arcs = {i: arc_length(np.ascontiguousarray(branches[i].points)) for i in {end // 2 for end in ends}}
    typical = {i: _middle(branches[i].radius) for i in arcs}
    return {
        end: _look(branches[end // 2], end % 2, arcs[end // 2], typical[end // 2], end ^ 1 in free, picture)
        for end in ends
    }


def look_of_end(curve: Array, width: float, picture: Picture | None) -> Look:
    """Return what a strand looks like near the first of its points, ``(P, 2)`` pixels."""
    arc = arc_length(np.ascontiguousarray(curve))
    near = curve[arc <= _ALONG * width]
    colour, mixed = _colour(near, picture)
    return Look(width, 0.0, colour, mixed)


def _look(branch: Branch, side: int, arc: Array, typical: float, ends_freely: bool, picture: Picture | None) -> Look:
    radius, length = branch.radius, float(arc[-1])
    # Where the disc at the node ends, and the corners that it fills.
    start = float(radius[-side]) + 0.5 * typical
    stop = length - (typical if ends_freely else float(radius[side - 1]) + 0.5 * typical)
    stop = min(stop, start + _ALONG * 2 * typical)
    if stop - start < max(typical, 3.0):
        return Look()
    low, high = (length - stop, length - start) if side else (start, stop)
    first, last, middle, deviation = middle_width(radius, arc, low, high)
    colour, mixed = _colour(branch.points[first:last], picture)
    return Look(middle, MAD_SIGMA * deviation, colour, mixed)


@compiled("(f8[::1], f8[::1], f8, f8)")
def middle_width(radius: Array, arc: Array, low: float, high: float) -> tuple[int, int, float, float]:
    """Return the points of a branch between two places, the median width there, and its median deviation.

    Args:
        radius: ``(P,)`` along the branch, pixels.
        arc: ``(P,)`` its arc length.
        low: Where the part begins along it; some points lie in it.
        high: Where it ends.
    """
    first, last = int(np.searchsorted(arc, low)), int(np.searchsorted(arc, high))
    widths = 2 * radius[first:last]
    middle = np.sort(widths)[len(widths) // 2]
    return first, last, middle, np.sort(np.abs(widths - middle))[len(widths) // 2]


def _colour(points: Array, picture: Picture | None) -> tuple[Array | None, float]:
    """Return the median colour of a picture along ``(P, 2)`` pixels, and how much it varies."""
    if picture is None or not len(points):
        return None, 0.0
    high, wide = picture.shape[:2]
    column = np.clip(np.rint(points[:, 0]).astype(np.intp), 0, wide - 1)
    row = np.clip(np.rint(points[:, 1]).astype(np.intp), 0, high - 1)
    colours = picture[row, column].astype(np.float64) @ _OPPONENT
    middle = np.sort(colours, axis=0)[len(colours) // 2]
    return middle, MAD_SIGMA * _middle(np.sqrt(np.sum((colours - middle) ** 2, axis=1)))


def _middle(values: Array) -> float:
    """Return the median of ``(P,)`` values, of an even number the upper one."""
    return float(np.sort(values)[len(values) // 2])
