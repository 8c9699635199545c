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
_HIDDEN: Final = 0.5  # of a hidden end: from that share on something hides it


def revealed(curve: Curve, depth: npt.NDArray[Any]) -> Curve:
    """The curve without the hidden ends that nothing hides: its visible tips are the rope's.

    Args:
        curve: (P,2) pixels, with hidden ends in its memory.
        depth: (H,W) the frame's depth.
    """
    (head, tail), arc = curve.memory.hidden, curve.arc
    keep = [over is None or np.mean(over | np.isnan(metres)) >= _COVERED for metres, over in _ends(curve, depth)]
    if all(keep):
        return curve
    inside = _inside(curve)
    first = 0 if keep[0] else int(np.argmax(inside))
    last = len(arc) if keep[1] else len(arc) - int(np.argmax(inside[::-1]))
    hidden = (head if keep[0] else 0.0, tail if keep[1] else 0.0)
    memory = curve.memory._replace(hidden=hidden, size=0.0)
    return replace(curve.cut(slice(first, last)), memory=memory)


def is_hidden(curve: Curve, depth: npt.NDArray[Any]) -> bool:
    """Whether something is seen to lie over most of a curve's hidden end.

    Args:
        curve: (P,2) pixels, with hidden ends in its memory.
        depth: (H,W) the frame's depth.
    """
    return any(over is not None and np.mean(over) >= _HIDDEN for _, over in _ends(curve, depth))


def _ends(curve: Curve, depth: npt.NDArray[Any]) -> list[tuple[Array, npt.NDArray[np.bool_] | None]]:
    """For head and tail the metres under what is hidden of it, and whether that lies over the rope.

    None where nothing is hidden there, or the visible rope beside it has no depth to compare with.
    """
    (head, tail), size, arc = curve.memory.hidden, curve.size, curve.arc
    metres, inside, ends = _under(curve.points, depth), _inside(curve), []
    for hidden, away in ((head, arc), (tail, size - arc)):
        under = metres[away < hidden - 1e-9]
        beside = metres[inside & (away < hidden + _NEARBY * size)]
        told = hidden > curve.memory.slack and len(under) > 0 and bool(np.isfinite(beside).any())
        ends.append((under, under < np.nanmedian(beside) - _CLEARANCE if told else None))
    return ends


def _inside(curve: Curve) -> npt.NDArray[np.bool_]:
    """(P,) between the hidden ends."""
    (head, tail), arc = curve.memory.hidden, curve.arc
    return (arc >= head - 1e-9) & (arc <= curve.size - tail + 1e-9)


def _under(points: Array, depth: npt.NDArray[Any]) -> Array:
    """(P,) metres at (P,2) pixels; NaN where there is none, beyond the image too."""
    u, v = np.rint(points).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < depth.shape[1]) & (v < depth.shape[0])
    metres = np.full(len(points), np.nan)
    metres[inside] = depth_in_metres(depth[v[inside], u[inside]])
    return metres
