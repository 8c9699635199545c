"""Read frames for a control loop: new ones of the right size, or an error."""

from __future__ import annotations

import time
import warnings
from collections import deque
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraModel, Intrinsics
from shape_obs.frame import Frame
from shape_obs.robot import Robot
from shape_obs.source import NotConnected, RGBDSource, StaleFrame

#: Focal length of a D455's colour stream at 480 rows in pixels, used until the camera reports its own.
_FOCAL_480: Final = 386.0
#: Smallest time in seconds between two different frames.
_NEXT: Final = 1e-6
#: Number of frames used to estimate the clock offset: ten seconds, in which clocks drift by less than a millisecond.
_WINDOW: Final = 300
_COMPARED: Final = 2.0  # seconds after which the camera's clock is compared with this machine's


def open_frame_source(
    source: RGBDSource | str, robot: Robot | None, size: tuple[int, int], extrinsics: str | None
) -> RGBDSource:
    """Make the source for the environment's arguments; it is not connected yet.

    Raises:
        ValueError: The source cannot be opened.
    """
    if not isinstance(source, str):
        return source
    if source == "robot":
        own = getattr(robot, "source", None)
        if own is None:
            raise ValueError(f"source 'robot': {type(robot).__name__} has no camera; choose one, such as 'd455'.")
        return own()
    from shape_obs_envs.sources.opening import open_source, takes_size

    mode = {"width": size[0], "height": size[1]} if takes_size(source) else {}
    return open_source(source, extrinsics=extrinsics, **mode)


def delivers_depth(source: RGBDSource, wanted: bool | None) -> bool:
    """Return whether frames will have depth; a source that knows this only once it is connected is connected for it.

    Args:
        source: The source.
        wanted: True requires depth, False leaves it out, None takes it if there is any.

    Raises:
        ValueError: Depth is required, and there is none.
        SourceError: The source cannot be connected.
    """
    if wanted is False:
        return False
    try:
        there = source.has_depth
    except NotConnected:
        source.connect()
        try:
            there = source.has_depth
        finally:
            source.disconnect()
    if wanted and not there:
        raise ValueError(f"depth: {source.name} has none; leave depth=True out for features in pixels.")
    return there


