"""What a shape and a detection print."""

from __future__ import annotations

import numpy as np

from shape_obs import ShapeDetector


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


def test_what_was_not_found_says_why():
    detection = ShapeDetector(on_missing="nan").detect_mask(np.zeros((100, 200), np.uint8))
    assert repr(detection).splitlines() == [
        "<Detection: 1 shapes, not ok>",
        "<Shape 'centerline': not ok, quality 0.00, the mask is empty; 20 points, 0 visible, 0 valid",
        "  2D, first (nan, nan) px, last (nan, nan) px>",
    ]
