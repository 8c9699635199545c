"""What lies over a hidden end: with depth it can be seen whether anything does.

A rope that is seen at a steeper angle is shorter in the image, and in pixels alone that looks like a hidden end. Where
the camera sees past the place in which an end should be hidden, nothing hides it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.frame import depth_in_metres
from shape_obs.geometry.curve import FittedCurve

Array = npt.NDArray[np.float64]

_NEARBY: Final = 0.2  # of the length next to a hidden end, whose depth it is compared with
_CLEARANCE: Final = 0.005  # metres: what is nearer than the rope by this much lies over it
_COVERED: Final = 0.3  # of a hidden end: below that share nothing hides it; what has no depth may
LONG: Final = 0.06  # of the length: no rope becomes shorter by this much from one frame to the next
_AROUND: Final = 1.5  # widths around the place where a rope goes out of sight, in which what hides it must be
_TOUCHING: Final = 0.1  # of that neighbourhood


def uncover_ends(curve: FittedCurve, depth: npt.NDArray[Any], width: float) -> FittedCurve:
    """Return the curve without the hidden ends that nothing hides: its visible tips are the rope's.

    A long piece is not gone because its place, which is only predicted, can be seen past: it is hidden as long as
    something lies over the rope where it goes out of sight.

    Args:
        curve: ``(P, 2)`` pixels, with hidden ends in its hints.
        depth: ``(H, W)`` the frame's depth.
        width: Of the rope, pixels.
    """
    keep = [end is None or end.hidden or (end.long and _adjoined(end, depth, width)) for end in _ends(curve, depth)]
    if all(keep):
        return curve
    (head, tail), arc, inside = curve.hints.hidden, curve.arc, _inside(curve)
    first = 0 if keep[0] else int(np.argmax(inside))
    last = len(arc) if keep[1] else len(arc) - int(np.argmax(inside[::-1]))
    hidden = (head if keep[0] else 0.0, tail if keep[1] else 0.0)
    hints = curve.hints._replace(hidden=hidden, size=0.0)
    return replace(curve.cut(slice(first, last)), hints=hints)


def is_hidden(curve: FittedCurve, depth: npt.NDArray[Any], width: float) -> bool:
    """Return whether a long end of a curve goes out of sight where something lies over the rope.

    Args:
        curve: ``(P, 2)`` pixels, with hidden ends in its hints.
        depth: ``(H, W)`` the frame's depth.
        width: Of the rope, pixels.
    """
    return any(end is not None and end.long and _adjoined(end, depth, width) for end in _ends(curve, depth))


class _End(NamedTuple):
    """An end that is taken for hidden.

    Args:
        tip: ``(2,)`` pixels where the rope goes out of sight.
        over: Metres; what is nearer lies over the rope.
        hidden: Whether something lies over enough of where it should be; what has no depth may.
        long: Whether it is too long to be a rope seen at a steeper angle.
    """

    tip: Array
    over: float
    hidden: bool
    long: bool


def _ends(curve: FittedCurve, depth: npt.NDArray[Any]) -> list[_End | None]:
    """Return head and tail; None if nothing is hidden, or the rope next to it has no depth to compare with."""
    (head, tail), size, arc = curve.hints.hidden, curve.size, curve.arc
    metres, inside = _under(curve.points, depth), _inside(curve)
    ends: list[_End | None] = []
    for hidden, away in ((head, arc), (tail, size - arc)):
        under = metres[away < hidden - 1e-9]
        nearby = metres[inside & (away < hidden + _NEARBY * size)]
        if hidden <= curve.hints.slack or not len(under) or not np.isfinite(nearby).any():
            ends.append(None)
            continue
        over = float(np.nanmedian(nearby)) - _CLEARANCE
        tip = curve.points[np.argmin(np.where(inside, away, np.inf))]
        covered = bool(np.mean(np.isnan(under) | (under < over)) >= _COVERED)
        ends.append(_End(tip, over, covered, hidden > LONG * size))
    return ends


def _adjoined(end: _End, depth: npt.NDArray[Any], width: float) -> bool:
    """Return whether something that lies over the rope comes near the place where it goes out of sight."""
    reach = max(_AROUND * width, 2.0)
    around = np.arange(-np.ceil(reach), np.ceil(reach) + 1)
    away = np.stack(np.meshgrid(around, around), axis=-1).reshape(-1, 2)
    metres = _under(end.tip + away[np.hypot(*away.T) <= reach], depth)
    return bool(np.mean(metres < end.over) >= _TOUCHING)


def _inside(curve: FittedCurve) -> npt.NDArray[np.bool_]:
    """Return ``(P,)`` between the hidden ends."""
    (head, tail), arc = curve.hints.hidden, curve.arc
    return (arc >= head - 1e-9) & (arc <= curve.size - tail + 1e-9)


def _under(points: Array, depth: npt.NDArray[Any]) -> Array:
    """Return ``(P,)`` metres at ``(P, 2)`` pixels; NaN where there is none, beyond the image too."""
    u, v = np.rint(points).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < depth.shape[1]) & (v < depth.shape[0])
    metres = np.full(len(points), np.nan)
    metres[inside] = depth_in_metres(depth[v[inside], u[inside]])
    return metres