class FrameReader:
    """Read a source for a control loop.

    Args:
        source: Source of the frames.
        size: Required size (width, height) in pixels.
        timeout: Longest wait for a frame in seconds.
        depth: Whether frames must have depth; otherwise depth is left out.
        now: The clock, in seconds.
    """

    def __init__(
        self,
        source: RGBDSource,
        size: tuple[int, int],
        timeout: float,
        depth: bool = True,
        *,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.source, self._size, self._timeout, self._depth = source, size, timeout, depth
        self._now = now
        self._transport: deque[float] = deque(maxlen=_WINDOW)
        self._clock = (0.0, now())  # stamp of the newest frame, and when it was read
        self._first: tuple[float, float] | None = None  # stamp and arrival of the first frame
        self._compared = False

    def exposed(self, frame: Frame, now: float) -> float:
        """Return the earliest time at which the exposure of a frame may have begun, ``time.monotonic()`` in seconds.

        If a live source does not report it, the arrival time without the frame's lag is used. Other sources have no
        running clock: their frames count as exposed now.
        """
        if not self.source.live or frame.received is None:
            return now
        self._compare_clocks(frame)
        arrived = frame.received - self.lag(frame)
        return arrived if frame.exposed is None else min(frame.exposed, arrived)

    def _compare_clocks(self, frame: Frame) -> None:
        """Warn if stamps do not advance by seconds, since a late frame cannot be recognised by them."""
        if frame.stamp is None or frame.received is None or self._compared:
            return
        if self._first is None:
            self._first = frame.stamp, frame.received
        passed = frame.received - self._first[1]
        if passed < _COMPARED:
            return
        self._compared, rate = True, (frame.stamp - self._first[0]) / passed
        if rate and not 0.5 < rate < 2:
            warnings.warn(
                f"{self.source.name}: its stamps advance by {rate:.3g} in a second: give them in seconds, since "
                "otherwise a late frame cannot be recognised.",
                stacklevel=4,
            )

    def connect(self) -> None:
        """Connect the source and reset the clock offset.

        Raises:
            SourceError: The source cannot be connected.
            ValueError: It has depth, but no intrinsics.
        """
        self._transport.clear()
        self._first, self._compared = None, False
        self.source.connect()
        if self._depth and self.source.camera is None:
            raise ValueError(
                f"{self.source.name} has depth but no intrinsics, without which depth is of no use; make the env with "
                "depth=False for features in pixels."
            )

    def lag(self, frame: Frame) -> float:
        """Return the delay in seconds of a frame against the fastest recent frame; 0 without a camera clock.

        The offset between the camera's clock and this machine's is unknown and estimated by the minimum over recent
        frames; only recent ones, because the clocks drift.
        """
        if frame.stamp is None or frame.received is None:
            return 0.0
        self._transport.append(frame.received - frame.stamp)
        return self._transport[-1] - min(self._transport)

    @property
    def camera(self) -> CameraModel | None:
        """Intrinsics and, if extrinsics are known, pose; None if unknown, as for most webcams.

        Before the source is connected: nominal intrinsics of a D455 if there is depth, else None.
        """
        try:
            return self.source.camera
        except NotConnected:
            if not self._depth:
                return None
        width, height = self._size
        focal = _FOCAL_480 * height / 480
        nominal = Intrinsics(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
        known = getattr(self.source, "extrinsics", None)
        return CameraModel(nominal) if known is None else CameraModel(nominal, np.asarray(known.T))

    def frame_after(self, moment: float) -> Frame:
        """Return the newest frame that arrived after a time of ``time.monotonic``; wait if there is none yet.

        Raises:
            SourceError: No frame came in time, or the camera is lost.
            ValueError: The frame has no colour, lacks depth, or has another size.
        """
        until = self._now() + self._timeout
        try:
            return self._checked(self.source.read_latest(max_age=max(0.0, self._now() - moment)))
        except StaleFrame:
            pass
        while True:
            frame = self.source.read(timeout=max(0.001, until - self._now()))
            if frame.received is None or frame.received >= moment or not self.source.live:
                return self._checked(frame)

    def frame_of(self, moment: float) -> Frame:
        """Return the first frame that shows the scene after a time of ``time.monotonic``, as far as the clocks show.

        The age of a frame is its lag: the fastest frames count as of their arrival. If all frames are late, the newest
        one is returned when the time limit is reached; its lag shows that it is late.

        Raises:
            SourceError: No frame came in time, or the camera is lost.
            ValueError: The frame has no colour, lacks depth, or has another size.
        """
        until = self._now() + self._timeout
        frame = self.frame_after(moment)
        while frame.received is not None and self.source.live and self._now() < until:
            if frame.received - self.lag(frame) >= moment:
                break
            frame = self.frame_after(frame.received + _NEXT)
        return frame

    def images(self, frame: Frame | None) -> dict[str, npt.NDArray[Any]]:
        """Return ``rgb`` and, if there is any, ``depth`` (millimetres) of a frame; black images for None."""
        width, height = self._size
        rgb = np.zeros((height, width, 3), np.uint8) if frame is None or frame.rgb is None else frame.rgb
        if not self._depth:
            return {"rgb": rgb}
        if frame is None or frame.depth is None:
            return {"rgb": rgb, "depth": np.zeros((height, width), np.uint16)}
        return {"rgb": rgb, "depth": _millimetres(frame.depth)}

    def info(self, frame: Frame | None, exposed: float) -> dict[str, Any]:
        """Return the entries of ``info`` that describe a frame; the stamp advances with the time if it has none."""
        now = self._now()
        stamp, taken = self._clock
        stamp = stamp + now - taken if frame is None or frame.stamp is None else frame.stamp
        self._clock = stamp, now
        info: dict[str, Any] = {"stamp": stamp}
        if frame is not None:
            received = now if frame.received is None else frame.received
            info |= {"lag": self.lag(frame), "received": received, "exposed": exposed}
        if frame is not None and frame.number is not None:
            info["frame"] = frame.number
        return info

    def _checked(self, frame: Frame) -> Frame:
        width, height = self._size
        if frame.rgb is None or (self._depth and frame.depth is None):
            raise ValueError(
                f"{self.source.name}: a frame has no {'colour' if frame.rgb is None else 'depth'}, which the env "
                "observes."
            )
        if frame.size != (height, width):
            seen = frame.size or (0, 0)
            raise ValueError(
                f"{self.source.name} provides images of {seen[1]} x {seen[0]} pixels, the env expects {width} x "
                f"{height}: make it with size=[{seen[1]}, {seen[0]}]."
            )
        return frame


def _millimetres(depth: npt.NDArray[Any]) -> npt.NDArray[np.uint16]:
    if depth.dtype == np.uint16:
        return depth
    millimetres = np.rint(np.nan_to_num(depth, nan=0.0, posinf=0.0, neginf=0.0) * 1000)
    return np.where((millimetres > 0) & (millimetres <= 65535), millimetres, 0).astype(np.uint16)
