"""Webcams, as far as they can be tested without one: a network camera, opened and read by the same ``VideoCapture``."""

from __future__ import annotations

import json
import subprocess
import sys
import time
import warnings
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from mjpeg_camera import MjpegCamera

from shape_obs import Intrinsics
from shape_obs.calibration import IntrinsicsFit
from shape_obs.source import CameraNotFound, SourceError
from shape_obs_envs.sources import WebcamSource, open_source

SIZE = (120, 160)
FPS = 30.0


def draw(number: int):
    """Return an orange image on which a bar of 4 pixels stands for the number."""
    rgb = np.full((*SIZE, 3), (230, 120, 20), np.uint8)
    rgb[:, 4 * (number % 40) : 4 * (number % 40) + 4] = (20, 60, 200)
    return rgb


def number_in(frame) -> int:
    """Return the number that ``draw`` drew, modulo 40."""
    return int(np.argmax(frame.rgb[60, 2::4, 2].astype(int) - frame.rgb[60, 2::4, 0]))


@pytest.fixture
def camera():
    with MjpegCamera(draw, FPS) as camera:
        yield camera


def test_frames_are_rgb_in_order_and_stamped_by_this_machine(camera):
    before = time.monotonic()
    with open_source(f"webcam:{camera.url}") as source:
        assert isinstance(source, WebcamSource)
        assert (source.kind, source.live, source.has_depth) == ("webcam", True, False)
        assert (source.intrinsics, source.camera) == (None, None)
        frames: list[Any] = [source.read(3.0) for _ in range(12)]
    for frame in frames:
        assert frame.rgb is not None
        assert frame.rgb.shape == (*SIZE, 3)
        assert before <= frame.stamp == frame.received <= time.monotonic()
        assert frame.exposed == pytest.approx(frame.stamp - 2 / FPS, abs=0.05)
        assert np.abs(np.median(frame.rgb, axis=(0, 1)) - (230, 120, 20)).max() < 8
    assert [frame.number for frame in frames] == list(range(12))
    assert [number_in(frame) for frame in frames] == [(number_in(frames[0]) + i) % 40 for i in range(12)]
    stamps = [frame.stamp for frame in frames[4:]]  # after what the server had sent before
    assert np.diff(stamps).mean() == pytest.approx(1 / FPS, rel=0.25)


def test_disconnecting_releases_the_camera(camera):
    source = WebcamSource(camera.url)
    for _ in range(2):
        with source:
            source.connect()
            source.read(3.0)
            assert camera.readers == 1
        for _ in range(60):
            time.sleep(0.05)
            if not camera.readers:
                break
        assert camera.readers == 0
    source.disconnect()


def test_a_program_that_forgets_to_disconnect_ends_cleanly(camera):
    code = f"from shape_obs_envs.sources import WebcamSource\ns = WebcamSource({camera.url!r})\ns.connect()\ns.read(5)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, b"")


def test_frames_are_rectified_with_the_file_of_the_calibration(tmp_path):
    lens = Intrinsics(160, 120, 130.0, 130.0, 79.5, 59.5, "brown_conrady", (-0.3, 0.1, 0.001, 0.0, 0.0))
    IntrinsicsFit(lens, 0.2, 0.001, 20, 0.9).save(tmp_path / "intrinsics.json")
    with MjpegCamera(lambda _: draw(5), FPS) as camera:
        with WebcamSource(camera.url) as source:
            raw = source.read(3.0).rgb
        with open_source(f"webcam:{camera.url}", intrinsics=str(tmp_path / "intrinsics.json")) as source:
            frame, model = source.read(3.0), source.camera
        wrong = Intrinsics(640, 480, 500.0, 500.0, 320.0, 240.0)
        with pytest.raises(SourceError, match="have 160 x 120 pixels, the intrinsics are for 640 x 480"):
            WebcamSource(camera.url, intrinsics=wrong).connect()
    assert raw is not None
    assert frame.rgb is not None
    assert frame.camera == model
    assert model is not None
    assert model.intrinsics == Intrinsics(160, 120, 130.0, 130.0, 79.5, 59.5)
    expected = cv2.undistort(raw, lens.matrix, np.array(lens.coeffs))
    assert np.abs(frame.rgb.astype(int) - expected).mean() < 0.5
    assert np.abs(raw.astype(int) - expected).mean() > 2


