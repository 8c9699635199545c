"""Judge whether curves run as drawn ropes do: those of a scene of several ropes, and that of a tangled rope."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.ndimage import minimum_filter1d

from shape_obs.bench.scenes import resample
from shape_obs.compiled import compiled
from tests.benchmarks.scenes.layouts import longest_run
from tests.benchmarks.scenes.ropes import Curve
from tests.benchmarks.scenes.several_ropes import RopeScene
from tests.benchmarks.scenes.tangles import Tangle

_OFF: Final = 0.5  # largest distance of a right curve from its rope's axis in widths
_SHARE: Final = 0.97  # of the length, over which the distance counts
_TIP: Final = 1.0  # largest distance of a right curve's tips from those of its rope in widths
# Of a tangled rope, in widths: the largest distance where it is hidden, and the length by which a tip may be missed.
_OFF_HIDDEN: Final = 2.0
_MISSED_TIP: Final = 2.0
_PACE: Final = (0.1, 3.0)  # steps along the truth over steps along the found curve


@dataclass(frozen=True)
class Verdict:
    """What is right in a scene.

    Args:
        right: Whether each rope of the scene was found.
        owner: For each found curve the index of its rope, or -1 if it runs as none does.
        wrong: Number of found curves that run as no rope does, or as one that was found already.
    """

    right: tuple[bool, ...]
    owner: tuple[int, ...]
    wrong: int


def judge(found: Sequence[npt.NDArray[Any]], scene: RopeScene) -> Verdict:
    """Compare found curves with the ropes of a scene; each rope counts once.

    Args:
        found: A curve from tip to tip for each rope that was given as found, in either direction, ``(N, 2)`` pixels.
        scene: The truth.
    """
    curves = [np.asarray(curve, dtype=np.float64) for curve in found]
    ropes = [seen_axis(curve, scene.mask.shape) for curve in scene.curves]
    owner = [-1] * len(curves)
    for index, (rope, width) in enumerate(zip(ropes, scene.widths, strict=True)):
        for k, curve in enumerate(curves):
            if owner[k] < 0 and follows(curve, rope, width):
                owner[k] = index
                break
    right = tuple(index in owner for index in range(len(ropes)))
    return Verdict(right, tuple(owner), owner.count(-1))


def follows(found: Curve, axis: Curve, width: float) -> bool:
    """Return whether a curve runs along a rope's axis from tip to tip, in either direction.

    Both are walked along at once, without a step back. Where they are more than half a width apart a step of either
    one counts as off; as few steps as possible, in pixels, must be off, at most 3 % of the axis. So a loop in the wrong
    direction, a wrong branch or a missing strand count with their length.

    Args:
        found: ``(N, 2)`` pixels.
        axis: The visible axis of the rope, ``(P, 2)`` pixels.
        width: The rope's thickness in pixels.
    """
    if len(found) < 2 or not np.isfinite(found).all():
        return False
    truth, curve = (np.ascontiguousarray(resample(line, 1.0)) for line in (axis, found))
    for way in (curve, np.ascontiguousarray(curve[::-1])):
        tips = np.linalg.norm(way[[0, -1]] - truth[[0, -1]], axis=1)
        if (tips <= _TIP * width).all():
            off = steps_off(truth, way, _OFF * width, round(_TIP * width))
            if off <= (1 - _SHARE) * len(truth):
                return True
    return False


def seen_axis(curve: Curve, size: Sequence[int]) -> Curve:
    """Return the longest part of an axis inside an image of ``size`` ``(H, W)``, up to its border."""
    fine = resample(curve, 0.25)
    inside = np.all((fine >= -0.5) & (fine <= np.array([size[1], size[0]]) - 0.5), axis=1)  # (P,)
    part = fine[longest_run(np.asarray(inside))]
    return resample(part, 1.0) if len(part) else part


@compiled("(f8[:,::1], f8[:,::1], f8, i8)")
def steps_off(truth: Curve, found: Curve, reach: float, beyond: int) -> int:
    """Return the fewest steps off on a walk along two curves at once, from both starts to both ends.

    Args:
        truth: ``(P, 2)`` pixels, at steps of a pixel.
        found: ``(N, 2)`` pixels, at steps of a pixel.
        reach: Distance from which a step is off, in pixels.
        beyond: Steps by which the found curve may be longer at its start and its end.
    """
    n, m = len(truth), len(found)
    row = np.zeros(m, np.int64)
    for i in range(n):
        corner = row[0]
        for j in range(m):
            far = (truth[i, 0] - found[j, 0]) ** 2 + (truth[i, 1] - found[j, 1]) ** 2 > reach * reach
            above = row[j]
            if i == 0:
                best = row[j - 1] if j > beyond else 0
            elif j == 0:
                best = above
            else:
                best = min(corner, above, row[j - 1])
            corner = above
            row[j] = best + far
    best = row[m - 1]
    for j in range(max(m - 1 - beyond, 0), m):
        best = min(best, row[j])
    return best


def is_traversed(found: npt.ArrayLike, tangle: Tangle) -> bool:
    """Return whether a found curve follows a tangled rope from tip to tip, in either direction.

    The discrete Frechet distance (Eiter and Mannila, 1994), with a bound on the pace, must not exceed half a width, or
    two widths where the rope is hidden. A loop in the wrong direction, a missing strand or swapped strands exceed it.

    Args:
        found: ``(N, 2)`` pixels, evenly spaced.
        tangle: The truth.
    """
    points = np.asarray(found, dtype=np.float64)
    if not np.all(np.isfinite(points)):
        return False
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    points = points[(arc >= _TIP * tangle.width) & (arc <= arc[-1] - _TIP * tangle.width)]
    return bool(min(_leash(points, tangle), _leash(points[::-1], tangle)) <= _OFF * tangle.width)


def _leash(points: Curve, tangle: Tangle) -> float:
    """Return the Frechet distance from the truth; distances count a quarter where the rope is hidden."""
    step = float(np.linalg.norm(np.diff(tangle.curve, axis=0), axis=1).mean())
    distance = np.linalg.norm(points[:, None] - tangle.curve[None], axis=2)
    distance[:, tangle.hidden] *= _OFF / _OFF_HIDDEN
    pace = len(tangle.curve) / max(len(points) - 1, 1)
    slow, fast = max(int(_PACE[0] * pace), 1), max(int(np.ceil(_PACE[1] * pace)), 3)
    # A gap is added for curves of few points.
    free = int((_MISSED_TIP + _TIP) * tangle.width / step + pace)
    leash = np.full(len(tangle.curve), np.inf)
    leash[:free] = distance[0, :free]
    window = fast - slow + 1
    for row in distance[1:]:
        # The smallest value ``slow`` to ``fast`` steps behind.
        padded = np.concatenate([np.full(fast, np.inf), leash])
        behind = minimum_filter1d(padded, window, mode="constant", cval=np.inf, origin=(window - 1) // 2 - window + 1)
        leash = np.maximum(behind[: len(leash)], row)
    return float(leash[-free:].min())
