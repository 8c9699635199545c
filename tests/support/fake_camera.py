"""A camera that plays a script of events: stalls, errors, unplugging."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from fake_clock import FakeClock

from shape_obs import CameraModel, Frame, Intrinsics
from shape_obs.extrinsics import Extrinsics
from shape_obs.source import CameraLost, CameraNotFound, EndOfSource, FrameTimeout, NotConnected, Source, StaleFrame
from shape_obs.utils.timing import Clock

WIDTH, HEIGHT = 160, 120
INTRINSICS = Intrinsics(WIDTH, HEIGHT, fx=100.0, fy=100.0, cx=79.5, cy=59.5)
#: Straight above the table, 0.7 m high; x to the right, y up in the image.
OVERHEAD = Extrinsics(((1.0, 0.0, 0.0, 0.0), (0.0, -1.0, 0.0, 0.0), (0.0, 0.0, -1.0, 0.7), (0.0, 0.0, 0.0, 1.0)))


class FakeCamera(Source):
    """A camera whose frame ``n`` comes ``n / hertz`` seconds after it was connected, and waits until it is read.

    Args:
        images: Image (H, W, 3) uint8 of a frame, as a function of its number; or frames, which are returned as they
            are, with their camera, until they end.
        script: Number of a frame -> event, called when the frame is due, for example ``FakeCamera.unplug``. Tests may
            call the same methods at any time.
        hertz: Frames per second; infinity: all frames wait from the beginning.
        clock: Time; a fake clock of its own if there is none.
        depth: Depth of all pixels in millimetres; None for a camera without depth.
        intrinsics: Lens of a camera that looks straight down on the table; None if unknown.

    Attributes:
        calls: "connect" and "disconnect", in order; attempts that failed too.
        delay: Seconds by which frames are older when they arrive.
        exposure: Seconds from the beginning of a frame's exposure to its arrival; None if the camera does not know it.
        dark: Whether images are black.
    """

    kind, name, live = "camera", "fake camera", True

    def __init__(
        self,
        images: Callable[[int], Any] | Sequence[Frame],
        script: Mapping[int, Callable[[FakeCamera], object]] | None = None,
        *,
        hertz: float | None = None,
        clock: Clock | None = None,
        depth: int | None = 700,
        intrinsics: Intrinsics | None = INTRINSICS,
    ) -> None:
        super().__init__(OVERHEAD)
        self._images, self._script = images, dict(script or {})
        given = not callable(images)
        self.has_depth = depth is not None if callable(images) else images[0].depth is not None
        self.clock, self._depth, self._lens = clock or FakeClock(), depth, intrinsics if callable(images) else None
        self._period = 1 / (hertz or (math.inf if given else 100.0))
        self._begin: float | None = None
        self._last, self._silent = -1, (math.inf, math.inf)
        self._error: BaseException | None = None
        self._unplugged = self.dark = False
        self.calls: list[str] = []
        self.delay = 0.0
        self.exposure: float | None = None

    def stall(self, seconds: float = math.inf) -> None:
        """Deliver nothing for some seconds."""
        self._silent = (self.clock.now(), self.clock.now() + seconds)

    def unplug(self) -> None:
        """Be lost to those who read, and absent to those who connect."""
        self._unplugged = True

    def plug(self) -> None:
        """Be there again, and deliver frames."""
        self._unplugged, self._silent = False, (math.inf, math.inf)

    def fail(self, error: BaseException) -> None:
        """Raise an error, once, instead of the next frame."""
        self._error = error

    # ---- RGBDSource

    @property
    def intrinsics(self) -> Intrinsics | None:
        if self._begin is None:
            raise NotConnected("fake camera: connect first")
        return self._lens

    @property
    def camera(self) -> CameraModel | None:
        return super().camera if callable(self._images) else self._images[0].camera

    def connect(self) -> None:
        self.calls.append("connect")
        if self._unplugged:
            raise CameraNotFound("fake camera: it is not plugged in")
        if self._begin is None:
            self._begin = self.clock.now()
            if callable(self._images):
                self._last = -1

    def disconnect(self) -> None:
        self.calls.append("disconnect")
        self._begin = None

    def read(self, timeout: float = 1.0, fresh: bool = False) -> Frame:
        begin = self._check()
        number = self._last + 1
        silent, again = self._silent
        due = begin + number * self._period
        if silent <= max(due, self.clock.now()) < again:  # what came meanwhile is lost
            due, number = again, number if math.isinf(again) else math.ceil((again - begin) / self._period)
        left = due - self.clock.now()
        self.clock.sleep(max(0.0, min(left, timeout)))
        if left > timeout:
            raise FrameTimeout(f"fake camera: no frame in {timeout:g} s")
        if self._play(number):
            return self.read(timeout)
        return self._frame(number)

    def read_latest(self, max_age: float = 0.1) -> Frame:
        begin, number = self._check(), self._newest()
        if self._play(number):
            begin, number = self._check(), self._newest()
        if number < 0 or self.clock.now() - (begin + number * self._period) >= max_age - 1e-9:
            raise StaleFrame("fake camera: the newest frame is older")
        return self._frame(number)

    # ---- internal

    def _check(self) -> float:
        """Return when the camera was connected, if frames can come."""
        if self._begin is None:
            raise NotConnected("fake camera: connect first")
        if self._unplugged:
            raise CameraLost("fake camera: it was unplugged")
        return self._begin

    def _newest(self) -> int:
        if not self._period:
            return self._last + 1
        assert self._begin is not None
        now, (silent, again) = self.clock.now(), self._silent
        return math.floor(((silent if silent <= now < again else now) - self._begin) / self._period + 1e-6)

    def _play(self, number: int) -> bool:
        """Call the events up to a frame; return whether there were any."""
        due = sorted(each for each in self._script if each <= number)
        for each in due:
            self._script.pop(each)(self)
        return bool(due)

    def _frame(self, number: int) -> Frame:
        error, self._error = self._error, None
        if error is not None:
            raise error
        if not callable(self._images) and number >= len(self._images):
            raise EndOfSource(f"fake camera: end of its {number} frames")
        self._last = number
        if not callable(self._images):
            return self._images[number]
        arrived = self._check() + number * self._period
        image = np.asarray(self._images(number), np.uint8)
        return Frame(
            np.zeros_like(image) if self.dark else image,
            None if self._depth is None else np.full(image.shape[:2], self._depth, np.uint16),
            self.camera,
            stamp=arrived - 900.0 - self.delay,
            received=arrived,
            number=number,
            exposed=None if self.exposure is None else arrived - self.exposure,
        )
