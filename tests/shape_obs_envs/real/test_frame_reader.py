"""The frame reader never returns an image from before the action."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from fake_camera import FakeCamera
from fake_clock import FakeClock

from shape_obs import CameraModel, Frame, Intrinsics
from shape_obs.source import FrameTimeout
from shape_obs_envs.real.frame_reader import FrameReader

SIZE = (8, 6)
LENS = Intrinsics(*SIZE, 9.0, 9.0, 3.5, 2.5)


@pytest.fixture
def clock():
    return FakeClock()


@pytest.fixture
def camera(clock):
    """Return a camera with a frame every 0.1 s that was connected 1 s ago; ten frames wait to be read."""
    camera = FakeCamera(lambda _: np.zeros((6, 8, 3)), hertz=10.0, clock=clock, intrinsics=LENS)
    camera.connect()
    clock.sleep(1.0)
    return camera


@pytest.fixture
def reader(camera, clock):
    return FrameReader(camera, SIZE, timeout=1.0, now=clock.now)


def test_the_newest_frame_is_taken_at_once_if_it_arrived_after_the_moment(reader, clock):
    clock.sleep(0.05)
    assert reader.frame_after(clock.now() - 0.06).number == 10
    assert clock.now() == pytest.approx(1001.05)


@pytest.mark.parametrize("late", [1e-6, 0.001, 0.03])
def test_frames_from_before_the_moment_are_refused_also_those_that_a_driver_has_queued(reader, clock, late):
    clock.sleep(late)
    assert reader.frame_after(clock.now()).number == 11
    for _ in range(3):
        clock.sleep(0.1)
    assert reader.frame_after(clock.now()).number == 15


def test_a_moment_that_is_still_to_come_is_waited_for(reader, clock):
    assert reader.frame_after(clock.now() + 0.55).number == 16


def test_no_old_frame_stands_in_where_no_new_one_comes(reader, camera, clock):
    clock.sleep(0.05)
    camera.stall()
    with pytest.raises(FrameTimeout):
        reader.frame_after(clock.now())
    assert clock.now() == pytest.approx(1002.05)


def test_the_frame_of_a_moment_counts_its_lag(reader, camera, clock):
    """A frame that is 0.25 s late shows the scene of 0.25 s before it came."""
    reader.frame_of(clock.now())
    camera.delay = 0.25
    moment = clock.now()
    assert reader.frame_of(moment + 0.1).received == pytest.approx(moment + 0.4)
    camera.delay = 9.0
    assert reader.frame_of(moment + 1.0) is not None, "all are late: the newest, and its lag shows it"


@pytest.mark.parametrize(("rate", "words"), [(1.0, []), (1e3, ["by 1e+03"]), (30.0, ["by 30"]), (1e-3, ["by 0.001"])])
def test_stamps_that_do_not_run_like_this_machines_clock_are_reported_once(reader, rate, words):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for k in range(40):
            reader.exposed(Frame(stamp=5.0 + rate * k / 10, received=k / 10), k / 10)
    assert [word for each in caught for word in words if word in str(each.message)] == words
    assert len(caught) == len(words)


@pytest.mark.parametrize("received", [-99.0, None])
def test_a_recording_gives_its_next_frame_at_any_age(clock, received):
    images = np.zeros((6, 8, 3), np.uint8), np.full((6, 8), 500, np.uint16)
    received = None if received is None else clock.now() + received
    recording = FakeCamera([Frame(*images, CameraModel(LENS), received=received, number=6)], clock=clock)
    recording.live = received is None
    recording.connect()
    assert FrameReader(recording, SIZE, timeout=1.0, now=clock.now).frame_after(clock.now()).number == 6
