"""Which of the objects in a mask is which: each is seated in the slot whose track or anchor it fits best."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.polyline import arc_length, interpolate
from shape_obs.initialization.objects import COMPARED, SceneObject

Array = npt.NDArray[np.float64]

_MISSING: Final = 0.3  # weight of what an object lacks of a track, over that of what it has more: a part may be hidden
_LONGER: Final = 1.05  # of the length that is known: more is no noise


def seat_tracked(
    objects: Sequence[SceneObject],
    tracks: Sequence[Array | None],
    reach: Sequence[float],
    lengths: Sequence[float],
) -> list[int]:
    """Return the object of each slot that has a track, -1 for the others: those that are nearest overall.

    The assignment of H. W. Kuhn, "The Hungarian Method for the Assignment Problem", 1955.

    Args:
        objects: What was found in this frame.
        tracks: ``(K, 2)`` pixels each, where the object of a slot should be; None for a slot without a track.
        reach: Pixels, for each slot: an object that lies farther from its track on average is another one.
        lengths: Pixels, for each slot: what is clearly longer than the object was is another one; inf if unknown.
    """
    seats, known = [-1] * len(tracks), [k for k, nodes in enumerate(tracks) if nodes is not None]
    if not known or not objects:
        return seats
    from scipy.optimize import linear_sum_assignment  # takes a third of a second to import

    cost = np.array([[_apart(each.curve.points, tracks[k]) for each in objects] for k in known])
    sizes = np.array([each.curve.size for each in objects])
    cost += np.array([np.maximum(sizes - _LONGER * lengths[k], 0.0) for k in known])
    within = cost <= np.array([[reach[k]] for k in known])
    # A slot without an object costs the same whichever it is, so that what was lost for long takes no other one's.
    for row, at in zip(*linear_sum_assignment(np.where(within, cost, max(reach))), strict=True):
        if within[row, at]:
            seats[known[row]] = int(at)
    return seats


def near_tracks(objects: Sequence[SceneObject], tracks: Sequence[Array | None], reach: float) -> set[int]:
    """Return the objects that lie, on average, within some pixels of where the object of a slot should be."""
    known = [_sampled(nodes) for nodes in tracks if nodes is not None]
    return {
        at
        for at, found in enumerate(objects)
        if any(_distances(_sampled(found.curve.points), nodes).min(axis=1).mean() <= reach for nodes in known)
    }


def add_pieces(
    objects: Sequence[SceneObject], seats: Sequence[int], tracks: Sequence[Array | None], reach: float
) -> list[list[int]]:
    """Return all objects of each slot: what is left over may be pieces of ropes that something cuts.

    Args:
        objects: What was found in this frame.
        seats: The object of each slot, -1 for none.
        tracks: ``(K, 2)`` pixels each, where the object of a slot should be; None for a slot without a track.
        reach: Pixels: a piece lies on average at most so far from the track of its rope, and twice as far from others.
    """
    pieces = [[at] if at >= 0 else [] for at in seats]
    known = [k for k, nodes in enumerate(tracks) if nodes is not None]
    for at, found in enumerate(objects):
        if at in seats or not known:
            continue
        away = [float(_distances(_sampled(found.curve.points), _sampled(tracks[k])).min(axis=1).mean()) for k in known]
        order = np.argsort(away)
        clear = len(order) == 1 or away[order[1]] > 2 * away[order[0]]
        if away[order[0]] <= reach and clear:
            pieces[known[order[0]]].append(at)
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


def _apart(curve: Array, nodes: Array | None) -> float:
    """Return the mean distance of two curves, whatever their direction."""
    distance = _distances(_sampled(curve), _sampled(nodes))
    return float(distance.min(axis=1).mean() + _MISSING * distance.min(axis=0).mean())


def _distances(one: Array, other: Array) -> Array:
    """Return the distance of each of ``(N, 2)`` pixels to each of ``(M, 2)``."""
    from scipy.spatial.distance import cdist  # takes 0.1 s to import

    return np.asarray(cdist(one, other), np.float64)


def _sampled(curve: Array | None) -> Array:
    assert curve is not None
    curve = np.ascontiguousarray(curve)
    arc = arc_length(curve)
    return interpolate(curve, arc, np.linspace(0.0, arc[-1], COMPARED))
