"""The fourth of four markers in a rectangle's corners, from the three that are seen."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from shape_obs.markers.finder import Corners

Array = npt.NDArray[np.float64]

_SQUARE = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])


def fourth_marker(corners: Corners, ids: tuple[int, int, int, int]) -> Array:
    """Where the hidden one of four equal markers must be.

    What the camera sees of the table is a homography; it and the rectangle's proportions are fitted to the twelve
    corners that are seen. Each marker may be turned as it likes.

    Args:
        corners: Of three of them, (4,2) pixels each.
        ids: All four, as one goes around the rectangle.

    Returns:
        (4,2) pixels.
    """
    missing = next(i for i, each in enumerate(ids) if each not in corners)
    after, opposite, before = (corners[ids[(missing + step) % 4]] for step in (1, 2, 3))
    middle = opposite.mean(axis=0)
    first, second = after.mean(axis=0) - middle, before.mean(axis=0) - middle
    if first[0] * second[1] - first[1] * second[0] < 0:  # told the other way around: x before y is as in the image
        after, before, first, second = before, after, second, first
    unit = float(np.sqrt(abs(_area(opposite))))
    seen = (np.stack([opposite, after, before]) - middle) / unit
    # The opposite marker's side is the unit of length, its middle the origin; x leads to one neighbour, y to the other.
    reach = np.linalg.norm([first, second], axis=1) / unit
    axes = np.stack([first, second], axis=1) / unit / reach
    turns = [_turn(square, axes) for square in seen]
    start = np.concatenate([axes.ravel(), (0, 0), (0, 0), reach, turns])

    def off(unknown: Array) -> Array:
        _, places = _unpacked(unknown)
        return (places[:3] - seen).ravel()

    found = least_squares(off, start, method="lm")
    return _unpacked(found.x)[1][3] * unit + middle


def _unpacked(unknown: Array) -> tuple[Array, Array]:
    """The homography (3,3), and all four squares (4,4,2) seen through it, the hidden one last."""
    homography = np.array([[*unknown[:2], unknown[4]], [*unknown[2:4], unknown[5]], [*unknown[6:8], 1.0]])
    width, height = unknown[8:10]
    turns = np.array([*unknown[10:13], unknown[10]])
    turned = np.array([[np.cos(turns), -np.sin(turns)], [np.sin(turns), np.cos(turns)]]).transpose(2, 0, 1)
    middles = np.array([(0, 0), (width, 0), (0, height), (width, height)])
    table = np.concatenate([_SQUARE @ turned.transpose(0, 2, 1) + middles[:, None], np.ones((4, 4, 1))], axis=2)
    seen = table @ homography.T
    return homography, seen[..., :2] / seen[..., 2:]


def _turn(square: Array, axes: Array) -> float:
    """By how much a square is turned against the axes, radians."""
    x, y = np.linalg.solve(axes, square[1] - square[0] + square[2] - square[3])
    return float(np.arctan2(y, x))


def _area(square: Array) -> float:
    x, y = square.T
    return float(0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1)))
