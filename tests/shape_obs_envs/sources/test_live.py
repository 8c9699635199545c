"""The base class of users' own cameras: it fills in what a frame lacks, and no reader waits for a thread that ended."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

from shape_obs import Frame, Intrinsics
from shape_obs.extrinsics import Extrinsics
from shape_obs.source import CameraLost, CameraNotFound, RGBDSource, check_source
from shape_obs_envs.sources import LiveSource

PLACE = Extrinsics(T=((1, 0, 0, 0), (0, -1, 0, 0), (0, 0, -1, 0.7), (0, 0, 0, 1)))


class Drawn(LiveSource):
    """A camera at 50 Hz that ends with an error."""

    def __init__(self, frames: int = 10**6, error: Exception | None = None, **options: Any) -> None:
        super().__init__("drawn:1", **options)
        self.frames, self.error, self.calls = frames, error, list[str]()
        self.there = True

    def open(self) -> None:
        if not self.there:
            raise CameraNotFound("it is not plugged in")
        self.calls.append("open")
        self.lens, self.count = Intrinsics(16, 12, 20.0, 20.0, 7.5, 5.5), 0

    def grab(self, timeout: float) -> Frame | None:
        time.sleep(0.02)
        if self.count == self.frames:
            if self.error is not None:
                raise self.error
            return None
        self.count += 1
        image = np.full((12, 16, 3), self.count % 256, np.uint8)
        return Frame(image, np.full((12, 16), 700, np.uint16), stamp=self.count / 50)

    def close(self) -> None:
        self.calls.append("close")


def test_frames_get_a_camera_a_number_and_their_times():
    source = Drawn(extrinsics=PLACE)
    check_source(source)
    with source:
        assert isinstance(source, RGBDSource)
        assert (source.kind, source.name, source.live, source.has_depth) == ("drawn", "drawn:1", True, True)
        frames: list[Any] = [source.read() for _ in range(3)]
        latest = source.read_latest(1.0)
    for number, frame in enumerate(frames):
        assert frame.number == number
        assert frame.rgb[0, 0, 0] == number + 1
        assert frame.camera.intrinsics == source.lens
        assert np.array_equal(frame.camera.transform_camera_to_base, PLACE.matrix)
        assert frame.exposed == pytest.approx(frame.received - 0.1)
        assert 0 <= time.monotonic() - frame.received < 5
    assert latest.camera == frames[0].camera
    assert source.calls == ["open", "close"]


def test_an_error_of_the_camera_is_passed_on_and_it_can_be_connected_again():
    source = Drawn(frames=2, error=CameraLost("the cable is out"))
    source.connect()
    assert [source.read().number, source.read().number] == [0, 1]
    with pytest.raises(CameraLost, match=r"drawn:1: the cable is out\. Check it, and connect again\."):
        source.read(5.0)
    source.there = False
    with pytest.raises(CameraNotFound):
        source.connect()
    source.there = True
    source.connect()
    assert source.read().number == 0
    source.disconnect()
    assert source.calls == ["open", "close", "open", "close"]


def test_a_silent_camera_is_lost_after_a_while():
    with Drawn(frames=1, patience=0.2) as source:
        source.read()
        with pytest.raises(CameraLost, match=r"no frame for 0\.2 s"):
            source.read(5.0)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_bug_in_a_users_class_ends_the_wait_of_its_readers():
    source = Drawn(frames=1, error=ZeroDivisionError("a bug"))
    with source:
        source.read()
        with pytest.raises(CameraLost, match="internal error; see above"):
            source.read(5.0)
    assert source.calls == ["open", "close"]
