"""Judge curves that were found in a scene of several ropes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from tests.benchmarks.scenes.ropes import Curve, resample
from tests.benchmarks.scenes.several_ropes import RopeScene

_OFF: Final = 0.5  # largest distance of a right curve from its rope's axis in widths
_SHARE: Final = 0.97  # of the length, over which the distance counts
_TIP: Final = 1.0  # largest distance of a right curve's tips from those of its rope in widths


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
    inside = ((fine >= -0.5) & (fine <= np.array([size[1], size[0]]) - 0.5)).all(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], inside, [0]])))
    if len(edges) == 0:
        return curve[:0]
    k = 2 * int(np.argmax(edges[1::2] - edges[::2]))
    return resample(fine[edges[k] : edges[k + 1]], 1.0)


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
