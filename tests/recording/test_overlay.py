"""Videos of the detected shapes."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from recorded_cable import detector

import shape_obs
from shape_obs import ShapeDetector
from shape_obs.drawing import draw_detection
from shape_obs.recording import Moment, OverlayVideo, replay
from shape_obs_envs.sources import FolderSource


@pytest.mark.parametrize("suffix", [".mp4", ".avi"])
def test_an_overlay_shows_every_frame_with_its_points(recorded, tmp_path, suffix):
    path = tmp_path / f"overlay{suffix}"
    with FolderSource(recorded) as source, OverlayVideo(path) as video:
        for moment, detection in replay(source, detector(), frames=20):
            video.add(moment, detection)
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]
    capture = cv2.VideoCapture(str(path))
    assert capture.get(cv2.CAP_PROP_FPS) == pytest.approx(20, abs=0.1), "as the stamps say"
    pictures = [capture.read()[1] for _ in range(20)]
    assert not capture.read()[0]
    assert pictures[0].shape == (480, 640, 3)
    green = (pictures[-1][..., 1].astype(int) - pictures[-1][..., ::2].max(axis=2)) > 80
    assert green.sum() > 12 * 20


def test_an_overlay_that_fails_leaves_no_file(tmp_path):
    finder = ShapeDetector(["centerline"], {"kind": "gray", "low": 1, "high": 2})
    frame, other = np.zeros((60, 80, 3), np.uint8), np.zeros((90, 80, 3), np.uint8)
    detection = finder.detect(frame)

    def draw():
        with OverlayVideo(tmp_path / "o.mp4", 30) as video:
            for image in (frame, frame, other):
                video.add(Moment(shape_obs.Frame(image)), detection)

    with pytest.raises(ValueError, match="has another size than the first"):
        draw()
    assert not any(tmp_path.iterdir())
    with pytest.raises(ValueError, match=r"expected a video named \*\.mp4 or \*\.avi"):
        OverlayVideo(tmp_path / "o.gif")


def test_a_picture_says_that_the_stamp_fails_and_that_the_numbering_begins_anew(wave):
    detector, blank = ShapeDetector(max_age=0.1), np.full((*wave.mask.shape, 3), 255, np.uint8)
    seen = {}
    for name, mask, stamp in (
        ("first", wave.mask, 0.0), ("fine", wave.mask, 0.1), ("frozen", wave.mask, 0.1),
        ("lost", np.zeros_like(wave.mask), 9.0), ("anew", wave.mask, 9.1),
    ):  # fmt: skip
        picture = draw_detection(blank, detector.detect_mask(mask, stamp=stamp))
        seen[name] = bool((picture[:30] != 255).any())  # there is nothing but text
    assert seen == {"first": False, "fine": False, "frozen": True, "lost": True, "anew": True}
