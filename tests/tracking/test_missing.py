"""The policies for a lost shape (hold, truncate, raise, nan), with and without stamps."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

from shape_obs import Centerline, ShapeDetector, ShapeLostError


@pytest.fixture
def empty(wave):
    return np.zeros_like(wave.mask)


def test_hold_repeats_the_points_for_max_age_seconds(wave, empty):
    detector = ShapeDetector(max_age=0.5)
    seen = detector.detect_mask(wave.mask, stamp=10.0).shapes[0]
    assert (seen.ok, seen.age, seen.reason) == (True, 0.0, "")
    for stamp, ok in ((10.1, True), (10.5, True), (10.51, False), (15.0, False)):
        shape = detector.detect_mask(empty, stamp=stamp).shapes[0]
        assert shape.ok is ok
        assert shape.age == pytest.approx(stamp - 10.0)
        assert shape.reason == "the mask is empty"
        assert shape.quality == 0
        assert not shape.visible.any()
        assert not shape.valid.any()
        np.testing.assert_array_equal(shape.points2d, seen.points2d)


def test_frames_without_stamps_are_dt_apart(wave, empty):
    detector = ShapeDetector(max_age=0.25, dt=0.1)
    detections = [detector.detect_mask(mask) for mask in (wave.mask, wave.mask, empty, empty, empty)]
    assert [d.stamp for d in detections] == pytest.approx([0, 0.1, 0.2, 0.3, 0.4])
    assert [d.ok for d in detections] == [True, True, True, True, False]
    assert detector.detect_mask(empty, stamp=7.0).stamp == 7.0
    assert detector.detect_mask(empty).stamp == pytest.approx(7.1)


@pytest.mark.parametrize(
    ("stamps", "what"),
    [
        (10 * [1.0], "stands still"), (np.arange(10) * 1e-9 + 1, "stands still"), (-np.arange(10.0), "runs back"),
        (10 * [1.7e18], "stands still"), (1e300 * (1 - np.arange(10)), "runs back"),
        (1e5 * np.arange(10), "jumps"), (1e306 * np.arange(10), "jumps"),
    ],
)  # fmt: skip
def test_a_clock_that_fails_keeps_no_lost_shape_alive(wave, empty, stamps, what):
    """Time goes on by ``dt``, and both the detection and the lost shape say why."""
    detector = ShapeDetector(max_age=0.25, dt=0.1)
    assert detector.detect_mask(wave.mask, stamp=stamps[0]).warning == ""
    for i, stamp in enumerate(stamps[1:], 1):
        detection = detector.detect_mask(empty, stamp=stamp)
        shape = detection.shapes[0]
        assert detection.stamp == stamp
        assert shape.age == pytest.approx(0.1 * i)
        assert shape.ok is (i <= 2)
        assert detection.warning == f"the stamp {what}: dt is taken as the time since the last frame"
        assert shape.reason == f"the mask is empty; {detection.warning}"
        assert detection.to_dict()["warning"] == detection.warning


def test_a_clock_that_works_again_is_believed_again(wave, empty):
    """It may have been set to the time of day meanwhile."""
    detector = ShapeDetector(max_age=0.5, dt=0.1)
    detector.detect_mask(wave.mask, stamp=1.0)
    stamps = (1.0, 1.05, 0.2, 0.21, 7.21, 1.7e9, 1.7e9 + 1, 1.7e9 + 1, 1.7e9 + 1, 1.7e9 + 2)
    ages = [detector.detect_mask(empty, stamp=stamp).shapes[0].age for stamp in stamps]
    assert ages == pytest.approx([0.1, 0.15, 0.25, 0.26, 7.26, 7.36, 8.36, 8.46, 8.56, 9.56])


@pytest.mark.parametrize(
    ("stamps", "unit"),
    [
        (np.arange(8) / 30, None), (1.7e9 + np.arange(8) / 30, None), (np.arange(8.0), None),
        (np.arange(8) / 1000, None),
        ([0, 0.03, 0.07, 2000.0, 2000.03, 2000.07, 2000.1, 2000.13], None), (2.0 * np.arange(8), None),
        (np.arange(8) * 1e3 / 30, "milliseconds, 30 frames"), (1.7e12 + np.arange(8) * 4.0, "milliseconds"),
        (np.arange(8) * 1e6 / 30, "microseconds"), (1700000000000000000 + np.arange(8) * 33333333, "nanoseconds"),
        (np.arange(8), "frame numbers"), (2 * np.arange(8), "frame numbers"), (np.arange(8) / 3e4, "divided by 1000"),
        ((1.7e9 + np.arange(8)).astype(np.float32), "resolves 128 s"), (np.arange(70) // 30, "parts of seconds"),
        *((1.7e9 + step * np.arange(8), None) for step in (10, 60, 300, 3600, 86400, 3600.02)),
        (1_700_000_000 + np.arange(8), None), (10 * np.arange(8), "if they are seconds, leave them"),
        (3600.0 * np.arange(8), "if they are seconds, leave them"), (333333 * np.arange(8), "ticks of 100 ns, 30 f"),
        (133_500_000_000_000_000 + 333333 * np.arange(8), "ticks of 100 ns, 30 f"),
    ],
)  # fmt: skip
def test_stamps_in_another_unit_warn_once_and_one_hertz_does_not(wave, stamps, unit):
    detector = ShapeDetector()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for _ in range(2):
            detector.reset()
            for stamp in stamps:
                assert detector.detect_mask(wave.mask, stamp=stamp).shapes[0].track_id == 1
    assert [unit in str(each.message) for each in caught] == [True] * (unit is not None)


@pytest.mark.parametrize(("step", "max_age", "count"), [(1.0, 0.5, 1), (1.0, 1.5, 0), (0.6, 0.5, 0)])
def test_a_track_that_ends_with_one_frame_of_slow_stamps_warns_once(wave, empty, step, max_age, count):
    detector = ShapeDetector(max_age=max_age)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for i in range(12):
            detector.detect_mask(empty if i in (7, 9) else wave.mask, stamp=step * i)
    assert ["max_age" in str(each.message) for each in caught] == count * [True]


@pytest.mark.parametrize("policy", ["truncate", "nan"])
def test_the_others_are_never_ok(wave, empty, policy):
    detector = ShapeDetector(on_missing=policy)
    seen = detector.detect_mask(wave.mask).shapes[0]
    shape = detector.detect_mask(empty).shapes[0]
    assert not shape.ok
    assert shape.age > 0
    expected = seen.points2d if policy == "truncate" else np.full_like(seen.points2d, np.nan)
    np.testing.assert_array_equal(shape.points2d, expected)


def test_raise_says_which_and_why_and_goes_on_afterwards(wave, empty):
    detector = ShapeDetector(Centerline(name="rope"), on_missing="raise")
    detector.detect_mask(wave.mask)
    with pytest.raises(ShapeLostError, match=r"^shape 'rope' was not found: the mask is empty$"):
        detector.detect_mask(empty)
    assert detector.detect_mask(wave.mask).ok


@pytest.mark.parametrize(("wait", "first"), [(0.2, 270), (2.0, 270), (600.0, 50)])
def test_the_index_starts_again_after_a_loss_that_is_too_long_to_remember_it(wave, empty, wait, first):
    """The hand has moved to the left end: only a new start uses it as the anchor."""
    detector = ShapeDetector(Centerline(ends="tips", anchor="hand"), max_age=0.5)
    right, left = {"hand": (319, 110)}, {"hand": (0, 140)}
    for stamp, anchors in ((0.0, right), (0.1, left)):
        seen = detector.detect_mask(wave.mask, stamp=stamp, anchors=anchors).shapes[0]
        assert seen.points2d[0, 0] == pytest.approx(270, abs=2)
    for stamp in (0.15, wait, wait + 0.01):
        detector.detect_mask(empty, stamp=stamp, anchors=left)
    found = detector.detect_mask(wave.mask, stamp=wait + 0.02, anchors=left).shapes[0]
    assert (found.ok, found.age) == (True, 0.0)
    assert found.points2d[0, 0] == pytest.approx(first, abs=2)


def test_depth_that_comes_later_finds_room_for_points_in_space(wave, empty, intrinsics):
    """A shape that is held from a frame without depth also has points3d, which are unknown."""
    depth = np.full(wave.mask.shape, 0.8)
    detector = ShapeDetector()
    detector.detect_mask(wave.mask)
    held: Any = detector.detect_mask(empty, depth, intrinsics).shapes[0]
    assert held.points3d.shape == (20, 3)
    assert np.isnan(held.points3d).all()
    assert np.isfinite(held.points2d).all()


def test_held_points_in_space_are_held_too(wave, empty, intrinsics):
    depth = np.full(wave.mask.shape, 0.8)
    detector = ShapeDetector()
    seen = detector.detect_mask(wave.mask, depth, intrinsics).shapes[0]
    for frame in ((empty, depth), (wave.mask, np.zeros_like(depth))):
        held = detector.detect_mask(*frame, intrinsics).shapes[0]
        assert held.reason
        np.testing.assert_array_equal(held.points3d, seen.points3d)
