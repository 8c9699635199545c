"""The frame reader never returns an image from before the action."""

from __future__ import annotations

import time

import numpy as np
import pytest

from shape_obs import Frame
from shape_obs.source import FrameTimeout, StaleFrame
from shape_obs_envs.real.frame_reader import FrameReader

SIZE = (8, 6)


def frame(received: float | None, number: int) -> Frame:
    images = np.zeros((SIZE[1], SIZE[0], 3), np.uint8), np.full((SIZE[1], SIZE[0]), 500, np.uint16)
    return Frame(*images, received=received, number=number)


class Camera:
    """A live camera with a newest frame and a queue of others, as a driver holds them."""

    kind, name, live, has_depth, camera, intrinsics = "camera", "camera", True, True, None, None

    def __init__(self, newest: Frame | None, queue: list[Frame]) -> None:
        self.newest, self.queue = newest, queue

    def read_latest(self, max_age: float = 0.1) -> Frame:
        if self.newest is None or time.monotonic() - (self.newest.received or 0.0) > max_age:
            raise StaleFrame("the newest frame is older")
        return self.newest

    def read(self, timeout: float = 1.0, fresh: bool = False) -> Frame:
        if not self.queue:
            raise FrameTimeout(f"no frame within {timeout} s")
        return self.queue.pop(0)

    def connect(self) -> None:
        pass

    def disconnect(self) -> None:
        pass


def reader(newest: Frame | None, queue: list[Frame], live: bool = True) -> FrameReader:
    camera = Camera(newest, queue)
    camera.live = live
    return FrameReader(camera, SIZE, timeout=1.0)  # type: ignore[arg-type]


def test_the_newest_frame_is_taken_at_once_if_it_arrived_after_the_moment():
    now = time.monotonic()
    assert reader(frame(now, 7), []).frame_after(now - 10.0).number == 7


def test_the_newest_frame_is_refused_if_it_arrived_before_the_moment():
    """The frame is 50 ms older than the action, so it shows the scene before it."""
    now = time.monotonic()
    eye = reader(frame(now - 0.05, 7), [frame(now + 10.0, 8)])
    assert eye.frame_after(now).number == 8


@pytest.mark.parametrize("late", [1e-6, 0.001, 0.05, 5.0])
def test_frames_that_a_driver_has_queued_before_the_moment_are_skipped(late):
    moment = time.monotonic()
    queue = [frame(moment - late - 0.03, 5), frame(moment - late, 6), frame(moment, 7), frame(moment + 1.0, 8)]
    assert reader(frame(moment - late, 6), queue).frame_after(moment).number == 7


def test_a_moment_that_is_still_to_come_is_waited_for():
    moment = time.monotonic() + 5.0
    eye = reader(frame(time.monotonic(), 6), [frame(moment - 0.01, 7), frame(moment + 0.01, 8)])
    assert eye.frame_after(moment).number == 8


def test_no_old_frame_stands_in_where_no_new_one_comes():
    now = time.monotonic()
    with pytest.raises(FrameTimeout):
        reader(frame(now - 0.05, 6), [frame(now - 0.04, 7)]).frame_after(now)


def test_a_recording_gives_its_next_frame_at_any_age():
    now = time.monotonic()
    assert reader(None, [frame(now - 99.0, 6)], live=False).frame_after(now).number == 6
    assert reader(None, [frame(None, 6)]).frame_after(now).number == 6