@pytest.mark.parametrize(("asked", "words"), [(60, ["has no 60 frames a second"]), (30, [])])
def test_a_rate_that_the_camera_does_not_have_is_said(camera, monkeypatch, asked, words):
    capture = cv2.VideoCapture(camera.url)
    methods = {name: getattr(capture, name) for name in ("read", "grab", "retrieve", "release")}
    monkeypatch.setattr(WebcamSource, "_opened", lambda _: SimpleNamespace(get=lambda _: FPS, **methods))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with WebcamSource(0, fps=asked) as source:
            source.read(3.0)
    assert [words[0] in str(each.message) for each in caught] == [True] * len(words)


@pytest.mark.parametrize(
    ("word", "options", "error", "message"),
    [
        ("webcam:97", {}, CameraNotFound, "webcam:97: it cannot be opened: there is no /dev/video97"),
        (f"webcam:{__file__}", {}, CameraNotFound, "this is a file, not a camera: give .* itself as the source"),
        ("webcam:http://127.0.0.1:9/x", {}, CameraNotFound, "the address does not answer"),
        ("webcam:http://a/b", {"width": 640}, ValueError, "a stream has its own size, rate and format"),
        ("webcam:0", {"height": 0}, ValueError, "height: expected more than 0"),
        ("webcam:0", {"width": "abc"}, ValueError, "width: expected more than 0, a number, got 'abc'"),
        ("webcam:0", {"fourcc": "MJPEG"}, ValueError, "fourcc: expected four characters"),
        ("webcam:0", {"intrinsics": "none.json"}, FileNotFoundError, r"none\.json"),
    ],
)
@pytest.mark.skipif(sys.platform != "linux", reason="devices have other names")
def test_cameras_that_are_not_there_say_what_to_do(word, options, error, message):
    with pytest.raises(error, match=message) as caught:
        open_source(word, **options).connect()
    assert "\n" not in str(caught.value)


def test_a_webcam_is_recorded_and_replayed(run, tmp_path):
    def rope(number):
        rgb = np.full((*SIZE, 3), 200, np.uint8)
        cv2.line(rgb, (30, 40 + number % 20), (130, 60 + number % 20), (20, 60, 200), 5)
        return rgb

    config = tmp_path / "rope.yaml"
    config.write_text(
        "version: 1\nshape: {shapes: [{kind: centerline, n: 10}], features: [points2d_normalized]}\n"
        "scene: {segmentation: {kind: hsv, low: [100, 120, 40], high: [125, 255, 255]}}\n"
    )
    with MjpegCamera(rope, FPS) as camera:
        word = f"webcam:{camera.url}"
        code, out, err = run("record", "--source", word, "--frames", "6", "-o", tmp_path / "a", "--json")
        assert code == 0, err
        assert json.loads(out)["frames"] == 6
        code, _, err = run("record", "--source", word, "--depth", "yes", "-o", tmp_path / "b")
        assert (code, "has no depth to record" in err) == (1, True)
        code, _, err = run("record", "--source", word, "-o", tmp_path / "b.db3")
        assert (code, "only a RealSense camera can be recorded to .db3" in err) == (2, True)
        code, _, err = run("replay", word, "--config", config)
        assert (code, "never ends: give --frames N" in err) == (2, True)
        code, out, err = run("replay", word, "--config", config, "--frames", "5", "--json")
        assert code == 0, err
        assert json.loads(out)["shapes"]["centerline"]["ok"] == 5
