"""Validation: decide whether a fitted form can be trusted and how far, and give the reason if not."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.clustering.som import best_matching_units
from shape_obs.compiled import compiled
from shape_obs.geometry.observed import Observed
from shape_obs.geometry.topology import Grid
from shape_obs.tracking.model import LatticeConstants, LatticeModel, Model, RingModel  # noqa: F401 - in a signature

Array = npt.NDArray[np.float64]

_JUDGED: Final = 150  # samples are enough to measure how far a mask spreads about a curve
_JUDGED_AROUND: Final = 256  # samples are enough to measure by how much an outline is missed
#: What is wrong with a sheet: a number, then one of a side or a corner, what was measured, and its limit.
Fault = tuple[int, int, float, float]
NO_FAULT, SHORTER, LONGER, ELSEWHERE = range(4)  # what differs from the sheet that is known
NO_CORNERS, TOO_FEW_CORNERS, OUT_OF_SIGHT, TOO_LITTLE, NOTHING_OVER = range(4, 9)  # what is seen of it
CORNER_MOVED: Final = 9  # the first of those of ``judge_sheet``
_SHEET_FAULTS: Final = (
    "",
    "side {number} is shorter than it was: something hides a part of the sheet",
    "side {number} is longer than it was: something hides a part of the sheet",
    "a side is not where it was: something hides a part of the sheet",
    "the outline's corners are not where the lattice's are",
    "the outline has {number} corners, a sheet has four",
    "the sheet runs out of the camera's sight",
    "too little of the sheet's border is seen to know where the rest is",
    "the sheet is smaller than it was, and nothing lies over the rest",
    "corner {number} strays by {value:.0%} of half a diagonal from where the other three have moved",
    "{value:.0%} of the lattice lies off the {noun} (at most {most:.0%})",
    "a corner of the lattice is {value:.0f} degrees off a right angle (at most {most:.0f})",
    "the lattice folds at {value:.0%} of its cells",
    "the outline turns by {value:.0f} degrees between two corners (at most {most:.0f}): the {noun} is no sheet, or a "
    "part of it is hidden",
    "a side is {value:.0%} longer than the way from corner to corner (at most {most:.0%}): the {noun} is no sheet with "
    "four corners",
    "the areas of the lattice's cells vary by {value:.0%} (at most {most:.0%})",
)
FOLDED: Final = "the gaps between the points differ in space: the sheet is folded or crumpled"


class FitQuality(NamedTuple):
    """The result of validating a fit.

    Args:
        reason: Why it is refused; empty if it is not.
        quality: 0...1.
    """

    reason: str
    quality: float


def validate_gaps(points: Array, valid: npt.NDArray[np.bool_], layout: Grid, error: float, model: LatticeModel) -> str:
    """Return why a lattice with equal gaps in space cannot lie on a sheet, which does not stretch; empty if it can.

    Args:
        points: ``(N, 3)`` metres.
        valid: ``(N,)`` bool.
        layout: The lattice.
        error: Of a point on a sheet that lies flat, RMS per axis, metres.
        model: The constants.
    """
    first, last = layout.edges().T
    gaps = np.sqrt(np.sum((points[first] - points[last]) ** 2, axis=1))
    known, along = valid[first] & valid[last], np.arange(len(gaps)) < layout.rows * (layout.cols - 1)
    means = [gaps[known & way].mean() if (known & way).any() else np.inf for way in (along, ~along)]
    if not known.any():
        return ""
    unequal = np.abs(gaps / np.where(along, *means) - 1)[known].mean()
    return FOLDED if unequal > max(model.max_unequal, model.gap_noise * error / min(means)) else ""


def validate_outline(observed: Observed, miss: float, model: RingModel) -> FitQuality:
    """Validate the outline of an object's largest piece.

    Refused are a piece that is less than 60 % of the object, and a curve that the outline's samples miss by 0.75 of
    their distance on average.

    Args:
        observed: What it was fitted to.
        miss: Mean distance of the outline's samples from the curve, in units of their distance.
        model: The constants.
    """
    piece, (ideal, most) = observed.outlined_share, model.miss
    if piece < model.min_piece:
        return FitQuality(
            f"the {observed.noun} falls into {observed.pieces} pieces, and the largest is {piece:.0%} of it "
            f"(at least {model.min_piece:.0%})",
            0.0,
        )
    if miss > most:
        return FitQuality(f"the outline misses the {observed.noun}'s by {miss:.2f} samples (at most {most:.2f})", 0.0)
    excess = max(miss - ideal, 0.0) / (most - ideal)
    return FitQuality("", ((1 - excess) * piece) ** 0.5)


@compiled("(f8, UniTuple(f8, 4), f8, i8, f8, f8, LatticeConstants[::1])")
def judge_sheet(
    off: float, measures: tuple[float, float, float, float], kink: float, number: int, moved: float, freedom: float,
    model: Model,
) -> tuple[Fault, float]:  # fmt: skip
    """Return what is wrong with a lattice over a sheet, and its quality, 0...1.

    Refused are a corner that moves alone, a lattice that leaves the object, a corner far off a right angle, a lattice
    that folds, a side that turns sharply (at a fifth corner, or a hand's) or is much longer than its chord, and cells
    whose areas vary.

    Args:
        off: The share of the lattice that lies off the object.
        measures: See ``assess_lattice``.
        kink: Degrees by which the outline turns at most, away from the corners.
        number: The corner that lies farthest from where the other three have moved.
        moved: How far, in half diagonals.
        freedom: How far it may lie.
        model: ``(1,)`` the constants.
    """
    most, (corner, folds, winding, uneven) = model[0], measures
    wrinkled, sharpest = most.kink[0], most.kink[1]
    values = moved, off, abs(corner - 90), folds, kink, winding, uneven
    limits = freedom, most.max_off, most.max_skew, 0.0, sharpest, most.max_winding, most.max_uneven
    for k in range(len(values)):
        if values[k] > limits[k]:
            return (CORNER_MOVED + k, number, values[k], limits[k]), 0.0
    bent = max(kink - wrinkled, 0.0) / (sharpest - wrinkled)
    shares = (1 - off / most.max_off) * (1 - bent) * (1 - winding / most.max_winding) * (1 - uneven / most.max_uneven)
    return (NO_FAULT, 0, 0.0, 0.0), math.sqrt(shares)


def sheet_fault(fault: Fault, noun: str) -> str:
    """Return what is wrong with a sheet in words; ``noun`` is what it was fitted to, ``"mask"`` or ``"cloud"``."""
    code, number, value, most = fault
    return _SHEET_FAULTS[code].format(number=number, value=value, most=most, noun=noun)


@compiled("(f8[:,::1], f8[::1], f8[:,::1])")
def sample_spread(points: Array, weight: Array, curve: Array) -> float:
    """Return the mean square distance of ``(M, D)`` weighted points from the tangents of a curve ``(P, D)``.

    About 150 of the points are measured.
    """
    step, last = -(-len(points) // _JUDGED), len(curve) - 1
    some = np.empty((-(-len(points) // step), points.shape[1]))
    for m in range(len(some)):
        for d in range(points.shape[1]):
            some[m, d] = points[m * step, d]
    nearest = best_matching_units(some, curve)
    total = whole = 0.0
    for m in range(len(some)):
        p = nearest[m]
        before, after = max(p - 1, 0), min(p + 1, last)
        along = reach = square = 0.0
        for d in range(points.shape[1]):
            tangent, offset = (curve[after, d] - curve[before, d]) / (after - before), some[m, d] - curve[p, d]
            reach += tangent * tangent
            along += offset * tangent
            square += offset * offset
        reach = math.sqrt(reach)
        along /= max(reach, 1e-9)
        beyond = min(max(along, -reach), reach)
        total += weight[m * step] * max(square - 2 * along * beyond + beyond * beyond, 0.0)
        whole += weight[m * step]
    return total / whole


@compiled
def ring_miss(samples: Array, curve: Array) -> float:
    """Return the mean distance of ``(M, D)`` samples from the tangents of a closed curve ``(P, D)``.

    About 256 of the samples are measured.
    """
    size, dimension, skip, step = len(curve), curve.shape[1], -(-len(samples) // _JUDGED_AROUND), 0.0
    for p in range(size):
        square = 0.0
        for d in range(dimension):
            square += (curve[p, d] - curve[p - 1, d]) ** 2
        step += math.sqrt(square) / size
    some, total = np.ascontiguousarray(samples[::skip]), 0.0
    nearest = best_matching_units(some, curve)
    for m in range(len(some)):
        p = nearest[m]
        after, square, reach, along = (p + 1) % size, 0.0, 0.0, 0.0
        for d in range(dimension):
            tangent, offset = curve[after, d] - curve[p - 1, d], some[m, d] - curve[p, d]
            square += offset * offset
            reach += tangent * tangent
            along += tangent * offset
        along = abs(along) / max(math.sqrt(reach), 1e-9)
        total += math.sqrt(max(square - along * along, 0.0) + max(along - step, 0.0) ** 2)
    return total / len(some)
