"""Find ArUco markers in an image, with corners to a fraction of a pixel.

Corners are refined as intersections of lines through the four sides. Blur of 0.6 px rounds a corner and moves it
inwards by a quarter of a pixel, but does not move a straight side. With ``cv2.cornerSubPix`` every marker would be
slightly too small, and its distance 1 % too large.
"""

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
# One window of the adaptive threshold instead of OpenCV's three takes a third of the time, and is wide enough for
# markers of 15 to 100 px.
_THRESHOLD_WINDOW: Final = 15
# Samples per cell in each direction: with 4, OpenCV's default, one small marker in 600 is not recognised.
_PIXELS_PER_CELL: Final = 8

# Of the search for edges along the sides of a marker:
_ALONG: Final = np.linspace(0.12, 0.88, 24)  # positions along a side; corners are left out
_ACROSS: Final = np.linspace(-1, 1, 17)  # positions across a side, in units of the reach
_REACH: Final = 0.7, 1.5, 6.0  # reach to either side in cells, and its limits in pixels: the next edge is a cell away
_ROUNDS: Final = 2
_FAINT: Final = 0.3  # share of the median rise across a side below which an edge point is ignored
_STRAY: Final = 2.0  # standard deviations from the line beyond which an edge point is ignored


def dictionary_named(name: str) -> Any:
    """Return a marker dictionary of OpenCV.

    ``"4x4_50"`` has 50 markers of 4 x 4 cells, ``"apriltag_36h11"`` is that of AprilTag.

    Raises:
        ValueError: The name is unknown.
    """
    known = {each[5:].lower(): getattr(cv2.aruco, each) for each in dir(cv2.aruco) if each.startswith("DICT_")}
    if name not in known:
        raise ValueError(f"unknown marker dictionary {name!r}{did_you_mean(name, known)}")
    return cv2.aruco.getPredefinedDictionary(known[name])


def check_ids(ids: Iterable[int], dictionary: str) -> None:
    """Reject duplicate ids, and ids that are not in the dictionary.

    Raises:
        ValueError: The message contains the ids.
    """
    ids, count = list(ids), len(dictionary_named(dictionary).bytesList)
    wrong = [each for each in ids if not 0 <= each < count]
    if wrong:
        raise ValueError(f"markers of {dictionary!r} have the ids 0 to {count - 1}, got {wrong[0]}.")
    if len(set(ids)) < len(ids):
        raise ValueError(f"every marker needs its own id, got {ids}.")


def find_markers(image: npt.NDArray[np.uint8], dictionary: str = DICTIONARY, sharp: bool = True) -> Corners:
    """Find the markers in an image.

    Args:
        image: RGB image ``(H, W, 3)`` or gray image ``(H, W)``, uint8.
        dictionary: The marker dictionary, see ``dictionary_named``.
        sharp: Refine corners to a fraction of a pixel, which takes half a millisecond per marker.

    Returns:
        The ``(4, 2)`` corners of each marker in pixels, by id, in the order top left, top right, bottom right and
        bottom left, clockwise as seen from the front. Of two markers with the same id, the larger one.
    """
    gray = as_gray(image)
    found, ids, _ = _detector(dictionary, threading.get_ident()).detectMarkers(gray)
    seen: Corners = {}
    for corners, each in zip(found, [] if ids is None else np.ravel(ids), strict=True):
        place = np.asarray(corners, np.float64).reshape(4, 2)
        if int(each) not in seen or _perimeter(place) > _perimeter(seen[int(each)]):
            seen[int(each)] = place
    if not sharp:
        return seen
    cells = 2 + dictionary_named(dictionary).markerSize
    return {each: refine_corners(gray, place, cells) for each, place in seen.items()}


def as_gray(image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Convert an RGB image ``(H, W, 3)`` or a gray image ``(H, W)`` to a contiguous gray image ``(H, W)``."""
    if image.ndim == 2:
        return np.ascontiguousarray(image)
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY), np.uint8)


@lru_cache(maxsize=32)
def _detector(dictionary: str, thread: int) -> Any:
    """Return OpenCV's detector, one for each thread because it is not documented as thread-safe."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.adaptiveThreshWinSizeMin = parameters.adaptiveThreshWinSizeMax = _THRESHOLD_WINDOW
    parameters.perspectiveRemovePixelPerCell = _PIXELS_PER_CELL
    parameters.minMarkerPerimeterRate = 0.05
    return cv2.aruco.ArucoDetector(dictionary_named(dictionary), parameters)


def _perimeter(corners: Array) -> float:
    return float(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).sum())


def refine_corners(gray: npt.NDArray[np.uint8], corners: Array, cells: int) -> Array:
    """Refine the corners of one marker.

    Args:
        gray: Gray image ``(H, W)``, uint8.
        corners: ``(4, 2)`` pixels, clockwise in the image, with an error of at most a cell.
        cells: Number of cells along a side, including the black border.

    Returns:
        ``(4, 2)`` pixels; the given corners if the sides cannot be distinguished from their surroundings.
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
    """Fit a line to the offsets (4, A) of each side without outliers, and return its offset at both ends, (4, 2)."""
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
    """Return the intersections of each side's line with that of the previous side, ``(4, 2)``."""
    (x, y), (u, v) = begins.T, (ends - begins).T
    before, behind = np.roll(begins, 1, axis=0), np.roll(ends - begins, 1, axis=0)
    across = behind[:, 0] * v - behind[:, 1] * u
    with np.errstate(divide="ignore", invalid="ignore"):
        share = ((x - before[:, 0]) * v - (y - before[:, 1]) * u) / across
        return before + share[:, None] * behind
