"""Ropes that may have exchanged their ends where they met: would each go on straighter along the other one?"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.curve import FittedCurve
from shape_obs.initialization.gaps import Lead, bending, lead
from shape_obs.tracking.scene_doubt import nearest_distances

Array = npt.NDArray[np.float64]

# In widths: ropes touch where their middles are nearer; over how much of a rope its direction is taken next to there.
_TOUCH: Final = 1.2
_REACH: Final = 2.0
_NOISE: Final = 0.1  # rad^2 that ropes that have not exchanged their ends may seem to gain


def exchange_gain(first: FittedCurve, second: FittedCurve, width: float) -> float:
    """Return by how much two ropes would bend less, in rad^2, if they exchanged their ends in a place where they meet.

    What noise explains is taken off.

    Args:
        first: A rope, in pixels.
        second: Another one.
        width: Of both, pixels.
    """
    coarse = [np.ascontiguousarray(curve.points[::4]) for curve in (first, second)]
    if nearest_distances(*coarse).min() > 2 * _TOUCH * width:
        return 0.0
    apart = np.linalg.norm(first.points[:, None] - second.points[None], axis=2)
    nearest = apart.argmin(axis=1)
    met = np.flatnonzero(np.diff(np.concatenate([[False], apart.min(axis=1) < _TOUCH * width, [False]])))
    gain = 0.0
    for start, stop in met.reshape(-1, 2):
        other = nearest[start:stop]
        leads = [
            _lead(curve, index, step, width)
            for curve, index, step in (
                (first, start, -1), (first, stop - 1, 1), (second, other.min(), -1), (second, other.max(), 1),
            )
        ]  # fmt: skip
        if None not in leads:
            gain = max(gain, _gain([each for each in leads if each is not None]))
    return max(gain - _NOISE, 0.0)


def _lead(curve: FittedCurve, index: int, step: int, width: float) -> Lead | None:
    """Return how a rope leaves one of its points; None where it ends too soon to see."""
    piece = curve.points[index::step] if step > 0 else curve.points[index::-1]
    along = curve.arc[-1] - curve.arc[index] if step > 0 else curve.arc[index]
    return lead(piece, _REACH * width) if along >= _REACH * width else None


def _gain(leads: list[Lead]) -> float:
    before, after, other_before, other_after = leads
    as_it_is = bending(before, after) + bending(other_before, other_after)
    crosswise = bending(before, other_after) + bending(other_before, after)
    turned = bending(before, other_before) + bending(after, other_after)
    return as_it_is - min(crosswise, turned)
