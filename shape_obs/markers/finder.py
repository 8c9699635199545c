"""ArUco markers in an image: their ids, and their corners to a fraction of a pixel."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from functools import lru_cache
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.markers.sides import sharpened
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
