"""The thread that plays a source: recordings, cameras that disappear, pages that close."""

from __future__ import annotations

import threading
import time
from typing import Any

import cv2
import numpy as np
import pytest

from shape_obs import Frame
from shape_obs.recording import record
from shape_obs.source import BadRecording, CameraLost, CameraNotFound, FrameTimeout
from shape_obs.tuner.engine import Engine
from shape_obs.tuner.session import Session
from shape_obs_envs.sources import FolderSource, PhotoSource, VideoSource

BLUE = {"segmentation": {"kind": "hsv", "low": [100, 120, 40], "high": [130, 255, 255]}}


class Camera:
    """A camera whose frames and failures are given: a Frame, or an error to raise."""

    kind, name, live, has_depth, intrinsics, camera = "camera", "scripted", True, False, None, None

    def __init__(self, frames, failing=()):
        self.frames, self.failing = list(frames), failing  # which attempts to open it fail, from 0
        self.calls: list[str] = []

    def connect(self):
        self.calls.append("connect")
        if self.calls.count("connect") - 1 in self.failing:
            raise CameraNotFound("scripted: no such camera")

    def disconnect(self):
        self.calls.append("disconnect")

    def read(self, timeout=1.0, fresh=False):
        time.sleep(0.01)
        item = self.frames.pop(0) if len(self.frames) > 1 else self.frames[0]
        if isinstance(item, Exception):
            raise item
        return item


@pytest.fixture
def played():
    """Return a function that starts an engine; all are stopped at the end."""
    engines = []

    def play(source, arguments=BLUE, **options):
        engine = Engine(source, Session(arguments), **options)
        engines.append(engine)
        engine.start()
        engine.open_page()
        return engine

    yield play
    for engine in engines:
        engine.stop()


@pytest.fixture
def photos(tmp_path, blue):
    """Return a folder of twelve photos of a rope that moves down."""
    for i in range(12):
        cv2.imwrite(str(tmp_path / f"{i}.png"), cv2.cvtColor(np.roll(blue, 2 * i, axis=0), cv2.COLOR_RGB2BGR))
    return tmp_path


def wait(condition, seconds=20.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.01)


def first_point(engine) -> float:
    """Return the row of point 0."""
    return float(engine.result.detection.shapes[0].points2d[0, 1])


def test_a_recording_plays_to_its_end_and_again(played, photos):
    engine = played(FolderSource(photos))
    wait(lambda: engine.state == "ended")
    assert engine.position == 11
    assert engine.number == 12
    assert engine.result.detection.ok
    engine.play()
    wait(lambda: engine.number == 24)
    wait(lambda: engine.state == "ended")


def test_without_a_rule_a_recording_waits_for_the_first_click(played, photos):
    engine = played(FolderSource(photos), None)
    time.sleep(0.3)
    assert (engine.number, engine.state) == (1, "paused")
    assert engine.result.detection is None


def test_step_and_scrub(played, photos):
    engine = played(FolderSource(photos))
    wait(lambda: engine.state == "ended")
    engine.go(3)
    wait(lambda: engine.position == 3 and engine.state == "paused")
    third = first_point(engine)
    engine.step(1)
    wait(lambda: engine.position == 4)
    assert first_point(engine) == pytest.approx(third + 2, abs=0.3)
    engine.step(-2)
    wait(lambda: engine.position == 2)
    assert first_point(engine) == pytest.approx(third - 2, abs=0.3)


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


