"""What lies over a hidden end: with depth it can be seen whether anything does.

A rope that is seen at a steeper angle is shorter in the image, and in pixels alone that looks like a hidden end. Where
the camera sees past the place in which an end should be hidden, nothing hides it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.form import Curve
from shape_obs.frame import depth_in_metres

Array = npt.NDArray[np.float64]

_NEARBY: Final = 0.2  # of the length next to a hidden end, whose depth it is compared with
_CLEARANCE: Final = 0.005  # metres: what is nearer than the rope by this much lies over it
_COVERED: Final = 0.3  # of a hidden end: below that share nothing hides it; what has no depth may


def revealed(curve: Curve, depth: npt.NDArray[Any]) -> Curve:
    """The curve without the hidden ends that nothing hides: its visible tips are the rope's.

    Args:
        curve: (P,2) pixels, with hidden ends in its memory.
        depth: (H,W) the frame's depth.
    """
    (head, tail), size, arc = curve.memory.hidden, curve.size, curve.arc
    inside = (arc >= head - 1e-9) & (arc <= size - tail + 1e-9)
    metres = _under(curve.points, depth)
    keep = [True, True]
    for end, (hidden, away) in enumerate(((head, arc), (tail, size - arc))):
        if hidden <= curve.memory.slack:
            continue
        over = metres[away < hidden - 1e-9]
        beside = metres[inside & (away < hidden + _NEARBY * size)]
        if not len(over) or not np.isfinite(beside).any():
            continue
        nearest = np.nanmedian(beside) - _CLEARANCE
        keep[end] = bool(np.mean(np.isnan(over) | (over < nearest)) >= _COVERED)
    if all(keep):
        return curve
    first = 0 if keep[0] else int(np.argmax(inside))
    last = len(arc) if keep[1] else len(arc) - int(np.argmax(inside[::-1]))
    hidden = (head if keep[0] else 0.0, tail if keep[1] else 0.0)
    memory = curve.memory._replace(hidden=hidden, size=0.0)
    return replace(curve.cut(slice(first, last)), memory=memory)


def _under(points: Array, depth: npt.NDArray[Any]) -> Array:
    """(P,) metres at (P,2) pixels; NaN where there is none, beyond the image too."""
    u, v = np.rint(points).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < depth.shape[1]) & (v < depth.shape[0])
    metres = np.full(len(points), np.nan)
    metres[inside] = depth_in_metres(depth[v[inside], u[inside]])
    return metres
