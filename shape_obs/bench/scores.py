"""Found points against a known curve.

Found points against a known closed outline.

Found points of a simulated object against the simulator's truth, whatever the object: rope, band or sheet.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from shape_obs.bench.synthetic.ropes import resample as resample_by_step
from shape_obs.configurations import Ends
from shape_obs.geometry.outline import clockwise
from shape_obs.geometry.polyline import arc_length, interpolate, resample
from shape_obs.geometry.topology import Chain, Grid, Ring, Topology
from shape_obs.metrics import in_order, spacing_cv

Array = npt.NDArray[np.float64]


_FINE: Final = 0.1

_BEYOND: Final = 100


class Score(NamedTuple):
    """How well ordered points follow a curve; lengths in the curve's unit.

    Args:
        ordered: The points' places along the curve strictly increase.
        flipped: They run against the curve's direction.
        distance: Mean distance of the points to the curve.
        tip: Larger distance of the first and last point to the curve's ends.
        gap_cv: Standard deviation over mean of the distances between neighbours.
        slip: Largest distance of a point from its own arc position, along the curve, in gaps.
    """

    ordered: bool
    flipped: bool
    distance: float
    tip: float
    gap_cv: float
    slip: float


def score(points: npt.ArrayLike, curve: Array, ends: Ends, *, directed: bool = True) -> Score:
    """Compare N found points with a known curve.

    Args:
        points: (N,D).
        curve: (P,D), from end to end.
        ends: Where the points belong: ``"centers"`` of N equal pieces or from tip to tip (``"tips"``).
        directed: Whether point 0 belongs to the curve's start; else either direction is right.
    """
    found = np.asarray(points, dtype=np.float64)
    forward, backward = (float(np.sum((found - _places(c, len(found), ends)) ** 2)) for c in (curve, curve[::-1]))
    flipped = backward < forward
    if flipped and not directed:
        curve, flipped = curve[::-1], False
    arc = arc_length(curve)
    fine = resample(curve, max(int(arc[-1] / _FINE * _unit_of(arc)), 2))
    distance = KDTree(fine).query(found)[0]
    # Continued beyond its ends, so that points past a tip still have an order.
    longer = np.concatenate([_beyond(fine), fine, _beyond(fine[::-1])[::-1]])
    step = arc[-1] / (len(fine) - 1)
    place = (KDTree(longer).query(found)[1] - _BEYOND) * step
    size = len(found)
    true_place = arc[-1] * ((np.arange(size) + 0.5) / size if ends == "centers" else np.linspace(0, 1, size))
    gap = arc[-1] / (size if ends == "centers" else size - 1)
    return Score(
        ordered=in_order(place),
        flipped=bool(flipped),
        distance=float(distance.mean()),
        tip=float(max(np.linalg.norm(found[0] - curve[0]), np.linalg.norm(found[-1] - curve[-1]))),
        gap_cv=spacing_cv(found, Chain(size)),
        slip=float(np.abs(place - true_place).max() / gap),
    )


def tally(scores: Sequence[Score]) -> dict[str, Any]:
    """The frames of one track, and how many of them have their order reversed or a point half a gap off its place."""
    return {
        "frames": len(scores),
        "flips": sum(s.flipped for s in scores),
        "slips": sum(s.slip > 0.5 for s in scores),
        "worst_slip": max(s.slip for s in scores),
    }


def _beyond(curve: Array) -> Array:
    """(100,D) a straight continuation before the curve's first point, at its steps."""
    return curve[0] + (curve[0] - curve[1]) * np.arange(_BEYOND, 0, -1)[:, None]


def _unit_of(arc: Array) -> float:
    """1 for curves in pixels; for curves in metres a factor that gives them as many fine points."""
    return 1.0 if arc[-1] > 10 else 1000.0


def _places(curve: Array, count: int, ends: Ends) -> Array:
    arc = arc_length(curve)
    share = (np.arange(count) + 0.5) / count if ends == "centers" else np.linspace(0, 1, count)
    return interpolate(curve, arc, share * arc[-1])


_FINE_STEP: Final = 0.1  # pixels


class OutlineScore(NamedTuple):
    """How well ordered points follow a closed outline; lengths in pixels.

    Args:
        ordered: The points' places along the outline strictly increase, once around.
        clockwise: As seen in the image.
        distance: Mean distance of the points to the outline.
        gap_cv: Standard deviation over mean of the distances between neighbours, last to first too.
        slip: Largest distance of a point from its own arc position, along the outline, in gaps; where the outline's
            first point is not where point 0 belongs, it means nothing.
    """

    ordered: bool
    clockwise: bool
    distance: float
    gap_cv: float
    slip: float


