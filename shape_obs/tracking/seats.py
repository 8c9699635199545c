"""Which of the objects in a mask is which: each is seated in the slot whose track or anchor it fits best."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.polyline import resample
from shape_obs.initialization.objects import COMPARED, SceneObject

Array = npt.NDArray[np.float64]

_MISSING: Final = 0.3  # weight of what an object lacks of a track, over that of what it has more: a part may be hidden
_LONGER: Final = 1.05  # of the length that is known: more is no noise


def distances(objects: Sequence[SceneObject], tracks: Sequence[Array | None]) -> tuple[Array, Array]:
    """Return how far objects lie from where those of the slots should be, on average, and these from them.

    Args:
        objects: What was found in this frame, O of them.
        tracks: ``(N, 2)`` pixels each, where the object of a slot should be; None for a slot without a track.

    Returns:
        ``(K, O)`` pixels, of the points of each object from each track, and ``(K, O)`` of the track's points from the
        object, whatever their directions; infinity without a track.
    """
    away = np.full((2, len(tracks), len(objects)), np.inf)
    curves = [resample(found.curve.points, COMPARED) for found in objects]
    for k, nodes in enumerate(tracks):
        if nodes is None:
            continue
        known = resample(nodes, COMPARED)
        for at, curve in enumerate(curves):
            between = np.linalg.norm(curve[:, None] - known, axis=2)
            away[:, k, at] = between.min(axis=1).mean(), between.min(axis=0).mean()
    return away[0], away[1]


def seat_tracked(
    objects: Sequence[SceneObject], away: tuple[Array, Array], reach: Sequence[float], lengths: Sequence[float]
) -> list[int]:
    """Return the object of each slot that has a track, -1 for the others: those that are nearest overall.

    The assignment of H. W. Kuhn, "The Hungarian Method for the Assignment Problem", 1955.

    Args:
        objects: What was found in this frame.
        away: See ``distances``.
        reach: Pixels, for each slot: an object that lies farther from its track on average is another one.
        lengths: Pixels, for each slot: what is clearly longer than the object was is another one; inf if unknown.
    """
    seats, sizes = [-1] * len(reach), np.array([each.curve.size for each in objects])
    cost = away[0] + _MISSING * away[1] + np.maximum(sizes - _LONGER * np.array(lengths)[:, None], 0.0)
    within = cost <= np.array(reach)[:, None]
    if not within.any():
        return seats
    from scipy.optimize import linear_sum_assignment  # takes a third of a second to import

    # A slot without an object costs the same whichever it is, so that what was lost for long takes no other one's.
    for k, at in zip(*linear_sum_assignment(np.where(within, cost, max(reach))), strict=True):
        if within[k, at]:
            seats[k] = int(at)
    return seats


def add_pieces(seats: Sequence[int], distance: Array, reach: float) -> list[list[int]]:
    """Return all objects of each slot: what is left over may be pieces of ropes that something cuts.

    Args:
        seats: The object of each slot, -1 for none.
        distance: ``(K, O)`` how far the objects lie from the tracks, see ``distances``.
        reach: Pixels: a piece lies on average at most so far from the track of its rope, and twice as far from others.
    """
    pieces = [[at] if at >= 0 else [] for at in seats]
    for at, away in enumerate(distance.T):
        nearest = int(np.argmin(away))
        if at not in seats and away[nearest] <= reach and (np.delete(away, nearest) > 2 * away[nearest]).all():
            pieces[nearest].append(at)
    return pieces


def seat_others(
    objects: Sequence[SceneObject],
    seats: Sequence[int],
    targets: Sequence[Array | None],
    free: Sequence[int],
    kept: Collection[int],
) -> list[int]:
    """Return the object of each slot, after objects that no track has claimed took the free slots.

    Objects go to the anchors that they are nearest to; the largest of the others to the other slots, in the order in
    which they begin from the top left.

    Args:
        objects: Largest first.
        seats: Those that are taken, see ``seat_tracked``.
        targets: ``(2,)`` pixel of the anchor of each slot, or None.
        free: Slots that may take an object, the first ones rather than the last.
        kept: Objects that lie where that of a slot is expected: no other slot may take them.
    """
    taken, left = list(seats), [at for at in range(len(objects)) if at not in seats and at not in kept]
    anchored = [k for k in free if targets[k] is not None]
    if anchored and left:
        from scipy.optimize import linear_sum_assignment

        cost = np.array([[_away(objects[at], targets[k]) for at in left] for k in anchored])
        for row, column in zip(*linear_sum_assignment(cost), strict=True):
            taken[anchored[row]] = left[column]
    open_slots = [k for k in free if targets[k] is None]
    largest = [at for at in left if at not in taken][: len(open_slots)]
    corner = np.zeros(2)
    for k, at in zip(open_slots, sorted(largest, key=lambda at: _away(objects[at], corner)), strict=False):
        taken[k] = at
    return taken


def _away(found: SceneObject, target: Array | None) -> float:
    """Return how far an object begins from a pixel."""
    assert target is not None
    return float(np.linalg.norm(found.starts - target, axis=1).min())
