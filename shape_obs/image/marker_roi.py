"""The area between four ArUco markers: found once, then checked from time to time."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any, Final, Literal, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.image.roi import ROI, Place, Polygon, Window
from shape_obs.markers import DICTIONARY, Corners, check_ids, find_markers, fourth_marker
from shape_obs.markers.finder import as_gray
from shape_obs.spec import SpecError

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]
Inside = Literal["inner", "centers", "outer"]

_MARGIN: Final = 0.7  # sides of a marker around its last place, in which it is looked for before the whole image is
_LEAST: Final = 2  # markers that give the places of the hidden ones, once all places are known


class Seen(NamedTuple):
    """The markers when they were last found.

    Args:
        size: ``(H, W)`` of the image.
        corners: All four, ``(4, 2)`` pixels each, when the place was last found.
        region: The area between them.
        frames: Since the place was found or confirmed.
    """

    size: tuple[int, int]
    corners: Corners
    region: Polygon
    frames: int = 0


@dataclass(frozen=True)
class Markers(ROI, kind="markers"):
    """The area between four ArUco markers, one in each corner.

    It is found in the first frame, and after that the markers are checked every ``every`` frames: when they are seen
    elsewhere, the camera or the table has moved, and the area is found again. One marker may be hidden from the start,
    and all of them later; where nothing is seen of them the area stays. Until the area has been found, shapes are not
    ok and say which markers are missing.

    Args:
        ids: Of the markers, as one goes around the area, either way.
        dictionary: Which markers they are: ``"4x4_50"``, ``"5x5_100"``, ``"apriltag_36h11"``, ...
        inside: What is looked at: between the markers' ``"inner"`` corners, their ``"centers"`` or their ``"outer"``
            corners.
        every: Frames from one check of the markers to the next.
        tolerance: Pixels by which a marker may seem to move while nothing has.
    """

    ids: tuple[int, int, int, int] = (0, 1, 2, 3)
    dictionary: str = DICTIONARY
    inside: Inside = "inner"
    every: int = 30
    tolerance: float = 3.0

    def __post_init__(self) -> None:
        super().__post_init__()
        try:
            check_ids(self.ids, self.dictionary)
        except ValueError as error:
            raise SpecError(f"markers: {error}") from error
        if self.every < 1 or not 0 < self.tolerance < np.inf:
            raise SpecError(f"markers: expected every >= 1 and tolerance > 0, got {self.every} and {self.tolerance}.")
        import_module("scipy.optimize")  # the fit of a hidden marker needs it, and not in the frame that hides it

    def window(self, size: tuple[int, int]) -> Window:
        """Raise an error: the window is unknown until ``place`` has seen a frame.

        Raises:
            ValueError: Always.
        """
        raise ValueError("where the markers are depends on the frame: ask place(rgb, memory) for the region.")

    def place(self, rgb: Image | None, memory: Any) -> Place:
        """Return the area in this frame, or which markers are missing."""
        if rgb is None:
            raise ValueError(
                "roi 'markers' needs the colour image to find them in, and there is none; with masks or depth alone "
                "give a roi 'polygon'."
            )
        size = (rgb.shape[0], rgb.shape[1])
        known: Seen | None = memory if memory is not None and memory.size == size else None
        if known is not None and known.frames + 1 < self.every:
            return Place(known.region, known._replace(frames=known.frames + 1))
        gray = as_gray(rgb)
        if known is not None and self._stayed(gray, known.corners):
            return Place(known.region, known._replace(frames=0))
        seen = {each: corners for each, corners in find_markers(gray, self.dictionary).items() if each in self.ids}
        corners = self._completed(seen, known)
        if corners is None:
            missing = ", ".join(str(each) for each in self.ids if each not in seen)
            return Place(None, known, f"markers {missing} not seen")
        if known is not None and corners is known.corners:
            return Place(known.region, known._replace(frames=0))
        area = self._area(corners)
        if not cv2.isContourConvex(area.astype(np.float32)):
            ids = ", ".join(map(str, self.ids))
            return Place(None, known, f"markers {ids} do not stand in the corners of an area")
        region = Polygon.from_dict({"points": area})
        return Place(region, Seen(size, corners, region))

    def _stayed(self, gray: Image, known: Corners) -> bool:
        """Return whether markers are seen near where they were, and all of them where they were."""
        stayed = []
        for each, corners in known.items():
            reach = _MARGIN * float(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).max())
            low = np.maximum(np.floor(corners.min(axis=0) - reach), 0).astype(int)
            high = np.ceil(corners.max(axis=0) + reach).astype(int) + 1
            part = gray[low[1] : max(high[1], 0), low[0] : max(high[0], 0)]
            seen = find_markers(part, self.dictionary, sharp=False) if min(part.shape) > 0 else {}
            if each in seen:
                stayed.append(self._same(seen[each] + low, corners))
        return any(stayed) and all(stayed)

    def _same(self, seen: Array, known: Array) -> bool:
        return float(np.linalg.norm(seen - known, axis=1).max()) <= self.tolerance

    def _completed(self, seen: Corners, known: Seen | None) -> Corners | None:
        """Return all four markers from those in sight and their last places; None if that is not enough."""
        if len(seen) == 4:
            return seen
        if known is None:
            return {**seen, **_hidden(seen, self.ids)} if len(seen) == 3 else None
        if all(self._same(corners, known.corners[each]) for each, corners in seen.items()):
            return known.corners
        if len(seen) < _LEAST:
            return None
        before, now = (np.concatenate([of[each] for each in seen]) for of in (known.corners, seen))
        homography = cv2.findHomography(before, now)[0]
        gone = [each for each in self.ids if each not in seen]
        moved = cv2.perspectiveTransform(np.stack([known.corners[each] for each in gone]), homography)
        return {**seen, **dict(zip(gone, np.asarray(moved, np.float64), strict=True))}

    def _area(self, corners: Corners) -> Array:
        """Return ``(4, 2)`` the polygon between the markers."""
        squares = np.stack([corners[each] for each in self.ids])
        centres = squares.mean(axis=1)
        middle = centres.mean(axis=0)
        distances = np.linalg.norm(squares - middle, axis=2)
        if self.inside == "centers":
            points = centres
        else:
            chosen = distances.argmin(axis=1) if self.inside == "inner" else distances.argmax(axis=1)
            points = squares[np.arange(4), chosen]
        around = np.argsort(np.arctan2(*(points - middle).T[::-1]))
        return points[around]


def _hidden(seen: Corners, ids: tuple[int, int, int, int]) -> Corners:
    """Return the one of four markers that is not seen."""
    missing = next(each for each in ids if each not in seen)
    return {missing: fourth_marker(seen, ids)}
