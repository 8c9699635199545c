"""A tracked shape is searched in its window first, and in the whole image if it is not there."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from shape_obs import Centerline, Contour, HSVRange, ShapeDetector, Surface
from shape_obs import detector as detector_module
from shape_obs.bench.photos import photographed
from shape_obs.bench.scenes import moving_rope, moving_sheet
from shape_obs.tracking import search_window

BLUE = HSVRange(low=(100, 80, 25), high=(130, 255, 255), open=3, close=3)
FRAMES = 25


@pytest.fixture
def everywhere(monkeypatch):
    """Return a function that makes the detector search every frame as a whole."""
    return lambda: monkeypatch.setattr(detector_module, "_SEARCH_ALL", 1)


def shifted(mask: np.ndarray, u: int, v: int) -> np.ndarray:
    moved = cv2.warpAffine(mask, np.array([[1.0, 0, u], [0, 1.0, v]]), (mask.shape[1], mask.shape[0]))
    return np.asarray(moved, dtype=np.uint8)


def rope(start: tuple[int, int] = (80, 100), length: int = 220) -> np.ndarray:
    mask = np.zeros((480, 640), np.uint8)
    cv2.line(mask, start, (start[0] + length, start[1] + 40), (255.0,), 12)
    return mask


@pytest.mark.parametrize("speed", [4, 30])
def test_ropes_are_found_as_in_the_whole_image(everywhere, speed):
    masks = [frame.mask for frame in moving_rope(np.random.default_rng(1), speed, FRAMES)]
    detector = ShapeDetector()
    found = [detector.detect_mask(mask) for mask in masks]
    everywhere()
    detector.reset()
    for mask, detection in zip(masks, found, strict=True):
        again = detector.detect_mask(mask)
        assert again.ok
        assert detection.ok
        np.testing.assert_allclose(detection.shapes[0].points2d, again.shapes[0].points2d, atol=1e-3)


def test_images_give_the_same_points_as_their_whole(everywhere):
    rng = np.random.default_rng(2)
    frames = [photographed(rng, sheet.mask, 1.5, 4.0) for sheet in moving_sheet(rng, 8, 12)]
    detector = ShapeDetector([Contour(), Surface()], BLUE)
    found = [detector.detect(frame) for frame in frames]
    everywhere()
    detector.reset()
    for frame, detection in zip(frames, found, strict=True):
        for shape, again in zip(detection, detector.detect(frame), strict=True):
            assert shape.ok
            np.testing.assert_allclose(shape.points2d, again.points2d, atol=0.3)


def test_a_rope_that_jumps_is_found_in_the_same_frame():
    detector, mask = ShapeDetector(max_speed=None), rope()
    before = [detector.detect_mask(mask).shapes[0].points2d for _ in range(3)][-1]
    after = detector.detect_mask(shifted(mask, 210, 190)).shapes[0]
    assert after.ok
    np.testing.assert_allclose(after.points2d, before + (210, 190), atol=0.5)


def test_a_rope_that_jumps_away_from_a_speck_is_found_in_the_same_frame():
    """The window is not empty: a speck of the rope's colour is left there."""
    detector, mask = ShapeDetector(max_speed=None), rope()
    before = [detector.detect_mask(mask).shapes[0].points2d for _ in range(3)][-1]
    moved = shifted(mask, 210, 190)
    u, v = before[10].round().astype(int).tolist()
    cv2.circle(moved, (u, v), 6, (255.0,), -1)
    after = detector.detect_mask(moved).shapes[0]
    assert after.reason == ""
    np.testing.assert_allclose(after.points2d, before + (210, 190), atol=0.5)


def test_what_turns_up_elsewhere_does_not_disturb():
    detector, mask = ShapeDetector(), rope()
    before = [detector.detect_mask(mask).shapes[0].points2d for _ in range(3)][-1]
    other = mask.copy()
    cv2.circle(other, (500, 400), 20, (255.0,), -1)  # half as large as the rope
    after = detector.detect_mask(other).shapes[0]
    assert after.ok
    assert after.visible.all()
    np.testing.assert_allclose(after.points2d, before, atol=0.1)


@pytest.fixture
def looked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """Return the list of all searches for a region, which grows with each one."""
    looks: list[tuple[Any, ...]] = []
    original = search_window.find_region

    def look(*given: Any) -> Any:
        looks.append(given)
        return original(*given)

    monkeypatch.setattr(search_window, "find_region", look)
    return looks


def test_what_was_hidden_at_first_is_seen_before_long():
    """The hidden half of a rope is not tracked, and lies outside the search window."""
    whole = np.zeros((480, 640), np.uint8)
    cv2.line(whole, (40, 240), (600, 240), (255.0,), 12)
    half = whole.copy()
    half[:, 300:] = 0
    back = whole.copy()
    back[:, 300:340] = 0
    detector = ShapeDetector(Centerline(ends="tips"))
    for _ in range(3):
        assert detector.detect_mask(half).shapes[0].points2d[-1, 0] < 302
    ends = [detector.detect_mask(back).shapes[0].points2d[-1, 0] for _ in range(30)]
    assert max(ends) > 590
    assert detector.detect_mask(back).shapes[0].points2d[-1, 0] > 590


def test_an_image_edge_is_no_reason_to_look_again(looked):
    """A rope at the image's edge stays tracked in its window, since nothing lies beyond the edge."""
    mask = np.zeros((480, 640), np.uint8)
    mask[200:212, :200] = 255
    detector = ShapeDetector()
    for _ in range(4):
        assert detector.detect_mask(mask).ok
    assert len(looked) == 4


def test_a_rope_that_begins_to_move_is_found_in_its_window(looked):
    """It rests for three frames and moves by 5 px in the next: no frame is searched twice."""
    detector, mask = ShapeDetector(), rope()
    for moved in (mask, mask, mask, shifted(mask, 5, 0)):
        assert detector.detect_mask(moved).ok
    assert len(looked) == 4


def test_an_empty_frame_and_back():
    detector, mask = ShapeDetector(), rope()
    before = detector.detect_mask(mask).shapes[0].points2d
    assert detector.detect_mask(np.zeros_like(mask)).shapes[0].reason
    np.testing.assert_allclose(detector.detect_mask(mask).shapes[0].points2d, before, atol=0.6)
