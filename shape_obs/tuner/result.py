"""What was found in one frame, and the mask that it was found in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from shape_obs.config.detector_config import DetectorConfig
from shape_obs.image.region import Region
from shape_obs.image.roi import ROI
from shape_obs.image.segmentation import Segmentation
from shape_obs.recording.format import Moment
from shape_obs.shape import Detection
from shape_obs.tracking.search_window import RegionSearch
from shape_obs.tuner.session import Session

Mask = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Result:
    """What was found in a frame.

    Args:
        number: Grows with each result.
        moment: The frame.
        config: With what it was searched.
        roi: Where it was searched, standing still; None where the area is unknown.
        regions: The mask of each pixel rule, largest pieces kept.
        detection: The shapes; None without a segmentation, or after an error.
        error: Why the detector cannot process this frame; empty if it can.
    """

    number: int
    moment: Moment
    config: DetectorConfig
    roi: ROI | None
    regions: Mapping[Segmentation, Region] = field(default_factory=dict)
    detection: Detection | None = None
    error: str = ""

    @property
    def size(self) -> tuple[int, int]:
        """``(H, W)`` of the frame."""
        return self.moment.frame.size or (0, 0)

    @property
    def mask(self) -> Mask:
        """``(H, W)`` uint8, 255 where a pixel belongs to an object."""
        mask = np.zeros(self.size, np.uint8)
        for region in self.regions.values():
            part = mask[region.window.slices]
            np.maximum(part, np.where(region.mask > 0, np.uint8(255), np.uint8(0)), out=part)
        return mask

    def picture(self) -> npt.NDArray[np.uint8]:
        """Return the colour image, ``(H, W, 3)`` uint8 RGB; a gray image of the depth where there is no colour."""
        frame = self.moment.frame
        if frame.rgb is not None:
            return frame.rgb
        assert frame.depth is not None
        depth = np.nan_to_num(frame.depth.astype(np.float32))
        most = max(float(np.percentile(depth, 99)), 1e-6)
        return np.repeat((255 * np.clip(depth / most, 0, 1)).astype(np.uint8)[..., None], 3, axis=-1)


class Finder:
    """Detect the shapes in one frame after the other, with the settings of a session as they are at that time.

    Args:
        session: The settings.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._detector = session.detector
        self._episode, self._number = -1, 0
        self._memory: Any = None  # of a region of interest that moves

    @property
    def is_current(self) -> bool:
        """Whether the last frame was processed with the present settings."""
        return self._detector is self._session.detector

    def forget(self) -> None:
        """Begin again with the next frame: it does not follow the last one."""
        self._detector.reset()
        self._memory = None

    def find(self, moment: Moment) -> Result:
        """Detect the shapes in a frame; an error becomes part of the result."""
        if not self.is_current or moment.episode != self._episode:
            self._detector, self._episode = self._session.detector, moment.episode
            self.forget()
        self._number += 1
        config, frame = self._detector.config, moment.frame
        rules = {shape.segmentation for shape in config.filled()} - {None}
        roi: ROI | None = config.roi
        regions: dict[Segmentation, Region] = {}
        try:
            if type(config.roi).place is not ROI.place:
                roi, self._memory, _ = config.roi.place(frame.rgb, self._memory)
            if roi is not None:
                search = RegionSearch(frame, None, roi, roi.window(frame.size or (0, 0)))
                regions = {rule: search.region(rule) for rule in rules if rule is not None}
            if not rules:
                return Result(self._number, moment, config, roi)
            detection = self._detector.detect(
                frame.rgb, frame.depth, frame.camera, stamp=frame.stamp, anchors=moment.anchors
            )
        except (ValueError, TypeError) as error:
            return Result(self._number, moment, config, roi if regions else None, regions, None, str(error))
        return Result(self._number, moment, config, roi, regions, detection)
