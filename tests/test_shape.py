"""What a shape and a detection print."""

from __future__ import annotations

import numpy as np

from shape_obs import Intrinsics, ShapeDetector


def mask() -> np.ndarray:
    drawn = np.zeros((100, 200), np.uint8)
    drawn[45:56, 20:181] = 1
    return drawn


def test_a_shape_is_printed_in_two_lines():
    detection = ShapeDetector(ends="tips").detect_mask(mask())
    first, second = repr(detection.shapes[0]).splitlines()
    assert first.startswith("<Shape 'centerline': ok, quality ")
    assert first.endswith("; 20 points, 20 visible, 20 valid")
    assert second == "  2D, first (20.3, 50.0) px, last (179.7, 50.0) px>"
    assert str(detection.shapes[0]) == repr(detection.shapes[0])


def test_points_in_space_are_printed_in_metres():
    depth = np.full((100, 200), 500, np.uint16)
    depth[45:56, 20:60] = 0  # holes
    rgb = np.zeros((100, 200, 3), np.uint8)
    rgb[mask() > 0] = (0, 0, 255)
    detector = ShapeDetector(segmentation={"kind": "hsv", "low": [100, 100, 100], "high": [140, 255, 255]}, ends="tips")
    shape = detector.detect(rgb, depth, Intrinsics(200, 100, 200.0, 200.0, 100.0, 50.0)).shapes[0]
    first, second = repr(shape).splitlines()
    valid = np.count_nonzero(shape.valid)
    assert 0 < valid < 20
    assert first.endswith(f"; 20 points, 20 visible, {valid} valid")
    assert second.startswith("  3D, first (")
    assert second.endswith(", last (0.199, 0.000, 0.500) m>")


def test_what_was_not_found_says_why():
    detection = ShapeDetector(on_missing="nan").detect_mask(np.zeros((100, 200), np.uint8))
    assert repr(detection).splitlines() == [
        "<Detection: 1 shapes, not ok>",
        "<Shape 'centerline': not ok, quality 0.00, the mask is empty; 20 points, 0 visible, 0 valid",
        "  2D, first (nan, nan) px, last (nan, nan) px>",
    ]
