"""Found points against a known curve."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from shape_obs.configurations import Ends
from shape_obs.geometry.polyline import arc_length, interpolate, resample
from shape_obs.geometry.topology import Chain
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
