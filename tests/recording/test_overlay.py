"""Videos of the detected shapes."""

from __future__ import annotations

import subprocess
import warnings

import cv2
import numpy as np
import pytest
from PIL import Image as Pillow
from PIL import ImageSequence
from recorded_cable import detector

import shape_obs
from shape_obs import ShapeDetector
from shape_obs.drawing import draw_detection
from shape_obs.recording import Moment, OverlayVideo, replay, video
from shape_obs_envs.sources import FolderSource

NOTHING = ShapeDetector(["centerline"], {"kind": "gray", "low": 1, "high": 2})


def write(path, pictures, fps=None, stamps=None):
    """Write pictures without shapes, whose stamps are a twentieth of a second apart unless given."""
    with OverlayVideo(path, fps) as overlay:
        for i, picture in enumerate(pictures):
            stamp = i / 20 if stamps is None else stamps[i]
            overlay.add(Moment(shape_obs.Frame(picture)), NOTHING.detect(picture, stamp=stamp))


def decoded(path):
    """Return the frames of a video as OpenCV decodes them, in RGB, and its rate."""
    capture = cv2.VideoCapture(str(path))
    frames = []
    while True:
        there, bgr = capture.read()
        if not there:
            return frames, capture.get(cv2.CAP_PROP_FPS)
        frames.append(bgr[..., ::-1])


