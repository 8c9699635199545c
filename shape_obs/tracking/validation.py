"""The gate: whether what was found can be believed, how far, and in words why not."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.form import Curve, Patch
from shape_obs.point_cloud.body import Body

Array = npt.NDArray[np.float64]

_MAX_OFF: Final = 0.10
_MAX_SPREAD: Final = 0.40
_IDEAL_SPREAD: Final = 12**-0.5
MAX_HIDDEN: Final = 0.5  # of a tracked shape
# Of an outline: the staircase of pixels alone lies 0.25 px (0.12 samples) off the best curve, flipped border pixels
# twice that; what misses them by more follows another outline. A few hundred samples tell it.
_IDEAL_MISS: Final = 0.15
_MAX_MISS: Final = 0.75
_MIN_PIECE: Final = 0.6
# Of a sheet: degrees by which a corner may miss a right angle; the share of its cells beside one that lies upside down
# (a single one may, where a real corner is round); the excess length of a side; the variation of its cells' areas.
_MAX_SKEW: Final = 55.0
_MAX_FOLDS: Final = 0.01
_IDEAL_KINK: Final = 25.0  # degrees: wrinkles
_MAX_KINK: Final = 60.0
_MAX_WINDING: Final = 0.20
_MAX_UNEVEN: Final = 0.40


class Verdict(NamedTuple):
    """What the gate says of a fit.

    Args:
        reason: Why it is refused; empty if it is not.
        quality: 0...1.
    """

    reason: str
    quality: float


def judge_ribbon(curve: Curve, body: Body, bridged: float) -> Verdict:
    """Judge the axis of a ribbon or a rope.

    Refused are a curve that leaves the body over 10 % more than ``bridged`` explains, and a body that spreads about
    the curve more than a ribbon does (rms distance over width, 0.289 for an ideal ribbon, at most 0.40).

    Args:
        curve: From end to end; bridged is what lies off the body.
        body: What it was fitted to.
        bridged: The share of the curve that is known to be bridged or hidden.
    """
    empty = curve.empty
    hidden = min(empty, bridged)
    off = empty - hidden
    if off > _MAX_OFF:
        return Verdict(f"{off:.0%} of the curve lies off the {body.noun} (at most {_MAX_OFF:.0%})", 0.0)
    spread = _spread(curve, body) / max(body.breadth(curve.size * (1 - hidden)), 1e-9)
    if spread > _MAX_SPREAD:
        return Verdict(
            f"the {body.noun} spreads {spread:.2f} widths about the curve (a ribbon {_IDEAL_SPREAD:.2f}, "
            f"at most {_MAX_SPREAD:.2f}): it is no single rope",
            0.0,
        )
    excess = (spread - _IDEAL_SPREAD) / (_MAX_SPREAD - _IDEAL_SPREAD)
    return Verdict("", ((1 - max(off, 0.0) / _MAX_OFF) * min(max(1 - excess, 0.0), 1.0)) ** 0.5)


def judge_outline(body: Body, miss: float) -> Verdict:
    """Judge the outline of a body's largest piece.

    Refused are a piece that is less than 60 % of the body, and a curve that the outline's samples miss by 0.75 of
    their distance on average.

    Args:
        body: What it was fitted to.
        miss: Mean distance of the outline's samples from the curve, in units of their distance.
    """
    piece = body.outlined
    if piece < _MIN_PIECE:
        return Verdict(
            f"the {body.noun} falls into {body.pieces} pieces, and the largest is {piece:.0%} of it "
            f"(at least {_MIN_PIECE:.0%})",
            0.0,
        )
    if miss > _MAX_MISS:
        return Verdict(f"the outline misses the {body.noun}'s by {miss:.2f} samples (at most {_MAX_MISS:.2f})", 0.0)
    excess = max(miss - _IDEAL_MISS, 0.0) / (_MAX_MISS - _IDEAL_MISS)
    return Verdict("", ((1 - excess) * piece) ** 0.5)


def judge_sheet(patch: Patch, body: Body, kink: float) -> Verdict:
    """Judge a lattice over a sheet.

    Refused are a lattice that leaves the body over 10 %, a corner more than 55 degrees off a right angle, a lattice
    that folds, a side that turns by 60 degrees somewhere (a fifth corner, or a hand's) or is 20 % longer than the way
    from corner to corner, and cells whose areas vary by 40 %. Of real towels no side turns by more than 36 degrees or
    winds by more than 7 %, and no areas vary by more than 15 %; T-shirts and shorts begin there.

    Args:
        patch: The lattice.
        body: What it was fitted to.
        kink: Degrees by which the outline turns at most, away from the corners.
    """
    empty, (corner, folds, winding, uneven) = patch.empty, body.kernels.assessed(patch.lattice)
    reason = ""
    if empty > _MAX_OFF:
        reason = f"{empty:.0%} of the lattice lies off the {body.noun} (at most {_MAX_OFF:.0%})"
    elif abs(corner - 90) > _MAX_SKEW:
        reason = f"a corner of the lattice has {corner:.0f} degrees (90 and {_MAX_SKEW:.0f} more or less)"
    elif folds > _MAX_FOLDS:
        reason = f"the lattice folds at {folds:.0%} of its cells"
    elif kink > _MAX_KINK:
        reason = (
            f"the outline turns by {kink:.0f} degrees between two corners (at most {_MAX_KINK:.0f}): the {body.noun} "
            "is no sheet, or a part of it is hidden"
        )
    elif winding > _MAX_WINDING:
        reason = (
            f"a side is {winding:.0%} longer than the way from corner to corner (at most {_MAX_WINDING:.0%}): the "
            f"{body.noun} is no sheet with four corners"
        )
    elif uneven > _MAX_UNEVEN:
        reason = f"the areas of the lattice's cells vary by {uneven:.0%} (at most {_MAX_UNEVEN:.0%})"
    if reason:
        return Verdict(reason, 0.0)
    bent = max(kink - _IDEAL_KINK, 0.0) / (_MAX_KINK - _IDEAL_KINK)
    shares = (1 - empty / _MAX_OFF) * (1 - bent) * (1 - winding / _MAX_WINDING) * (1 - uneven / _MAX_UNEVEN)
    return Verdict("", shares**0.5)


def _spread(curve: Curve, body: Body) -> float:
    """Root mean square distance of the body's samples from the curve, in the body's unit."""
    square = curve.spread
    if square is None:
        square = body.kernels.spread(body.samples.points, body.samples.weight, curve.points)
    return (square + body.within) ** 0.5
