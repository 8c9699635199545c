"""The curves of strands: a skeleton's branches without their stairs, cut where strands meet, and joined end to end."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.polyline import arc_length, interpolate
from shape_obs.initialization.pairing import CHORD, Index, lead
from shape_obs.initialization.skeleton import Branch

Array = npt.NDArray[np.float64]

_SMOOTHING: Final = 0.35  # widths, sigma of a blur along a branch: less leaves stairs of pixels, more cuts the bends
_CUT: Final = 0.4  # widths that a free end is cut by, where the skeleton may turn into a corner of the rope's end
_FOLLOWED: Final = 2.0  # widths of a shared branch along which strands are followed; a shorter one is passed smoothly
_RAGGED: Final = 0.7  # widths of a piece cut off at a gap: at a slanting cut an axis runs into the sharper corner
_TANGENT: Final = 1.0  # widths over which the direction of a bridge is taken at its ends
_SHARP: Final = math.radians(75)  # between two chords; in a circle two widths in diameter they turn by 43 degrees


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
    route: list[int], trimmed: dict[int, Array], partner: Index, ways: dict[tuple[int, int], Array], width: float
) -> Array:
    """Return a strand's branches, and smooth curves through the zones between them.

    Args:
        route: By which end each branch is entered.
        trimmed: The part of each branch that is clear of the zones.
        partner: ``(2B,)`` which end goes on as which.
        ways: The ways of strands along shared branches, between two ends.
        width: Of the typical strand, pixels.
    """
    pieces = [np.ascontiguousarray(trimmed[end // 2][:: 1 - 2 * (end % 2)]) for end in route]
    if partner[route[0]] != route[0]:  # a ring is cut open where the first branch begins
        pieces.append(pieces[0][:1])
    run = pieces[:1]
    for end, after in zip(route, pieces[1:], strict=False):
        way = ways.get((end ^ 1, int(partner[end ^ 1])))
        for piece in (after,) if way is None or len(way) <= _FOLLOWED * width else (way, after):
            run += [joint(run[-1], piece, width), piece]
    return np.concatenate(run)


@compiled("(f8[:,::1], f8[:,::1], f8)")
def joint(before: Array, after: Array, width: float) -> Array:
    """Return the points between two curves, with steps of about a pixel."""
    reach = max(int(np.rint(width / 2)), 1)
    back, ahead = before[-min(reach + 1, len(before))], after[min(reach, len(after) - 1)]
    start, end = complex(before[-1, 0], before[-1, 1]), complex(after[0, 0], after[0, 1])
    out, into = start - complex(back[0], back[1]), complex(ahead[0], ahead[1]) - end
    return hermite(start, out / max(abs(out), 1e-9), end, into / max(abs(into), 1e-9), 1.0)


@compiled("(c16, c16, c16, c16, f8)")
def hermite(start: complex, out: complex, end: complex, into: complex, step: float) -> Array:
    """Return a smooth curve ``(P, 2)`` between two points u + v i with given unit tangents along it, without ends."""
    length = abs(end - start)
    pieces = max(int(np.rint(length / step)), 1)
    curve = np.empty((pieces - 1, 2))
    for p in range(pieces - 1):
        t = (p + 1) / pieces
        place = (1 + 2 * t) * (1 - t) ** 2 * start + t**2 * (3 - 2 * t) * end
        place += t * (1 - t) * length * ((1 - t) * out - t * into)
        curve[p, 0], curve[p, 1] = place.real, place.imag
    return curve


def join(pieces: list[Array], width: float) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return pieces that follow each other as one curve with smooth bridges, and which of its points lie on those.

    Args:
        pieces: ``(P_i, 2)`` curves, pixels, in their order and direction.
        width: Of the rope, pixels.
    """
    run: list[Array] = []
    for place, piece in enumerate(pieces):
        piece = without_ragged_ends(piece, width, start=place > 0, end=place < len(pieces) - 1)
        if run:
            before, after = lead(run[-1][::-1], width, _TANGENT), lead(piece, width, _TANGENT)
            run.append(hermite(complex(*run[-1][-1]), -before.heading, complex(*piece[0]), after.heading, width / 4))
        run.append(piece)
    is_gap = [np.full(len(part), i % 2 == 1) for i, part in enumerate(run)]
    return np.concatenate(run), np.concatenate(is_gap)


def without_ragged_ends(piece: Array, width: float, *, start: bool = True, end: bool = True) -> Array:
    """Return a piece without its ragged ends."""
    piece = np.ascontiguousarray(piece)
    arc = arc_length(piece)
    cut = min(_RAGGED * width, 0.3 * float(arc[-1]))
    low, high = cut * start, arc[-1] - cut * end
    first, last = interpolate(piece, arc, np.array([low, high]))
    return np.concatenate([first[None], piece[(arc > low) & (arc < high)], last[None]])


@compiled("(f8[:,::1], f8)")
def sharp_turns(points: Array, width: float) -> int:
    """Return how often a curve turns more sharply between two chords that meet than ropes do.

    Args:
        points: ``(P, 2)`` pixels.
        width: Of the rope, pixels.
    """
    arc, reach, limit = arc_length(points), CHORD * width, math.cos(_SHARP)
    found, free, before, after = 0, 0.0, 0, 0
    for p in range(len(points)):
        if arc[p] < reach or arc[-1] - arc[p] < reach:
            continue
        while arc[before + 1] <= arc[p] - reach:
            before += 1
        while arc[after] < arc[p] + reach and after < len(points) - 1:
            after += 1
        if arc[p] < free:
            continue
        du, dv = points[p, 0] - points[before, 0], points[p, 1] - points[before, 1]
        far_u, far_v = points[after, 0] - points[p, 0], points[after, 1] - points[p, 1]
        if du * far_u + dv * far_v < limit * np.hypot(du, dv) * np.hypot(far_u, far_v):
            found += 1
            free = arc[p] + 2 * reach  # one turn is counted once
    return found
