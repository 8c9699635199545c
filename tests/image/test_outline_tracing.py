"""Outlines of components are traced as OpenCV traces them."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from shape_obs.image.connected_runs import find_components
from shape_obs.image.outline_tracing import follow_border, trace_with_holes
from shape_obs.image.region import trace_outline

FOLLOW: Any = getattr(follow_border, "py_func", follow_border)  # compiled for compiled callers only


def pieces(count):
    """Yield masks of one component."""
    rng = np.random.default_rng(0)
    for _ in range(count):
        height, width = rng.integers(1, 40, 2)
        noise = cv2.GaussianBlur(rng.normal(size=(height, width)).astype(np.float32), (0, 0), rng.uniform(0.3, 3))
        found, labels, stats, _ = cv2.connectedComponentsWithStats((noise > 0).astype(np.uint8), connectivity=8)
        if found > 1:
            yield np.ascontiguousarray((labels == 1 + np.argmax(stats[1:, 4])).astype(np.uint8))


def test_outlines_are_those_of_opencv():
    with_holes = 0
    for piece in pieces(300):
        _, runs, _, _ = find_components(piece, 5, -3, 1, 1, 0.0)
        outline, length = trace_outline(piece, runs, 5, -3)
        expected, expected_length, _ = trace_with_holes(piece, 5, -3)
        if len(outline):
            np.testing.assert_array_equal(outline, expected)
            np.testing.assert_allclose(length, expected_length, rtol=1e-6)
        contours, tree = cv2.findContours(piece, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        assert (len(outline) == 0) == (len(contours) > 1)
        with_holes += len(contours) > 1
        outer = np.asarray(contours[tree.reshape(-1, 4)[:, 3].tolist().index(-1)]).reshape(-1, 2)
        border, _ = FOLLOW(piece, runs[0, 1] - 5, runs[0, 0] + 3, 5, -3)
        np.testing.assert_array_equal(border, outer + (5, -3))
    assert with_holes > 20
