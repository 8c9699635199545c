"""How the cell looks through its source: new frames of the right size, or an error."""

from __future__ import annotations

import time
from collections import deque
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraModel, Intrinsics
from shape_obs.frame import Frame
from shape_obs.robot import Robot
from shape_obs.source import NotConnected, RGBDSource, StaleFrame

#: Focal length of a D455's colour stream at 480 rows [px], until the camera has told its own.
_FOCAL_480: Final = 386.0
#: Seconds after a frame from which another one is the next.
_NEXT: Final = 1e-6
#: Frames that tell the offset between the clocks: ten seconds, in which they drift by less than a millisecond.
_WINDOW: Final = 300


def open_eye(
    source: RGBDSource | str, robot: Robot | None, size: tuple[int, int], extrinsics: str | None
) -> RGBDSource:
    """The source that the cell's arguments ask for, not yet connected.

    Raises:
        ValueError: Nothing that can be opened.
    """
    if not isinstance(source, str):
        return source
    if source == "robot":
        own = getattr(robot, "source", None)
        if own is None:
            raise ValueError(f"source 'robot': {type(robot).__name__} brings no camera; name one, such as 'd455'.")
        return own()
    from shape_obs_envs.sources import open_source

    # Only a camera has a choice.
    mode = {"width": size[0], "height": size[1]} if source.split(":")[0] == "d455" else {}
    return open_source(source, extrinsics=extrinsics, **mode)


class Eye:
    """A source, read as a control loop needs it.

    Args:
        source: Where frames come from.
        size: (width, height) that they must have [px].
        timeout: How long to wait for one [s].
    """

    def __init__(self, source: RGBDSource, size: tuple[int, int], timeout: float) -> None:
        self.source, self._size, self._timeout = source, size, timeout
        self._transport: deque[float] = deque(maxlen=_WINDOW)

    def exposed(self, frame: Frame, now: float) -> float:
        """Return the earliest time at which the exposure of a frame may have begun, ``time.monotonic()`` in seconds.

        A frame of a live source that does not know it counts as exposed when the quickest frames would have arrived.
        Other sources have no clock that runs on: their frames count as exposed now.
        """
        if not self.source.live or frame.received is None:
            return now
        arrived = frame.received - self.lag(frame)
        return arrived if frame.exposed is None else min(frame.exposed, arrived)

    def connect(self) -> None:
        """Connect the source; what was known of its clock is forgotten."""
        self._transport.clear()
        self.source.connect()

    def lag(self, frame: Frame) -> float:
        """Seconds by which a frame arrived later than the quickest of the last ones; 0 where there is no clock.

        The camera's clock and this machine's differ by an unknown offset, which is the least that was seen; of the last
        ones alone, since the clocks drift apart.
        """
        if frame.stamp is None or frame.received is None:
            return 0.0
        self._transport.append(frame.received - frame.stamp)
        return self._transport[-1] - min(self._transport)

    @property
    def camera(self) -> CameraModel:
        """Intrinsics and, where extrinsics are known, pose; a D455's nominal intrinsics before it is connected."""
        try:
            camera = self.source.camera
        except NotConnected:
            camera = None
        if camera is not None:
            return camera
        width, height = self._size
        focal = _FOCAL_480 * height / 480
        nominal = Intrinsics(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
        known = getattr(self.source, "extrinsics", None)
        return CameraModel(nominal) if known is None else CameraModel(nominal, np.asarray(known.T))

    def frame_after(self, moment: float) -> Frame:
        """The newest frame that arrived after a moment of `time.monotonic`, waited for where there is none yet.

        Raises:
            SourceError: None came in time, or the camera is gone.
            ValueError: It has no colours, no depth, or another size.
        """
        until = time.monotonic() + self._timeout
        try:
            return self._checked(self.source.read_latest(max_age=max(0.0, time.monotonic() - moment)))
        except StaleFrame:
            pass
        while True:
            frame = self.source.read(timeout=max(0.001, until - time.monotonic()))
            if frame.received is None or frame.received >= moment or not self.source.live:
                return self._checked(frame)

    def frame_of(self, moment: float) -> Frame:
        """The first frame at hand of what there was after a moment of `time.monotonic`, as far as clocks tell.

        The quickest frames count as of when they arrived; one that came later by its lag is older by that. Where all
        are late, the newest is taken when the time is over: it is told by its lag.

        Raises:
            SourceError: None came in time, or the camera is gone.
            ValueError: It has no colours, no depth, or another size.
        """
        until = time.monotonic() + self._timeout
        frame = self.frame_after(moment)
        while frame.received is not None and self.source.live and time.monotonic() < until:
            if frame.received - self.lag(frame) >= moment:
                break
            frame = self.frame_after(frame.received + _NEXT)
        return frame

    def images(self, frame: Frame | None) -> dict[str, npt.NDArray[Any]]:
        """`rgb` and `depth` [mm] of a frame; black without one, since an old image would pass for a new one."""
        width, height = self._size
        if frame is None or frame.rgb is None or frame.depth is None:
            return {"rgb": np.zeros((height, width, 3), np.uint8), "depth": np.zeros((height, width), np.uint16)}
        return {"rgb": frame.rgb, "depth": _millimetres(frame.depth)}

    def _checked(self, frame: Frame) -> Frame:
        width, height = self._size
        if frame.rgb is None or frame.depth is None:
            raise ValueError(
                f"{self.source.name} gives no {'colours' if frame.rgb is None else 'depth'}: an RGB-D source is needed."
            )
        if frame.size != (height, width):
            seen = frame.size or (0, 0)
            raise ValueError(
                f"{self.source.name} gives images of {seen[1]} x {seen[0]} pixels, the env was made for {width} x "
                f"{height}: make it with size=[{seen[1]}, {seen[0]}]."
            )
        return frame


def _millimetres(depth: npt.NDArray[Any]) -> npt.NDArray[np.uint16]:
    if depth.dtype == np.uint16:
        return depth
    millimetres = np.rint(np.nan_to_num(depth, nan=0.0, posinf=0.0, neginf=0.0) * 1000)
    return np.where((millimetres > 0) & (millimetres <= 65535), millimetres, 0).astype(np.uint16)