def codec(path):
    return int(cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little")


def gray(size, count):
    """Return pictures of falling brightness, the upper half red."""
    for i in range(count):
        picture = np.full((*size, 3), 250 - 10 * i, np.uint8)
        picture[: size[0] // 2, :, 1:] = 0
        yield picture


@pytest.mark.parametrize("suffix", [".mp4", ".avi"])
def test_an_overlay_shows_every_frame_with_its_points(recorded, tmp_path, suffix):
    path = tmp_path / f"overlay{suffix}"
    with FolderSource(recorded) as source, OverlayVideo(path) as overlay:
        for moment, detection in replay(source, detector(), frames=20):
            overlay.add(moment, detection)
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]
    pictures, rate = decoded(path)
    assert rate == pytest.approx(20, abs=0.1), "as the stamps say"
    assert len(pictures) == 20
    assert pictures[0].shape == (480, 640, 3)
    green = (pictures[-1][..., 1].astype(int) - pictures[-1][..., ::2].max(axis=2)) > 80
    assert green.sum() > 12 * 20


def test_an_mp4_plays_in_browsers(tmp_path):
    """It is H.264 with 4:2:0 colour, even sizes, and the index in front of the pictures."""
    pytest.importorskip("imageio_ffmpeg")
    write(tmp_path / "v.mp4", gray((481, 643), 20))
    assert codec(tmp_path / "v.mp4") == b"h264"
    pictures, rate = decoded(tmp_path / "v.mp4")
    assert (len(pictures), rate) == (20, pytest.approx(20))
    assert pictures[0].shape == (482, 644, 3)
    for i, picture in enumerate(pictures):
        assert np.abs(picture[300:, 10:-10].astype(int) - (250 - 10 * i)).max() < 8, i
    content = (tmp_path / "v.mp4").read_bytes()
    assert content.index(b"moov") < content.index(b"mdat")
    ffmpeg = video.find_ffmpeg()
    assert ffmpeg is not None
    said = subprocess.run([ffmpeg, "-i", str(tmp_path / "v.mp4")], capture_output=True, text=True).stderr
    assert "yuv420p" in said


def test_without_an_encoder_a_line_says_so_and_opencv_encodes(tmp_path, monkeypatch):
    monkeypatch.setattr(video, "find_ffmpeg", lambda: None)
    with pytest.warns(UserWarning, match=r'MPEG-4 Part 2, which browsers do not play: .*pip install "\.\[video\]"'):
        write(tmp_path / "v.mp4", gray((480, 640), 20))
    assert codec(tmp_path / "v.mp4") == b"FMP4"
    assert len(decoded(tmp_path / "v.mp4")[0]) == 20


@pytest.mark.parametrize(
    ("stamps", "wanted", "word"),
    [
        ([*np.arange(12) / 20, *(0.6 + np.arange(8) / 4)], [*range(12), *np.repeat(np.arange(12, 19), 5), 19], False),
        (np.arange(20) / 20 + np.array([0, 0.02] * 10), range(20), False),
        ([*np.arange(10) / 20, *(np.arange(10) / 20)], range(20), False),
        ([*np.arange(19) / 20, 1000.0], [*range(18), *(40 * [18]), 19], True),
        (1.7e18 + np.arange(20) * 5e7, range(20), False),
        ([*np.arange(16) / 4, *(3.75 + np.arange(1, 5) / 100)], range(20), True),
    ],
)  # fmt: skip
def test_a_video_plays_at_the_speed_of_the_stamps_and_leaves_nothing_out(tmp_path, stamps, wanted, word):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        write(tmp_path / "v.avi", gray((48, 64), 20), stamps=stamps)
    pictures, rate = decoded(tmp_path / "v.avi")
    assert [round((250 - picture[400, 320].mean()) / 10) for picture in pictures] == list(wanted)
    assert rate == pytest.approx(30 if stamps[1] > 1e6 else 1 / np.median(np.diff(stamps[:15])), rel=0.05)
    assert any("but the recording" in str(each.message) for each in caught) is word


def test_the_rate_of_an_mp4_is_not_rounded(tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    write(tmp_path / "v.mp4", gray((48, 64), 3), fps=30 / 1.001)
    assert decoded(tmp_path / "v.mp4")[1] == 30000 / 1001


def test_a_gif_has_the_speed_of_the_frames(tmp_path):
    write(tmp_path / "v.gif", gray((960, 1280), 20))
    with Pillow.open(tmp_path / "v.gif") as gif:
        assert gif.size == (640, 480)
        assert gif.info["loop"] == 0, "for ever"
        shown = [(frame.info["duration"], np.asarray(frame.convert("RGB"))) for frame in ImageSequence.Iterator(gif)]
    assert [duration for duration, _ in shown] == 10 * [100], "every second of twenty per second"
    for i, (_, picture) in enumerate(shown):
        assert np.abs(picture[300:400, 100:200].astype(int) - (250 - 20 * i)).max() < 12, i
        assert np.abs(picture[100:200, 300:400, 0].astype(int) - (250 - 20 * i)).max() < 12, i
        assert picture[100:200, 300:400, 1:].max() < 12


@pytest.mark.parametrize("suffix", [".mp4", ".avi", ".gif"])
def test_an_overlay_that_fails_leaves_no_file(tmp_path, suffix):
    frame, other = np.zeros((60, 80, 3), np.uint8), np.zeros((90, 80, 3), np.uint8)
    with pytest.raises(ValueError, match="has another size than the first"):
        write(tmp_path / f"o{suffix}", (frame, frame, other), 30)
    assert not any(tmp_path.iterdir())


def test_an_encoder_that_dies_is_an_error_and_keeps_the_old_file(tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    (tmp_path / "v.mp4").write_text("old")

    def write_and_kill():
        with OverlayVideo(tmp_path / "v.mp4", 30) as overlay:
            for i, picture in enumerate(gray((480, 640), 24)):
                overlay.add(Moment(shape_obs.Frame(picture)), NOTHING.detect(picture))
                if i == 20:
                    overlay._encoder._process.kill()  # type: ignore[union-attr]

    with pytest.raises(OSError, match="ffmpeg cannot write"):
        write_and_kill()
    assert [path.name for path in tmp_path.iterdir()] == ["v.mp4"]
    assert (tmp_path / "v.mp4").read_text() == "old"


def test_a_picture_says_that_the_stamp_fails_and_that_the_numbering_begins_anew(wave):
    detector, blank = ShapeDetector(max_age=0.1), np.full((*wave.mask.shape, 3), 255, np.uint8)
    seen = {}
    for name, mask, stamp in (
        ("first", wave.mask, 0.0), ("fine", wave.mask, 0.1), ("frozen", wave.mask, 0.1),
        ("lost", np.zeros_like(wave.mask), 9.0), ("anew", wave.mask, 600.0),
    ):  # fmt: skip
        picture = draw_detection(blank, detector.detect_mask(mask, stamp=stamp))
        seen[name] = bool((picture[:30] != 255).any())  # there is nothing but text
    assert seen == {"first": False, "fine": False, "frozen": True, "lost": True, "anew": True}
