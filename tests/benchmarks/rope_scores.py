"""Judge whether curves run as drawn ropes do: those of a scene of several ropes, and that of a tangled rope."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.bench.scenes import resample
from shape_obs.compiled import compiled
from tests.benchmarks.scenes.several_ropes import RopeScene
from tests.scenes.layouts import longest_run
from tests.scenes.ropes import Curve
from tests.scenes.tangles import Tangle

# In widths: the largest distance of a right curve from its rope's axis where that is in sight, and where it is hidden;
# the largest distance of its tips from those of its rope.
_OFF, _OFF_HIDDEN, _TIP = 0.5, 2.0, 1.0
_SHARE: Final = 0.97  # of the length, over which the distance counts


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
    ropes = [seen_axis(curve, scene.mask.shape) for curve in scene.curves]
    owner = [-1] * len(found)
    for index, (rope, width) in enumerate(zip(ropes, scene.widths, strict=True)):
        for k, curve in enumerate(found):
            if owner[k] < 0 and follows(curve, rope, width):
                owner[k] = index
                break
    right = tuple(index in owner for index in range(len(ropes)))
    return Verdict(right, tuple(owner), owner.count(-1))


def is_traversed(found: npt.NDArray[Any], tangle: Tangle) -> bool:
    """Return whether a found curve follows a tangled rope, in either direction; tips may be missed by two widths."""
    return follows(found, tangle.curve, tangle.width, tangle.hidden, tip=2.0)


def follows(
    found: npt.NDArray[Any], axis: Curve, width: float, hidden: npt.NDArray[np.bool_] | None = None, tip: float = _TIP
) -> bool:
    """Return whether a curve runs along a rope's axis from tip to tip, in either direction.

    Both are walked along at once, without a step back. Where they are more than half a width apart a step of either
    one counts as off; as few steps as possible, in pixels, must be off, at most 3 % of the axis. So a loop in the wrong
    direction, a wrong branch or a missing strand count with their length.

    Args:
        found: ``(N, 2)`` pixels.
        axis: The visible axis of the rope, ``(P, 2)`` pixels.
        width: The rope's thickness in pixels.
        hidden: ``(P,)`` where something hides the rope: they may be two widths apart there. None for nowhere.
        tip: The largest distance of the tips, widths.
    """
    if len(found) < 2 or not np.isfinite(found).all():
        return False
    truth, curve = (np.ascontiguousarray(resample(line.astype(np.float64), 1.0)) for line in (axis, found))
    reach = np.full(len(truth), _OFF * width)
    if hidden is not None:
        at = np.linspace(0, len(hidden) - 1, len(truth)).round().astype(int)
        reach[hidden[at]] = _OFF_HIDDEN * width
    for way in (curve, np.ascontiguousarray(curve[::-1])):
        tips = np.linalg.norm(way[[0, -1]] - truth[[0, -1]], axis=1)
        if (tips <= tip * width).all() and steps_off(truth, way, reach, round(_TIP * width)) <= (1 - _SHARE) * len(
            truth
        ):
            return True
    return False


def seen_axis(curve: Curve, size: Sequence[int]) -> Curve:
    """Return the longest part of an axis inside an image of ``size`` ``(H, W)``, up to its border."""
    fine = resample(curve, 0.25)
    inside = np.all((fine >= -0.5) & (fine <= np.array([size[1], size[0]]) - 0.5), axis=1)  # (P,)
    part = fine[longest_run(np.asarray(inside))]
    return resample(part, 1.0) if len(part) else part


@compiled("(f8[:,::1], f8[:,::1], f8[::1], i8)")
def steps_off(truth: Curve, found: Curve, reach: npt.NDArray[np.float64], beyond: int) -> int:
    """Return the fewest steps off on a walk along two curves at once, from both starts to both ends.

    Args:
        truth: ``(P, 2)`` pixels, at steps of a pixel.
        found: ``(N, 2)`` pixels, at steps of a pixel.
        reach: ``(P,)`` distance from which a step is off, in pixels.
        beyond: Steps by which the found curve may be longer at its start and its end.
    """
    n, m = len(truth), len(found)
    row = np.zeros(m, np.int64)
    for i in range(n):
        corner = row[0]
        for j in range(m):
            far = (truth[i, 0] - found[j, 0]) ** 2 + (truth[i, 1] - found[j, 1]) ** 2 > reach[i] * reach[i]
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