def outline_score(points: npt.ArrayLike, outline: Array) -> OutlineScore:
    """Compare N found points with a known outline.

    Args:
        points: (N,2) pixels.
        outline: (P,2) pixels, closed, clockwise as seen, from where point 0 belongs.
    """
    found = np.asarray(points, dtype=np.float64)
    fine = resample_by_step(np.concatenate([outline, outline[:1]]), _FINE_STEP)[:-1]
    distance, nearest = KDTree(fine).query(found)
    place = np.asarray(nearest, dtype=np.float64) / len(fine)
    off = (place - np.arange(len(found)) / len(found) + 0.5) % 1.0 - 0.5
    return OutlineScore(
        ordered=in_order(place, period=1.0),
        clockwise=clockwise(found),
        distance=float(distance.mean()),
        gap_cv=spacing_cv(found, Ring(len(found))),
        slip=float(np.abs(off).max() * len(found)),
    )


Mask = npt.NDArray[np.bool_]


_PLACES_PER_GAP: Final = 50  # places along the truth for each gap between points


class Place(NamedTuple):
    """How far found points are from where they belong.

    Args:
        mm: Mean distance of all points from their true places.
        slip: The farthest that a valid point lies from its own material, in gaps along the curve or the lattice.
        flipped: Another numbering of the same points (from the other end, the other way round, from another corner)
            would be nearer.
    """

    mm: float
    slip: float
    flipped: bool


def place(points: Array, valid: Mask, layout: Topology, simulator: Any) -> Place:
    """Compare found points with what the simulator knows.

    Args:
        points: (N,3) metres, base frame.
        valid: (N,) which of them were measured.
        layout: How they hang together.
        simulator: The environment; ``truth`` gives its points in the same frame.
    """
    if isinstance(layout, Grid):
        true = simulator.truth(layout.rows, layout.cols)
        slips = _off_lattice(layout.lattice(points - true), layout.lattice(true))
    elif isinstance(layout, (Chain, Ring)):
        true = simulator.truth(layout.size)
        slips = _along_curve(points, simulator, isinstance(layout, Ring))
    else:
        raise ValueError(f"expected a chain, a ring or a lattice, got {type(layout).__name__}.")
    distance = np.linalg.norm(points - true, axis=1)
    others = min(float(np.sum((other - true) ** 2)) for other in _renumbered(points, layout))
    slip = float(slips[valid].max(initial=0.0))
    return Place(1e3 * float(distance.mean()), slip, others < float(np.sum(distance**2)))


def _along_curve(points: Array, simulator: Any, closed: bool) -> Array:
    """(N,) how far points lie from their own arc position, along the curve, in gaps."""
    count = len(points)
    if closed:
        at = cdist(points, simulator.truth(_PLACES_PER_GAP * count)).argmin(axis=1) / _PLACES_PER_GAP
        return np.abs((at - np.arange(count) + count / 2) % count - count / 2)
    line = simulator.truth(_PLACES_PER_GAP * (count - 1) + 1)
    # Continued straight beyond its ends, so that points past a tip still have a place.
    beyond = np.arange(1, _PLACES_PER_GAP + 1)[:, None]
    before, behind = line[0] + (line[0] - line[1]) * beyond[::-1], line[-1] + (line[-1] - line[-2]) * beyond
    at = cdist(points, np.concatenate([before, line, behind])).argmin(axis=1) / _PLACES_PER_GAP - 1
    return np.abs(at - np.arange(count))


def _off_lattice(away: Array, true: Array) -> Array:
    """(N,) how far points lie from their places along the sheet, in gaps: the larger of down and across.

    Args:
        away: (rows,cols,3) from the true places to the found ones.
        true: (rows,cols,3) the true places.
    """
    gaps = np.stack([np.gradient(true, axis=0), np.gradient(true, axis=1)], axis=-1)
    off = np.linalg.pinv(gaps) @ away[..., None]
    return np.asarray(np.abs(off).max(axis=(-2, -1)).ravel(), dtype=np.float64)


def _renumbered(points: Array, layout: Topology) -> list[Array]:
    """The same points in each other order that a shape of this layout could have been given."""
    if isinstance(layout, Grid):
        lattice = layout.lattice(points)
        turned = (lattice[::-1], lattice[:, ::-1], lattice[::-1, ::-1])
        return [other.reshape(points.shape) for other in turned]
    backwards = points[::-1]
    return [np.roll(backwards, 1, axis=0) if isinstance(layout, Ring) else backwards]
