"""The base class of users' own cameras: it fills in what a frame lacks, and no reader waits for a thread that ended."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from fake_camera import INTRINSICS, OVERHEAD, FakeCamera

from shape_obs import Frame
from shape_obs.source import CameraLost, CameraNotFound, FrameTimeout, RGBDSource, check_source
from shape_obs.utils.timing import CLOCK
from shape_obs_envs.sources import LiveSource


class Driver(LiveSource):
    """A user's driver of the fake camera, in real time at 50 Hz, which gives only images and stamps."""

    def __init__(self, script: Any = None, **options: Any) -> None:
        super().__init__("fake:1", OVERHEAD, **options)
        image = np.zeros((120, 160, 3), np.uint8)
        self.device = FakeCamera(lambda number: image + number, script, hertz=50.0, clock=CLOCK)

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


def test_frames_get_a_camera_a_number_and_their_times():
    source = Driver()
    check_source(source)
    with source:
        assert isinstance(source, RGBDSource)
        assert (source.kind, source.name, source.live, source.has_depth) == ("fake", "fake:1", True, True)
        frames: list[Any] = [source.read() for _ in range(3)]
        latest = source.read_latest(1.0)
    for number, frame in enumerate(frames):
        assert frame.number == number == frame.rgb[0, 0, 0]
        assert frame.camera.intrinsics == source.lens
        assert np.array_equal(frame.camera.transform_camera_to_base, OVERHEAD.matrix)
        assert frame.exposed == pytest.approx(frame.received - 0.1)
        assert 0 <= CLOCK.now() - frame.received < 5
    assert latest.camera == frames[0].camera
    assert source.device.calls == ["connect", "disconnect"]


def test_an_error_of_the_camera_is_passed_on_and_it_can_be_connected_again():
    source = Driver({2: FakeCamera.unplug})
    source.connect()
    assert [source.read().number, source.read().number] == [0, 1]
    with pytest.raises(CameraLost, match=r"fake:1: fake camera: it was unplugged\. Check it, and connect again\."):
        source.read(5.0)
    with pytest.raises(CameraNotFound):
        source.connect()
    source.device.plug()
    source.connect()
    source.disconnect()
    assert source.device.calls == ["connect", "disconnect", "connect", "connect", "disconnect"]


def test_a_camera_that_stalls_is_lost_after_a_while():
    with Driver({1: FakeCamera.stall}, patience=0.2) as source:
        source.read()
        with pytest.raises(CameraLost, match=r"no frame for 0\.2 s"):
            source.read(5.0)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_bug_in_a_users_class_ends_the_wait_of_its_readers():
    with Driver({1: lambda camera: camera.fail(ZeroDivisionError("a bug"))}) as source:
        source.read()
        with pytest.raises(CameraLost, match="internal error; see above"):
            source.read(5.0)
    assert source.device.calls == ["connect", "disconnect"]
