"""What speaks against the curves of several ropes in one mask: sharp turns, gaps, and pixels of no rope."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.observed import Observed
from shape_obs.image.region import Region
from shape_obs.initialization.strand_curves import sharp_turns

Array = npt.NDArray[np.float64]

TURN: Final = 3.0  # squares of a width of rope not seen that a sharp turn, or a bend of 1 rad^2, counts as
NEXT_TO: Final = 4.0  # widths: nearer to each other, ropes run along each other and may be taken for one another
_LEAST: Final = 3  # nodes next to another rope: fewer do not show on which side it lies
_BESIDE: Final = 0.8  # widths between the middles: ropes that touch have 1, ropes that lie over each other less
_TREMOR: Final = 0.1  # rad^2, see ``more_bent``: what noise adds from frame to frame where strands cross
_TAKEN: Final = 0.15  # share of a rope's points that lie where a lost rope is expected: more belong to that one
_MOST: Final = 0.6  # share of a rope's points: so many show that it lies where another rope is
_HIDDEN: Final = 0.03  # share of a rope that is not seen, at least, if it may be another one's; noise hides less


def doubtful_area(curve: FittedCurve, width: float) -> float:
    """Return how many pixels of a rope are in doubt: those that were not seen, and those of sharp turns.

    Args:
        curve: In pixels.
        width: Of the rope, pixels.
    """
    turns = doubtful_turns(curve, width) * TURN * width
    return (curve.unsupported_fraction * curve.size + turns) * width


def doubtful_turns(curve: FittedCurve, width: float) -> int:
    """Return how often a rope turns more sharply than ropes do."""
    return sharp_turns(np.ascontiguousarray(curve.points), width)


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
    seen = np.ascontiguousarray(form.points[~form.interpolated][::4])  # a width apart
    if taken_over(seen, own, lost, width) > _TAKEN or taken_over(seen, own, found, width) > _MOST:
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
    away, _ = sides_of(seen, np.ascontiguousarray(other.points))
    return len(away) > 0 and bool(np.mean(away < width / 2) > _MOST)


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
    least = np.min([sides_of(points, other)[0] for other in others], axis=0)
    return float(np.mean(sides_of(points, own)[0] > least + margin))


def changed_sides(before: Array, other_before: Array, after: Array, other_after: Array, width: float) -> bool:
    """Return whether a rope that ran along another one runs along its other side now, without lying over it.

    Args:
        before: ``(K, 2)`` pixels, the nodes of the rope in the last frame.
        other_before: ``(J, 2)`` those of the other one.
        after: ``(K, 2)`` the same nodes in this frame.
        other_after: ``(J, 2)`` those of the other one.
        width: Of the ropes, pixels.
    """
    (was, side_before), (now, side) = sides_of(before, other_before), sides_of(after, other_after)
    near = (np.maximum(was, now) < NEXT_TO * width) & (side_before * side != 0)
    changed = near & (side_before != side)
    count = np.count_nonzero(near)
    if count < _LEAST or np.count_nonzero(changed) < _MOST * count:
        return False
    return bool(np.median(now[changed]) > _BESIDE * width)


@compiled("(f8[:,::1], f8[:,::1])")
def sides_of(points: Array, curve: Array) -> tuple[Array, Array]:
    """Return how far points lie from a polyline, and on which side of it.

    Args:
        points: ``(N, 2)`` pixels.
        curve: ``(K, 2)`` pixels.

    Returns:
        ``(N,)`` distances, pixels, and ``(N,)`` sides: -1 for the left as the image is seen, 1 for the right, 0 beyond
        the ends.
    """
    away, side, last = np.empty(len(points)), np.zeros(len(points)), len(curve) - 2
    for n in range(len(points)):
        least = np.inf
        for p in range(last + 1):
            du, dv = curve[p + 1, 0] - curve[p, 0], curve[p + 1, 1] - curve[p, 1]
            u, v = points[n, 0] - curve[p, 0], points[n, 1] - curve[p, 1]
            share = (u * du + v * dv) / max(du * du + dv * dv, 1e-12)
            inside = min(max(share, 0.0), 1.0)
            square = (u - inside * du) ** 2 + (v - inside * dv) ** 2
            if square < least:
                beyond = (p == 0 and share < 0) or (p == last and share > 1)
                least, side[n] = square, 0.0 if beyond else 1.0 if du * v > dv * u else -1.0
        away[n] = np.sqrt(least)
    return away, side
