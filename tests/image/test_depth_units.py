"""Depth and clouds in a wrong unit are a warning that names the likely unit, once for each detector."""

from __future__ import annotations

import inspect
import warnings

import numpy as np
import pytest

from shape_obs import Centerline, HSVRange, ShapeDetector

BLUE = HSVRange((100, 100, 60), (125, 255, 255))


@pytest.fixture(autouse=True)
def _called_by_the_test(monkeypatch):
    """Take away the contract's watch, which would be the caller that a warning names."""
    for name in ("detect", "detect_mask", "detect_cloud"):
        monkeypatch.setattr(ShapeDetector, name, inspect.unwrap(getattr(ShapeDetector, name)))


def rope_cloud(unit: float) -> np.ndarray:
    t = np.linspace(0, 1, 3000)
    points = np.stack([0.8 * t, 0.1 * np.sin(5 * t), np.full(3000, 0.7)], axis=1)
    return unit * (points + np.random.default_rng(0).normal(0, 2e-3, points.shape))


def warned(run) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        run()
    assert all(warning.filename == __file__ for warning in caught)
    return [str(warning.message) for warning in caught]


@pytest.mark.parametrize(
    ("depth", "message"),
    [
        (
            np.float32(632),
            "depth: the object is 632 m away: floating depth is read as metres, but these look like millimetres; give "
            "depth / 1000, or the camera's uint16 image as it is. This warning is shown once.",
        ),
        (np.float32(35), "but these look like centimetres; give depth / 100."),
        (np.float32(6e-4), "but these look like metres divided by 1000, as of millimetres that were converted twice"),
        (np.uint16(24300), "is 24.3 m away: uint16 depth is read as millimetres, but these look like tenths of a m"),
        (np.uint16(30), "is 0.03 m away: uint16 depth is read as millimetres, but these look like centimetres; give"),
        (np.uint16(2), "but these look like metres; give depth.astype(np.float32)"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("given", ["mask", "slots"])
def test_an_object_too_near_or_too_far_is_a_warning_once(blue, wave, intrinsics, depth, message, given):
    shapes = {"slots": [Centerline(count=2)]}.get(given, [Centerline()])
    detector = ShapeDetector(shapes, BLUE)
    image = np.full(blue.shape[:2], depth)

    def run():
        for _ in range(3):
            if given == "mask":
                detector.detect_mask(wave.mask, image, intrinsics)
            else:
                detector.detect(blue, image, intrinsics)
        detector.reset()
        detector.detect(blue, image, intrinsics)

    found = warned(run)
    assert len(found) == 1
    assert message in found[0]


@pytest.mark.parametrize("depth", [np.uint16(51), np.uint16(700), np.uint16(19900), np.float32(0.06), np.float32(19)])
def test_a_plausible_distance_is_no_warning(blue, intrinsics, depth):
    detector = ShapeDetector(segmentation=BLUE)
    assert warned(lambda: detector.detect(blue, np.full(blue.shape[:2], depth), intrinsics)) == []


def test_only_the_depth_under_the_mask_counts(blue, wave, intrinsics):
    """A far wall behind the object, holes and garbage are no reason."""
    depth = np.where(wave.mask > 0, 0.7, 90.0).astype(np.float32)
    depth[:, ::3] = np.nan
    assert warned(lambda: ShapeDetector(segmentation=BLUE).detect(blue, depth, intrinsics)) == []


def test_depth_that_comes_later_is_looked_at(blue, intrinsics):
    detector, none = ShapeDetector(segmentation=BLUE), np.zeros(blue.shape[:2], np.float32)

    def run():
        detector.detect(blue)
        detector.detect(blue, none, intrinsics)
        detector.detect(blue, np.full(blue.shape[:2], 500, np.float32), intrinsics)

    assert len(warned(run)) == 1


@pytest.mark.parametrize(
    ("unit", "message"),
    [
        (1e3, "m large. Are the points in millimetres? Give points / 1000. This warning is shown once."),
        (1e-3, "mm large. Were metres divided by 1000, as millimetres that are converted twice? Give points * 1000."),
    ],
)
def test_a_cloud_a_thousand_times_too_large_or_small_is_a_warning_once(unit, message):
    detector = ShapeDetector()
    found = warned(lambda: [detector.detect_cloud(rope_cloud(unit)) for _ in range(3)])
    assert len(found) == 1
    assert found[0].startswith("cloud: the object is ")
    assert message in found[0]
    assert warned(lambda: ShapeDetector().detect_cloud(rope_cloud(1.0))) == []


def test_frames_without_any_depth_under_the_mask_are_looked_at_for_a_second_only(blue, intrinsics):
    detector, none = ShapeDetector(segmentation=BLUE), np.zeros(blue.shape[:2], np.uint16)
    for _ in range(30):
        assert detector._units.pending
        detector.detect(blue, none, intrinsics)
    assert not detector._units.pending
