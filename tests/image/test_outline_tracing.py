"""Outlines of components and of their holes are traced as OpenCV traces them."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from shape_obs.image.connected_runs import find_components
from shape_obs.image.outline_tracing import SPECK, Traced, fill_holes, trace_components, trace_hole

LEFT, TOP = 5, -3


def masks(count: int) -> Iterator[npt.NDArray[np.uint8]]:
    rng = np.random.default_rng(0)
    for _ in range(count):
        height, width = rng.integers(1, 60, 2)
        noise = cv2.GaussianBlur(rng.normal(size=(height, width)).astype(np.float32), (0, 0), rng.uniform(0.2, 3))
        yield np.ascontiguousarray((noise > rng.uniform(-0.1, 0.1)).astype(np.uint8))
    rings = np.zeros((80, 100), np.uint8)
    for radius in range(4, 36, 5):
        cv2.circle(rings, (50, 40), radius, (1,), 2)
    yield rings


def traced(mask):
    mask, runs, areas, *_ = find_components(mask, LEFT, TOP, 1, 1, 0.0)
    return runs, areas, Traced(*trace_components(mask, runs, len(areas), LEFT, TOP))


def contours(mask):
    """Return OpenCV's outlines and holes by their first pixel, and the first pixel of each hole's component."""
    found, tree = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    if not found:
        return {}, {}, {}
    parents = tree.reshape(-1, 4)[:, 3].tolist()
    points = [contour.reshape(-1, 2) + (LEFT, TOP) for contour in found]
    first = [tuple(place[0].tolist()) for place in points]
    holes = {first[i]: points[i] for i, parent in enumerate(parents) if parent >= 0}
    owners = {first[i]: first[parent] for i, parent in enumerate(parents) if parent >= 0}
    return {first[i]: points[i] for i, parent in enumerate(parents) if parent < 0}, holes, owners


def test_outlines_are_those_of_opencv():
    for mask in masks(100):
        _, areas, found = traced(mask)
        outlines, _, _ = contours(mask)
        assert len(found.stops) == len(areas) == len(outlines)
        np.testing.assert_array_equal(found.areas, areas)
        pieces = np.split(found.outlines, found.stops[:-1]) if len(areas) else []
        for outline, length in zip(pieces, found.perimeters, strict=True):
            expected = outlines[tuple(outline[0].astype(int).tolist())]
            np.testing.assert_array_equal(outline, expected)
            assert length == pytest.approx(cv2.arcLength(expected.astype(np.float32), closed=True), rel=1e-5)


def test_holes_are_those_of_opencv():
    seen = 0
    for mask in masks(100):
        _, _, found = traced(mask)
        _, holes, owners = contours(mask)
        assert len(found.holes) == len(holes)
        starts = [0, *found.stops.tolist()]
        for component, column, row, pixels, length, area in found.holes.tolist():
            expected = holes[int(column), int(row)]
            assert pixels == len(expected)
            assert length == pytest.approx(cv2.arcLength(expected.astype(np.float32), closed=True), rel=1e-5)
            assert area == pytest.approx(cv2.contourArea(expected.astype(np.float32)))
            assert owners[int(column), int(row)] == tuple(found.outlines[starts[int(component)]].astype(int).tolist())
            np.testing.assert_array_equal(trace_hole(mask, int(column), int(row), LEFT, TOP), expected)
            seen += 1
    assert seen > 150


def test_small_holes_are_filled_as_opencv_fills_them():
    for mask in masks(100):
        runs, _, found = traced(mask)
        expected, left, filled = mask.copy(), 0, mask.copy()
        for hole in contours(mask)[1].values():
            if len(hole) < SPECK:
                cv2.drawContours(expected, [hole - (LEFT, TOP)], -1, (1,), cv2.FILLED)
            else:
                left += 1
        assert fill_holes(filled, runs, found.holes, LEFT, TOP, SPECK, -1.0) == left
        np.testing.assert_array_equal(filled, expected)
