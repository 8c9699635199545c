"""A marker's corners to a fraction of a pixel: lines through its four sides, and where they meet.

A blurred corner is rounder and lies further in than the real one, by a quarter of a pixel for a lens of 0.6 px; blur
moves no straight side. So corners of sides are true where `cv2.cornerSubPix` makes every marker a little too small, and
its distance 1 % too large.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

_ALONG: Final = np.linspace(0.12, 0.88, 24)  # where along a side its edge is looked for: corners are left out
_ACROSS: Final = np.linspace(-1, 1, 17)  # and so across, in reaches
_REACH: Final = 0.7, 1.5, 6.0  # cells to either side, at least and at most so many pixels: the next edge is a cell away
_ROUNDS: Final = 2
_FAINT: Final = 0.3  # of the median rise across a side: edge points that are left out
_STRAY: Final = 2.0  # standard deviations from the line, beyond which an edge point is left out


def sharpened(gray: npt.NDArray[np.uint8], corners: Array, cells: int) -> Array:
    """Better corners of one marker.

    Args:
        gray: (H,W) uint8.
        corners: (4,2) pixels, clockwise as seen, at most a cell off.
        cells: Of the marker's side, its black border included.

    Returns:
        (4,2) pixels; those given where the sides cannot be told from what is around them.
    """
    better = corners
    for _ in range(_ROUNDS):
        sides = np.roll(better, -1, axis=0) - better
        lengths = np.linalg.norm(sides, axis=1)
        share, least, most = _REACH
        reach = float(np.clip(share * lengths.min() / cells, least, most))
        directions = sides / lengths[:, None]
        outward = np.stack([directions[:, 1], -directions[:, 0]], axis=1)
        feet = better[:, None] + _ALONG[:, None] * sides[:, None]
        samples = feet[:, :, None] + reach * _ACROSS[:, None] * outward[:, None, None]
        u, v = samples.reshape(4 * len(_ALONG), len(_ACROSS), 2).astype(np.float32).transpose(2, 0, 1)
        seen = cv2.remap(gray, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float64)
        rises = np.clip(np.diff(seen, axis=1), 0, None).reshape(4, len(_ALONG), -1)  # paper is brighter than ink
        total = rises.sum(axis=2)
        if np.any(total.max(axis=1) <= 0):  # a side without an edge
            return corners
        middles = reach * (_ACROSS[1:] + _ACROSS[:-1]) / 2
        offsets = (rises @ middles) / np.maximum(total, 1e-9)
        ends = _ends(offsets, total)
        met = _meetings(better + ends[:, :1] * outward, np.roll(better, -1, axis=0) + ends[:, 1:] * outward)
        if not np.all(np.isfinite(met)) or np.linalg.norm(met - corners, axis=1).max() > reach + 1:
            return corners
        better = met
    return better


def _ends(offsets: Array, weights: Array) -> Array:
    """(4,2) of the line through each side's (4,A) offsets, its begin and end; without what strays."""
    kept = (weights > _FAINT * np.median(weights, axis=1, keepdims=True)).astype(np.float64)
    begin = slope = np.zeros((4, 1))
    for _ in range(2):
        count = kept.sum(axis=1, keepdims=True)
        at = (kept @ _ALONG)[:, None] / count
        mean = (kept * offsets).sum(axis=1, keepdims=True) / count
        along = kept * (_ALONG - at)
        slope = (along * offsets).sum(axis=1, keepdims=True) / (along * (_ALONG - at)).sum(axis=1, keepdims=True)
        begin = mean - slope * at
        off = offsets - begin - slope * _ALONG
        deviation = np.sqrt((kept * off * off).sum(axis=1, keepdims=True) / count)
        kept = kept * (np.abs(off) <= _STRAY * np.maximum(deviation, 1e-3))
    return np.concatenate([begin, begin + slope], axis=1)


def _meetings(begins: Array, ends: Array) -> Array:
    """(4,2) where each side's line meets that of the side before."""
    (x, y), (u, v) = begins.T, (ends - begins).T
    before, behind = np.roll(begins, 1, axis=0), np.roll(ends - begins, 1, axis=0)
    across = behind[:, 0] * v - behind[:, 1] * u
    with np.errstate(divide="ignore", invalid="ignore"):
        share = ((x - before[:, 0]) * v - (y - before[:, 1]) * u) / across
        return before + share[:, None] * behind
