"""What every live source promises: a user's own driver on the base class, a webcam, and a D455 behind librealsense."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import numpy as np
import pytest
from fake_camera import INTRINSICS, OVERHEAD, FakeCamera
from mjpeg_camera import MjpegCamera

from shape_obs import Frame
from shape_obs.source import (
    CameraLost,
    CameraNotFound,
    FrameTimeout,
    NotConnected,
    RGBDSource,
    StaleFrame,
    check_source,
)
from shape_obs.utils.timing import CLOCK
from shape_obs_envs.sources import LiveSource, WebcamSource

BLACK = np.zeros((120, 160, 3), np.uint8)


class Driver(LiveSource):
    """A user's driver of the fake camera, in real time at 50 Hz, which gives only images and stamps."""

    def __init__(self, script: Any = None, **options: Any) -> None:
        super().__init__("fake:1", OVERHEAD, **options)
        self.device = FakeCamera(lambda number: BLACK + number % 200, script, hertz=50.0, clock=CLOCK)

    def open(self) -> None:
        self.device.connect()
        self.lens = INTRINSICS

    def grab(self, timeout: float) -> Frame | None:
        try:
            frame = self.device.read(timeout)
        except FrameTimeout:
            return None
        return Frame(frame.rgb, frame.depth, stamp=frame.stamp)

    def close(self) -> None:
        self.device.disconnect()


class DriverRig:
    """A source, and the ways to disturb its camera."""

    def __init__(self, end: ExitStack, **options: Any) -> None:
        self.source: Any = Driver(**options)
        self.pause, self.unplug, self.plug = (getattr(self.source.device, name) for name in ("stall", "unplug", "plug"))
        self.go_on = self.plug


class WebcamRig:
    """The same of a network camera."""

    def __init__(self, end: ExitStack, **options: Any) -> None:
        self._end, self._camera = end, end.enter_context(MjpegCamera(lambda number: BLACK + number % 200, 30.0))
        self.source: Any = WebcamSource(self._camera.url, **options)

    def pause(self, paused: bool = True) -> None:
        self._camera.paused = paused

    def go_on(self) -> None:
        self.pause(False)

    def unplug(self) -> None:
        self._camera.close()

    def plug(self) -> None:
        self._camera = self._end.enter_context(MjpegCamera(lambda _: BLACK, 30.0, self._camera.port))


class D455Rig:
    """The same of a software D455."""

    def __init__(self, end: ExitStack, **options: Any) -> None:
        from camera_scene import camera, source, streaming

        self._device = camera()
        end.enter_context(streaming(self._device))
        self.source: Any = source(self._device, recover_timeout=0.6, **options)
        self.unplug, self.plug = self._device.unplug, self._device.plug

    def pause(self) -> None:
        self._device.freeze_colour()

    def go_on(self) -> None:
        self._device.freeze_colour(False)


@pytest.fixture(params=[DriverRig, WebcamRig, D455Rig])
def rig(request) -> Iterator[Any]:
    """Return a function that makes a rig."""
    with ExitStack() as end:
        yield lambda **options: request.param(end, **options)


def read_all(source: Any, timeout: float) -> None:
    """Read until an error."""
    while True:
        source.read(timeout)


def is_live(source: Any) -> bool:
    return isinstance(source, RGBDSource) and source.live


class TestEveryLiveSource:
    def test_frames_are_numbered_stamped_and_of_the_reader_and_it_connects_again(self, rig):
        source = rig().source
        check_source(source)
        for _ in range(2):
            for read in (source.read, source.read_latest, lambda: source.intrinsics, lambda: source.dropped):
                with pytest.raises(NotConnected, match=source.name):
                    read()
            with source:
                source.connect()
                assert is_live(source)
                frames: list[Any] = [source.read(5.0) for _ in range(3)]
                assert np.diff([frame.number for frame in frames]).tolist() == [1, 1]
                for frame in frames:
                    assert (frame.depth is not None) == source.has_depth
                    assert (frame.camera is None) == (source.camera is None)
                    assert frame.exposed <= frame.received <= time.monotonic()
                    assert frame.stamp is not None
                latest = source.read_latest(9.0)
                kept = latest.rgb.copy()
                source.read_latest(9.0).rgb[:] = 7  # the caller's own
                assert np.array_equal(latest.rgb, kept)

    def test_the_newest_frames_are_kept_while_it_is_not_read(self, rig):
        with rig(buffer=4).source as source:
            end = time.monotonic() + 20
            while source.dropped < 6:
                assert time.monotonic() < end
                time.sleep(0.01)
            latest = source.read_latest(9.0).number
            assert source.read(5.0).number >= latest - 4

    def test_a_fresh_frame_was_exposed_after_the_call(self, rig):
        with rig().source as source:
            source.read(5.0)
            called = time.monotonic()
            assert source.read(5.0, fresh=True).exposed >= called

    def test_a_camera_that_is_silent_times_out_and_is_not_read_from_the_past(self, rig):
        made = rig(patience=30)
        with made.source as source:
            source.read(5.0)
            made.pause()
            with pytest.raises(FrameTimeout, match=r"within 0\.2 s"):
                read_all(source, 0.2)
            with pytest.raises(StaleFrame, match=r"last 0\.1 s, the newest came"):
                source.read_latest()
            made.go_on()
            assert source.read(5.0, fresh=True)

    def test_a_camera_that_disappears_is_lost_and_can_be_connected_again(self, rig):
        made = rig(patience=0.2)
        source = made.source
        source.connect()
        source.read(5.0)
        made.unplug()
        with pytest.raises(CameraLost, match="connect again"):
            read_all(source, 9.0)
        with pytest.raises(CameraLost):
            source.read_latest(1.0)
        with pytest.raises(CameraNotFound):
            source.connect()
        made.plug()
        source.connect()
        assert source.read(5.0)
        source.disconnect()


def test_frames_of_a_users_driver_get_a_camera_a_number_and_their_times():
    with Driver() as source:
        assert (source.kind, source.name, source.has_depth) == ("fake", "fake:1", True)
        frame: Any = source.read()
    assert (frame.number, frame.camera.intrinsics) == (0, INTRINSICS)
    assert np.array_equal(frame.camera.transform_camera_to_base, OVERHEAD.matrix)
    assert frame.exposed == pytest.approx(frame.received - 0.1)
    assert source.device.calls == ["connect", "disconnect"]


@pytest.mark.parametrize(
    ("event", "message"),
    [
        (FakeCamera.stall, r"no frame for 0\.2 s"),
        (FakeCamera.unplug, r"fake:1: fake camera: it was unplugged\. Check it, and connect again\."),
        (lambda camera: camera.fail(ZeroDivisionError("a bug")), "internal error; see above"),
    ],
)
@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_whatever_ends_a_users_driver_ends_the_wait_of_its_readers(event, message):
    with Driver({1: event}, patience=0.2) as source:
        source.read()
        with pytest.raises(CameraLost, match=message):
            source.read(5.0)
    assert source.device.calls == ["connect", "disconnect"]
