"""ArUco markers in an image: their ids, and their corners to a fraction of a pixel."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from functools import lru_cache
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.spec import did_you_mean

Array = npt.NDArray[np.float64]
Corners = dict[int, Array]

DICTIONARY: Final = "4x4_50"
# One window of the adaptive threshold instead of OpenCV's three: a third of the time, and wide enough for markers of
# 15 to 100 px.
_THRESHOLD_WINDOW: Final = 15
# Cells are read at so many places squared: at 4, OpenCV's own, one small marker in 600 is not recognised.
_PIXELS_PER_CELL: Final = 8


def dictionary_named(name: str) -> Any:
    """OpenCV's dictionary of markers: ``"4x4_50"`` has 50 markers of 4 x 4 cells, ``"apriltag_36h11"`` is AprilTag's.

    Raises:
        ValueError: There is none of this name.
    """
    known = {each[5:].lower(): getattr(cv2.aruco, each) for each in dir(cv2.aruco) if each.startswith("DICT_")}
    if name not in known:
        raise ValueError(f"unknown dictionary of markers {name!r}{did_you_mean(name, known)}")
    return cv2.aruco.getPredefinedDictionary(known[name])


def check_ids(ids: Iterable[int], dictionary: str) -> None:
    """Refuse ids that are given twice, or that the dictionary does not have.

    Raises:
        ValueError: The message says which.
    """
    ids, count = list(ids), len(dictionary_named(dictionary).bytesList)
    wrong = [each for each in ids if not 0 <= each < count]
    if wrong:
        raise ValueError(f"markers of {dictionary!r} have the ids 0 to {count - 1}, got {wrong[0]}.")
    if len(set(ids)) < len(ids):
        raise ValueError(f"every marker needs an id of its own, got {ids}.")


def find_markers(image: npt.NDArray[np.uint8], dictionary: str = DICTIONARY, sharp: bool = True) -> Corners:
    """Find the markers in an image.

    Args:
        image: (H,W,3) RGB or (H,W) gray, uint8.
        dictionary: Which markers to look for, see ``dictionary_named``.
        sharp: Find corners to a fraction of a pixel, half a millisecond a marker; otherwise to a pixel.

    Returns:
        By id, (4,2) pixels: the marker's own top left, top right, bottom right and bottom left corner, clockwise as
        seen from the front. Of two markers with one id, the larger.
    """
    gray = as_gray(image)
    found, ids, _ = _detector(dictionary, threading.get_ident()).detectMarkers(gray)
    seen: Corners = {}
    for corners, each in zip(found, [] if ids is None else np.ravel(ids), strict=True):
        place = np.asarray(corners, np.float64).reshape(4, 2)
        if int(each) not in seen or _girth(place) > _girth(seen[int(each)]):
            seen[int(each)] = place
    if not sharp:
        return seen
    cells = 2 + dictionary_named(dictionary).markerSize
    return {each: sharpened(gray, place, cells) for each, place in seen.items()}


def as_gray(image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """(H,W,3) RGB or (H,W) gray -> (H,W) gray, contiguous."""
    if image.ndim == 2:
        return np.ascontiguousarray(image)
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY), np.uint8)


@lru_cache(maxsize=32)
def _detector(dictionary: str, thread: int) -> Any:
    """OpenCV's detector; one a thread, since nobody promises that it may be shared."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.adaptiveThreshWinSizeMin = parameters.adaptiveThreshWinSizeMax = _THRESHOLD_WINDOW
    parameters.perspectiveRemovePixelPerCell = _PIXELS_PER_CELL
    parameters.minMarkerPerimeterRate = 0.05
    return cv2.aruco.ArucoDetector(dictionary_named(dictionary), parameters)


def _girth(corners: Array) -> float:
    return float(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).sum())


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
