"""The curves of strands: a skeleton's branches without their stairs, cut where strands meet, and joined end to end."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.polyline import arc_length
from shape_obs.initialization.gaps import hermite
from shape_obs.initialization.junctions import Arm
from shape_obs.initialization.skeleton import Branch

Array = npt.NDArray[np.float64]

_SMOOTHING: Final = 0.35  # widths, sigma of a blur along a branch: less leaves stairs of pixels, more cuts the bends
_CUT: Final = 0.4  # widths that a free end is cut by, where the skeleton may turn into a corner of the rope's end
_FOLLOWED: Final = 2.0  # widths of a shared branch along which strands are followed; a shorter one is passed smoothly


class Strand(NamedTuple):
    """A piece of rope that goes on straight over all crossings, from where it begins to where it ends.

    Args:
        curve: ``(P, 2)`` pixels at even steps, in no particular direction.
        width: Pixels.
        inside: Whether its first and its last end lie on another strand, instead of freely.
        closed: Whether it is a ring, cut open somewhere.
        doubts: Why it may be wrong, in words.
    """

    curve: Array
    width: float
    inside: tuple[bool, bool] = (False, False)
    closed: bool = False
    doubts: tuple[str, ...] = ()

    @property
    def length(self) -> float:
        """The length, pixels."""
        return float(arc_length(np.ascontiguousarray(self.curve))[-1])


def smooth_branch(branch: Branch, width: float) -> Branch:
    """Return a branch without the staircase of pixels; its ends stay."""
    if len(branch.points) < 3:
        return branch
    sigma = _SMOOTHING * width * (len(branch.points) - 1) / max(branch.length, 1e-9)
    return Branch(smooth_curve(branch.points, sigma), branch.radius, branch.nodes)


@compiled("(f8[:,::1], f8)")
def smooth_curve(curve: Array, sigma: float) -> Array:
    """Return a curve ``(P, 2)`` blurred along its points, of which ``sigma`` is a number; its ends stay.

    Beyond its ends it goes on as its image in a point.
    """
    last, reach = len(curve) - 1, int(4 * sigma + 0.5)
    weight = np.exp(-0.5 * (np.arange(reach + 1) / sigma) ** 2)
    weight /= 2 * weight.sum() - weight[0]
    smooth = weight[0] * curve
    for d in range(2):
        for p in range(last + 1):
            for i in range(1, reach + 1):
                before = curve[p - i, d] if p >= i else 2 * curve[0, d] - curve[min(i - p, last), d]
                beyond = p + i - last
                after = curve[p + i, d] if beyond <= 0 else 2 * curve[last, d] - curve[max(last - beyond, 0), d]
                smooth[p, d] += weight[i] * (before + after)
    return smooth


def clear_part(branch: Branch, free_start: bool, free_end: bool, width: float) -> Array:
    """Return the part of a branch that is clear of the zones at its ends: there the skeleton runs between strands."""
    start = _CUT * width if free_start else branch.radius.item(0)
    end = _CUT * width if free_end else branch.radius.item(-1)
    return middle_part(branch.points, start, end)


@compiled("(f8[:,::1], f8, f8)")
def middle_part(curve: Array, start: float, end: float) -> Array:
    """Return a curve without so many pixels at its start and its end; of a short one its middle is left."""
    arc = arc_length(curve)
    share = min(1.0, 0.7 * arc[-1] / max(start + end, 1e-9))
    first, last = np.searchsorted(arc, start * share), np.searchsorted(arc, arc[-1] - end * share)
    return curve[first : max(last, first + 2)]


def strand_curve(
    route: list[Arm],
    trimmed: dict[int, Array],
    partner: dict[Arm, Arm],
    ways: dict[tuple[Arm, Arm], Array],
    width: float,
) -> Array:
    """Return a strand's branches, and smooth curves through the zones between them."""
    pieces = [np.ascontiguousarray(trimmed[i][:: 1 - 2 * end]) for i, end in route]
    if route[0] in partner:  # a ring is cut open where the first branch begins
        pieces.append(pieces[0][:1])
    run = [pieces[0]]
    for (i, end), before, after in zip(route, pieces[:-1], pieces[1:], strict=False):
        leaves = (i, 1 - end)
        way = ways.get((leaves, partner[leaves]))
        if way is not None and len(way) > _FOLLOWED * width:
            run += [joint(before, way, width), way, joint(way, after, width), after]
        else:
            run += [joint(before, after, width), after]
    return np.concatenate(run)


@compiled("(f8[:,::1], f8[:,::1], f8)")
def joint(before: Array, after: Array, width: float) -> Array:
    """Return the points between two curves, with steps of about a pixel."""
    reach = max(int(np.rint(width / 2)), 1)
    out = before[-1] - before[-min(reach + 1, len(before))]
    into = after[min(reach, len(after) - 1)] - after[0]
    out /= max(np.hypot(out[0], out[1]), 1e-9)
    into /= max(np.hypot(into[0], into[1]), 1e-9)
    return hermite(before[-1], out, after[0], into, 1.0)