def test_a_video_goes_to_the_frame_that_is_asked_for(played, blue, tmp_path):
    writer = cv2.VideoWriter(str(tmp_path / "a.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (320, 240))
    for i in range(20):
        writer.write(cv2.cvtColor(np.roll(blue, 2 * i, axis=0), cv2.COLOR_RGB2BGR))
    writer.release()
    engine = played(VideoSource(tmp_path / "a.avi"))
    engine.go(0)
    wait(lambda: engine.position == 0 and engine.state == "paused")
    top = first_point(engine)
    engine.go(10)
    wait(lambda: engine.position == 10)
    assert first_point(engine) == pytest.approx(top + 20, abs=0.5)
    assert engine.result.moment.frame.stamp == pytest.approx(0.5, abs=0.01)


def test_a_photo_is_one_frame(played, photos):
    engine = played(PhotoSource(photos / "3.png"))
    wait(lambda: engine.position == 0)
    assert engine.result.detection.ok
    with pytest.raises(BadRecording, match="no such file"):
        Engine(PhotoSource(photos / "none.png"), Session()).start()


def test_a_damaged_frame_is_passed_over(played, photos):
    (photos / "5.png").write_bytes(b"not a picture")
    engine = played(FolderSource(photos))
    wait(lambda: engine.state == "ended")
    assert engine.number == 11
    engine.go(5)
    wait(lambda: "5.png" in engine.message)
    engine.go(6)
    wait(lambda: engine.message == "" and engine.position == 6)


def test_a_recorded_folder_with_depth(played, tmp_path, photos):
    with FolderSource(photos) as source:
        record(source, tmp_path / "recording")
    engine = played(FolderSource(tmp_path / "recording"))
    wait(lambda: engine.state == "ended")
    assert engine.number == 12


def test_a_lost_camera_is_used_again_when_it_is_back(played, blue):
    camera = Camera([Frame(blue), CameraLost("scripted: unplugged"), Frame(blue)], failing=[1])
    engine = played(camera)
    wait(lambda: "unplugged" in engine.message)
    assert engine.state == "lost"
    wait(lambda: "no such camera" in engine.message)
    assert engine.result.detection.ok  # the last picture stays
    number = engine.number
    wait(lambda: engine.state == "playing" and engine.number > number)
    assert engine.message == ""


def test_a_camera_that_stalls_is_waited_for(played, blue):
    engine = played(Camera([Frame(blue), *[FrameTimeout("scripted: no frame")] * 20, Frame(blue)]))
    wait(lambda: engine.state == "waiting")
    wait(lambda: engine.state == "playing")


def test_the_last_frames_of_a_camera_can_be_looked_at(played, blue):
    frames = [Frame(np.roll(blue, 2 * i, axis=0)) for i in range(10)]
    engine = played(Camera(frames))
    wait(lambda: engine.number > 12)
    engine.go(2)
    wait(lambda: engine.position == 2 and engine.state == "paused")
    assert engine.result.moment.frame is frames[2]
    engine.play()
    wait(lambda: engine.state == "playing" and engine.position > 12)


def test_a_camera_is_released_without_a_page_and_opened_again(played, blue):
    camera = Camera([Frame(blue)])
    engine = played(camera, patience=0.2)
    engine.open_page()
    engine.close_page()
    time.sleep(0.5)
    assert "disconnect" not in camera.calls  # one page is still open
    engine.close_page()
    wait(lambda: engine.state == "released")
    assert camera.calls[-1] == "disconnect"
    number = engine.number
    time.sleep(0.2)
    assert engine.number == number
    engine.open_page()
    wait(lambda: engine.state == "playing" and engine.number > number)


def test_stopping_releases_the_camera_and_ends_the_thread(played, blue):
    camera = Camera([Frame(blue)])
    engine = played(camera)
    engine.stop()
    assert camera.calls[-1] == "disconnect"
    assert "tuner" not in [thread.name for thread in threading.enumerate()]


def test_a_camera_that_cannot_be_opened_is_an_error(blue):
    camera: Any = Camera([Frame(blue)], failing=[0])
    with pytest.raises(CameraNotFound, match="no such camera"):
        Engine(camera, Session()).start()


def test_an_area_outside_of_the_image_is_shown_as_an_error(played, photos):
    roi = {"kind": "rectangle", "left": 5000, "top": 0, "width": 10, "height": 10}
    engine = played(FolderSource(photos), {**BLUE, "roi": roi})
    wait(lambda: engine.state == "ended")
    assert "outside" in engine.result.error
