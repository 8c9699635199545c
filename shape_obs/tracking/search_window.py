"""What one frame shows: the region of each pixel rule, looked for where it is expected."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import Kernels
from shape_obs.configurations import Configuration
from shape_obs.frame import Frame
from shape_obs.image.region import Region, find_region, segment
from shape_obs.image.roi import ROI, Place, Window
from shape_obs.image.segmentation import Segmentation
from shape_obs.point_cloud.body import Body
from shape_obs.point_cloud.deprojection import SeenCloud, deproject
from shape_obs.tracking.prediction import Expected, Track, outlook
from shape_obs.utils.timing import Timed


class View:
    """One frame, and what was found in it so far.

    Args:
        frame: The images.
        mask: (H,W) uint8 where someone else has segmented; None where the rules do.
        roi: Where to look at all.
        kernels: What runs the inner loops.
        timings: Milliseconds by stage, added to.
    """

    def __init__(
        self, frame: Frame, mask: npt.NDArray[np.uint8] | None, roi: ROI, kernels: Kernels, timings: dict[str, float]
    ) -> None:
        self._frame, self._mask, self._roi, self._kernels, self._timings = frame, mask, roi, kernels, timings
        size: Any = frame.size if mask is None else mask.shape
        self.window = roi.window(size)
        self._regions: dict[Segmentation | None, Region] = {}
        self._narrow: set[Segmentation | None] = (
            set()
        )  # of these only a part of the image was looked at, or of its pixels
        self._clouds: dict[Segmentation | None, SeenCloud] = {}

    def body(self, spec: Configuration, expected: Expected | None) -> Body:
        """What a shape is fitted to.

        Args:
            spec: What is looked for; with depth and a camera in the frame where it asks for a cloud.
            expected: Where all of it should be; None looks everywhere.
        """
        rule = spec.segmentation
        if rule not in self._regions:
            self._look(rule, expected)
        if spec.lift != "cloud":
            return self._regions[rule]
        frame = self._frame
        if rule not in self._clouds and frame.depth is not None and frame.camera is not None:
            with Timed(self._timings, "cloud"):
                self._clouds[rule] = deproject(self._regions[rule], frame.depth, frame.camera.intrinsics)
        return self._clouds[rule]

    def look_everywhere(self, spec: Configuration) -> bool:
        """Look for a shape in all of the image; False if that has been done."""
        if spec.segmentation not in self._narrow:
            return False
        self._clouds.pop(spec.segmentation, None)
        self._look(spec.segmentation, None)
        return True

    def _look(self, rule: Segmentation | None, expected: Expected | None) -> None:
        """Find the region in the window; what runs out of it is looked for everywhere."""
        self._narrow.discard(rule)
        reach = 1 if rule is None else 1 + rule.open + rule.close
        window, width = self.window, 0.0
        if expected is not None:
            window, width = _within(expected.window, reach, self.window), expected.width
            self._narrow.add(rule)
        with Timed(self._timings, "segmentation" if self._mask is None else "region"):
            if self._mask is None:
                assert rule is not None
                region = segment(self._frame, window, rule, self._roi, self._kernels, width)
            else:
                floor, mask = rule or Segmentation, self._roi.blank(self._mask[window.slices], window)
                region = find_region(mask, window, floor.min_area, floor.min_share, self._kernels)
        self._regions[rule] = region
        if expected is not None and (not region.pieces or _is_cut(region.box, reach, window, self.window)):
            self._look(rule, None)


def placed(roi: ROI, frame: Frame, memory: Any, timings: dict[str, float]) -> Place:
    """Where a region of interest is in a frame. One that stands still takes no time."""
    if type(roi).place is ROI.place:
        return Place(roi)
    with Timed(timings, "roi"):
        return roi.place(frame.rgb, memory)


def outlooks(
    shapes: Iterable[Configuration], tracks: Mapping[str, Track]
) -> dict[Segmentation | None, Expected | None]:
    """Where the shapes of each segmentation will all be; None where one has no track."""
    expected: dict[Segmentation | None, Expected | None] = {}
    for spec in shapes:
        track, rule = tracks.get(spec.name), spec.segmentation
        here = None if track is None else outlook(track)
        if rule in expected:
            other = expected[rule]
            here = None if here is None or other is None else here.united(other)
        expected[rule] = here
    return expected


def _within(near: Window, reach: int, whole: Window) -> Window:
    """The expected window with a margin, its columns in groups of eight, which kernels read at once."""
    left, top = max((near.left - reach) // 8 * 8, whole.left), max(near.top - reach, whole.top)
    right = min(-(-(near.left + near.width + reach) // 8) * 8, whole.left + whole.width)
    bottom = min(near.top + near.height + reach, whole.top + whole.height)
    return Window(left, top, right - left, bottom - top) if right > left and bottom > top else whole


def _is_cut(box: Window, reach: int, window: Window, whole: Window) -> bool:
    """Whether a box comes nearer than ``reach`` to an edge of the window beyond which there is more to see."""
    right, bottom = window.left + window.width, window.top + window.height
    return (
        (box.left < window.left + reach and window.left > whole.left)
        or (box.top < window.top + reach and window.top > whole.top)
        or (box.left + box.width > right - reach and right < whole.left + whole.width)
        or (box.top + box.height > bottom - reach and bottom < whole.top + whole.height)
    )
