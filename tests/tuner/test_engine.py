"""The thread that plays a source: recordings, cameras that disappear, pages that close."""

from __future__ import annotations

import threading
import time

import cv2
import numpy as np
import pytest
from fake_camera import FakeCamera
from fake_clock import FakeClock

from shape_obs.recording import record
from shape_obs.source import BadRecording, CameraNotFound
from shape_obs.tuner.engine import Engine
from shape_obs.tuner.session import Session
from shape_obs_envs.sources import FolderSource, PhotoSource, VideoSource

BLUE = {"segmentation": {"kind": "hsv", "low": [100, 120, 40], "high": [130, 255, 255]}}


@pytest.fixture
def played():
    """Return a function that starts an engine with a page; all are stopped at the end."""
    engines = []

    def play(source, arguments=BLUE, **options):
        engine = Engine(source, Session(arguments), clock=getattr(source, "clock", FakeClock()), **options)
        engines.append(engine)
        engine.open_page()
        engine.start()
        return engine

    yield play
    for engine in engines:
        engine.stop()


@pytest.fixture
def camera(blue):
    """Return a camera at 30 Hz with a rope that moves down; its script may be filled."""
    return FakeCamera(lambda i: np.roll(blue, 2 * (i % 20), axis=0), hertz=30.0, depth=None, intrinsics=None)


@pytest.fixture
def photos(tmp_path, blue):
    """Return a folder of twelve photos of a rope that moves down."""
    for i in range(12):
        cv2.imwrite(str(tmp_path / f"{i}.png"), cv2.cvtColor(np.roll(blue, 2 * i, axis=0), cv2.COLOR_RGB2BGR))
    return tmp_path


def wait(condition, seconds=20.0):
    """Wait for the thread."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.002)


def first_point(engine) -> float:
    """Return the row of point 0."""
    return float(engine.result.detection.shapes[0].points2d[0, 1])


@pytest.mark.parametrize("kind", ["photos", "recording", "video"])
def test_a_recording_plays_to_its_end_again_and_from_any_place(kind, played, photos, tmp_path, blue):
    source = FolderSource(photos)
    if kind == "recording":
        record(source, tmp_path / "recording")
        source = FolderSource(tmp_path / "recording")
    elif kind == "video":
        writer = cv2.VideoWriter(str(tmp_path / "a.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (320, 240))
        for i in range(12):
            writer.write(cv2.cvtColor(np.roll(blue, 2 * i, axis=0), cv2.COLOR_RGB2BGR))
        writer.release()
        source = VideoSource(tmp_path / "a.avi")
    engine = played(source)
    wait(lambda: engine.state == "ended")
    assert (engine.position, engine.number, engine.result.detection.ok) == (11, 12, True)
    engine.play()
    wait(lambda: engine.number == 24 and engine.state == "ended")
    engine.go(3)
    wait(lambda: engine.position == 3 and engine.state == "paused")
    third = first_point(engine)
    engine.step(1)
    wait(lambda: engine.position == 4)
    assert first_point(engine) == pytest.approx(third + 2, abs=0.5)
    engine.step(-2)
    wait(lambda: engine.position == 2)
    assert first_point(engine) == pytest.approx(third - 2, abs=0.5)


def test_without_a_rule_a_recording_waits_for_the_first_click(played, photos):
    engine = played(FolderSource(photos), None)
    wait(lambda: engine.number == 1 and engine.state == "paused")
    assert engine.result.detection is None


def test_a_change_is_seen_while_it_is_paused(played, photos):
    engine = played(FolderSource(photos))
    engine.go(0)
    wait(lambda: engine.state == "paused" and engine.position == 0)
    engine.session.set(("shapes", 0, "n"), 7)
    wait(lambda: len(engine.result.detection.shapes[0].points2d) == 7)
    picture = engine.jpeg
    engine.session.set(("segmentation", "low", 0), 129)
    wait(lambda: not engine.result.detection.ok)
    wait(lambda: engine.jpeg != picture)
    decoded = cv2.imdecode(np.frombuffer(engine.jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None
    assert decoded.shape == (480, 640, 3)
    engine.session.set_roi(((5000.0, 0.0), (5010.0, 10.0)))
    wait(lambda: "outside" in engine.result.error)


def test_what_cannot_be_opened_is_an_error(photos, camera, monkeypatch):
    monkeypatch.setattr(FolderSource, "connect", lambda self: {}["calibration"])  # a mistake in a class of the user's
    with pytest.raises(KeyError, match="calibration"):
        Engine(FolderSource(photos), Session()).start()
    with pytest.raises(BadRecording, match="no such file"):
        Engine(PhotoSource(photos / "none.png"), Session()).start()
    camera.unplug()
    with pytest.raises(CameraNotFound, match="not plugged in"):
        Engine(camera, Session()).start()


def test_a_damaged_frame_is_passed_over(played, photos):
    (photos / "5.png").write_bytes(b"not a picture")
    engine = played(FolderSource(photos))
    wait(lambda: engine.state == "ended")
    assert engine.number == 11
    engine.go(5)
    wait(lambda: "5.png" in engine.message)
    engine.go(6)
    wait(lambda: engine.message == "" and engine.position == 6)


def test_a_lost_camera_is_used_again_when_it_is_back(played, camera):
    engine = played(camera)
    wait(lambda: engine.number > 3)
    camera.unplug()
    wait(lambda: engine.state == "lost" and "not plugged in" in engine.message)
    assert engine.result.detection.ok  # the last picture stays
    attempts, number, began = camera.calls.count("connect"), engine.number, camera.clock.now()
    wait(lambda: camera.calls.count("connect") > attempts + 3)
    assert camera.clock.now() - began > 3.0, "an attempt per second"
    camera.plug()
    wait(lambda: engine.state == "playing" and engine.number > number)
    assert engine.message == ""


def test_a_camera_that_stalls_is_waited_for(played, camera):
    engine = played(camera)
    camera.stall()
    wait(lambda: engine.state == "waiting")
    assert "no frame" in engine.message
    camera.plug()
    wait(lambda: engine.state == "playing")


def test_the_last_frames_of_a_camera_can_be_looked_at(played, camera):
    engine = played(camera)
    wait(lambda: engine.number > 12)
    engine.go(2)
    wait(lambda: engine.position == 2 and engine.state == "paused")
    third, number = engine.result.moment.frame.number, engine.number
    assert third < number
    engine.play()
    wait(lambda: engine.state == "playing" and engine.result.moment.frame.number > third + 10)


def test_a_camera_is_released_without_a_page_and_opened_again(played, camera):
    engine = played(camera, patience=0.2)
    engine.open_page()
    engine.close_page()
    number = engine.number
    wait(lambda: engine.number > number + 30)  # a second
    assert "disconnect" not in camera.calls  # one page is still open
    engine.close_page()
    wait(lambda: engine.state == "released")
    assert camera.calls[-1] == "disconnect"
    number = engine.number
    engine.open_page()
    wait(lambda: engine.state == "playing" and engine.number > number)


def test_stopping_releases_the_camera_and_ends_the_thread(played, camera):
    engine = played(camera)
    engine.stop()
    assert camera.calls[-1] == "disconnect"
    assert "tuner" not in [thread.name for thread in threading.enumerate()]
