"""What speaks against the curves of several ropes in one mask: sharp turns, gaps, and pixels of no rope."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.observed import Observed
from shape_obs.image.region import Region

Array = npt.NDArray[np.float64]

# A rope bends less than this between two chords of so many widths: in a circle of two widths they turn by 43 degrees.
_CHORD: Final = 1.5
_SHARP: Final = math.radians(75)
# Ropes run along each other where they are nearer than so many widths, at so many nodes; they lie side by side, and not
# over each other, where their middles are more than the last figure apart.
_NEXT_TO: Final = 4.0
_LEAST: Final = 3
_MOST_OF: Final = 0.6
_BESIDE: Final = 0.8
_TREMOR: Final = 0.1  # of the bending energy times the width, from frame to frame, where strands cross
# Points of a rope are taken over where they lie so many widths nearer to another one than to where it is expected; the
# share of them, at most, if the other one is lost, and if it is found as well.
_OTHERS: Final = 1.0
_TAKEN: Final = 0.15
_COVERED: Final = 0.5
# A rope of which more than this share is hidden is another one's if so many of its points lie nearer to that one than
# so many widths.
_HIDDEN: Final = 0.03
_CLAIMED: Final = 0.7
_SAME: Final = 0.5
_TURN: Final = 3.0  # squares of a width that a sharp turn counts as


def doubtful_area(curve: FittedCurve, width: float) -> float:
    """Return how many pixels of a rope are in doubt: those that were not seen, and those of sharp turns.

    Args:
        curve: In pixels.
        width: Of the rope, pixels.
    """
    turns = doubtful_turns(curve, width) * _TURN * width
    return (curve.unsupported_fraction * curve.size + turns) * width


def doubtful_turns(curve: FittedCurve, width: float) -> int:
    """Return how often a rope turns more sharply than ropes do."""
    return sharp_turns(np.ascontiguousarray(curve.points), curve.arc, _CHORD * width, _SHARP)


def doubt_where_they_meet(
    form: FittedCurve, own: Array, lost: Sequence[Array], found: Sequence[Array], width: float
) -> str:
    """Return why a rope that meets others may be another one, or a part of it hidden; empty if nothing says so.

    Args:
        form: What was found, in pixels.
        own: ``(K, 2)`` pixels, where the rope's nodes are expected.
        lost: ``(J, 2)`` each, where those of ropes are expected that were not found.
        found: ``(J, 2)`` each, the curves of the others.
        width: Of the rope, pixels.
    """
    seen, margin = np.ascontiguousarray(form.points[~form.interpolated][::4]), _OTHERS * width  # a width apart
    if taken_over(seen, own, lost, margin) > _TAKEN or taken_over(seen, own, found, margin) > _COVERED:
        return "what was found lies where another rope was"
    return "what was found turns sharply where ropes meet" if doubtful_turns(form, width) else ""


def claims_the_same(form: FittedCurve, other: FittedCurve, width: float) -> bool:
    """Return whether a rope, of which a part is hidden, was found where another one is that is seen better.

    Args:
        form: What was found, in pixels.
        other: The other rope.
        width: Of the ropes, pixels.
    """
    hidden = form.unsupported_fraction
    if hidden <= max(_HIDDEN, other.unsupported_fraction):
        return False
    seen = np.ascontiguousarray(form.points[~form.interpolated][::4])
    if not len(seen):
        return False
    return bool(np.mean(nearest_distances(seen, np.ascontiguousarray(other.points)) < _SAME * width) > _CLAIMED)


def folds_anew(curve: FittedCurve, observed: Observed, width: float) -> bool:
    """Return whether a rope turns sharply that was found along an axis which does not.

    Args:
        curve: In pixels.
        observed: What it was fitted to; only the mask of a rope that was found among others has an axis.
        width: Of the rope, pixels.
    """
    axis = observed.axis if isinstance(observed, Region) else None
    return axis is not None and doubtful_turns(curve, width) > doubtful_turns(axis, width)


def more_bent(nodes: Array, before: Array, width: float) -> float:
    """Return by how much the bending energy of a rope, times its width, has grown more than noise explains.

    Where ropes part again and each goes on along the other one, both get a kink.

    Args:
        nodes: ``(K, D)`` of the rope in this frame.
        before: ``(K, D)`` the same nodes in the last frame.
        width: Of the rope, in their unit.
    """
    if len(nodes) != len(before) or width <= 0:
        return 0.0
    return max((bending_energy(nodes) - bending_energy(before)) * width - _TREMOR, 0.0)


@compiled("(f8[:,::1],)")
def bending_energy(nodes: Array) -> float:
    """Return the squared curvature of a polyline, integrated over its length."""
    energy, dimension = 0.0, nodes.shape[1]
    for k in range(1, len(nodes) - 1):
        before = after = inner = 0.0
        for d in range(dimension):
            back, ahead = nodes[k, d] - nodes[k - 1, d], nodes[k + 1, d] - nodes[k, d]
            before, after, inner = before + back * back, after + ahead * ahead, inner + back * ahead
        length = (np.sqrt(before) + np.sqrt(after)) / 2
        if before > 0 and after > 0:
            energy += np.arccos(min(max(inner / np.sqrt(before * after), -1.0), 1.0)) ** 2 / length
    return energy


@compiled("(f8[:,::1], f8[::1], f8, f8)")
def sharp_turns(points: Array, arc: Array, reach: float, angle: float) -> int:
    """Return how often a curve turns by more than an angle between two chords that meet.

    Args:
        points: ``(P, 2)`` pixels.
        arc: ``(P,)`` their arc length.
        reach: Along the curve, of each chord, pixels.
        angle: Radians.
    """
    found, free, before, after, limit = 0, 0.0, 0, 0, np.cos(angle)
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


def taken_over(points: Array, own: Array, others: Sequence[Array], margin: float) -> float:
    """Return the share of a rope's points that lie where another rope is expected, and not where it is itself.

    Args:
        points: ``(P, 2)`` pixels, where the rope was seen.
        own: ``(K, 2)`` pixels, where its nodes are expected.
        others: ``(J, 2)`` each, where those of the other ropes are.
        margin: Pixels: by so much another rope must be nearer.
    """
    if not others or not len(points):
        return 0.0
    away = nearest_distances(points, own)
    least = np.min([nearest_distances(points, other) for other in others], axis=0)
    return float(np.mean(away > least + margin))


@compiled("(f8[:,::1], f8[:,::1])")
def nearest_distances(points: Array, curve: Array) -> Array:
    """Return the distance of ``(N, 2)`` points from a polyline of ``(K, 2)``: ``(N,)``."""
    out = np.empty(len(points))
    for n in range(len(points)):
        least = np.inf
        for p in range(len(curve) - 1):
            du, dv = curve[p + 1, 0] - curve[p, 0], curve[p + 1, 1] - curve[p, 1]
            u, v = points[n, 0] - curve[p, 0], points[n, 1] - curve[p, 1]
            share = min(max((u * du + v * dv) / max(du * du + dv * dv, 1e-12), 0.0), 1.0)
            least = min(least, (u - share * du) ** 2 + (v - share * dv) ** 2)
        out[n] = np.sqrt(least)
    return out


def changed_sides(before: Array, other_before: Array, after: Array, other_after: Array, width: float) -> bool:
    """Return whether a rope that ran along another one runs along its other side now, without lying over it.

    Args:
        before: ``(K, 2)`` pixels, the nodes of the rope in the last frame.
        other_before: ``(J, 2)`` those of the other one.
        after: ``(K, 2)`` the same nodes in this frame.
        other_after: ``(J, 2)`` those of the other one.
        width: Of the ropes, pixels.
    """
    was, now = side_distances(before, other_before), side_distances(after, other_after)
    near = (np.abs(was) < _NEXT_TO * width) & (np.abs(now) < _NEXT_TO * width)
    changed = near & (was * now < 0)
    count = np.count_nonzero(near)
    if count < _LEAST or np.count_nonzero(changed) < _MOST_OF * count:
        return False
    return bool(np.median(np.abs(now[changed])) > _BESIDE * width)


@compiled("(f8[:,::1], f8[:,::1])")
def side_distances(points: Array, curve: Array) -> Array:
    """Return the distance of ``(N, 2)`` points from a polyline, negative on its left; inf beyond its ends."""
    out = np.full(len(points), np.inf)
    last = len(curve) - 2
    for n in range(len(points)):
        least = np.inf
        for p in range(last + 1):
            du, dv = curve[p + 1, 0] - curve[p, 0], curve[p + 1, 1] - curve[p, 1]
            u, v = points[n, 0] - curve[p, 0], points[n, 1] - curve[p, 1]
            share = (u * du + v * dv) / max(du * du + dv * dv, 1e-12)
            inside = min(max(share, 0.0), 1.0)
            away = np.hypot(u - inside * du, v - inside * dv)
            if away < least:
                least = away
                beyond = (p == 0 and share < 0) or (p == last and share > 1)
                out[n] = np.inf if beyond else away if du * v - dv * u > 0 else -away
    return out
