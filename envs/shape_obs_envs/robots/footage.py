"""Footage: passes a simulation's pictures on to a camera, and remembers what they show."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs_envs.robots.faults import Faults
from shape_obs_envs.robots.slots import Pictures
from shape_obs_envs.robots.world import Shot
from shape_obs_envs.sources.realsense import SoftwareD455

Array = npt.NDArray[np.float64]
_LOG: Final = logging.getLogger(__name__)
#: Frames whose truth is remembered: five minutes at 30 Hz.
_REMEMBERED: Final = 9000
#: Frames over which the pace is judged.
_PACE: Final = 60


class Footage:
    """Pushes pictures into a camera, with faults where there are to be some.

    Args:
        camera: Where they go.
        fps: How many a second there should be.

    Attributes:
        faults: What goes wrong with them.
        anchors: Where the grippers held the object in the last one: name -> (x, y, z) [m], base frame.
    """

    def __init__(self, camera: SoftwareD455, fps: float) -> None:
        self._camera, self._fps = camera, fps
        self.faults = Faults()
        self.anchors: dict[str, tuple[float, ...]] = {}
        self._truth: dict[int, Array] = {}
        self._stamps: deque[float] = deque(maxlen=_PACE)
        self._taking, self._told_slow = threading.Lock(), False

    def begin(self, anchors: dict[str, tuple[float, ...]]) -> None:
        """The scene was set anew; the object is held at ``anchors``."""
        self.anchors = anchors
        self._stamps.clear()

    def take(self, shot: Shot, pictures: Pictures | None) -> None:
        """Pass a picture on; in the thread that hears of it."""
        self._stamps.append(shot.stamp)
        self._tell_pace()
        if pictures is None:
            return
        colour, depth = pictures
        faults, camera = self.faults, self._camera
        fault = faults.draw()
        if fault == "delay":
            time.sleep(faults.lateness())
        elif fault == "drop":
            camera.drop()
        elif fault == "freeze":
            camera.freeze_colour()
        elif fault == "black":
            colour = np.zeros_like(colour)
        with self._taking:  # whoever has read the frame and asks for its truth waits for it
            self.anchors = shot.anchors
            number = camera.push_raw(colour, depth, stamp=shot.stamp)
            self._truth[number] = shot.points
            if len(self._truth) > _REMEMBERED:
                del self._truth[next(iter(self._truth))]
        if fault == "freeze":
            camera.freeze_colour(False)
        for kind in [fault] * bool(fault) + ["occluder"] * shot.covered:
            faults.note(kind, number)

    def truth(self, number: int) -> Array:
        """True points (n,3) [m] in a frame, base frame.

        Raises:
            KeyError: No such frame was taken, or more than 9000 frames ago.
        """
        with self._taking:
            if number not in self._truth:
                raise KeyError(f"no frame {number} is remembered; {len(self._truth)} are")
            return self._truth[number].copy()

    @property
    def pace(self) -> float:
        """Pictures a second, over the last ones; 0 before there are two."""
        stamps = list(self._stamps)
        return (len(stamps) - 1) / (stamps[-1] - stamps[0]) if len(stamps) > 1 else 0.0

    def _tell_pace(self) -> None:
        if self._told_slow or len(self._stamps) < _PACE or self.pace > 0.9 * self._fps:
            return
        self._told_slow = True
        _LOG.warning(
            "The simulation takes %.1f pictures a second of the %g that it should: choose a lower fps, or a faster "
            "renderer.",
            self.pace,
            self._fps,
        )
