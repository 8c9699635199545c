"""Components of a mask, their outlines and their shares, against OpenCV, SciPy and brute force."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shape_obs.image.connected_runs import find_components, gather_cells
from shape_obs.image.find_region import find_region
from shape_obs.image.outline_tracing import SPECK, Traced, trace_components, trace_hole
from shape_obs.image.roi import Window
from shape_obs.image.sharing import Reach, part_of, share

SEEDS = st.integers(0, 2**32 - 1)


def runs_of(mask):
    """Return ``(R, 3)`` row, first column, column past the last one, of an image that begins at (-3, 7)."""
    found = []
    for row, line in enumerate(mask):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], line > 0, [0]]).astype(int)))
        found += [(row + 7, start - 3, stop - 3) for start, stop in edges.reshape(-1, 2)]
    return np.array(found, np.int64).reshape(-1, 3)


def drawn(seed, share, grain):
    rng = np.random.default_rng(seed)
    size = rng.integers(1, 70, 2)
    coarse = rng.uniform(size=-(-size // grain)) < share
    mask = np.kron(coarse, np.ones((grain, grain), np.uint8))[: size[0], : size[1]]
    return np.ascontiguousarray(mask * rng.integers(1, 256), dtype=np.uint8)


@given(SEEDS, st.floats(0, 1), st.integers(1, 5), st.sampled_from([(1, 0.0), (4, 0.1), (30, 0.5)]))
def test_components_are_those_of_opencv(seed, share, grain, floors):
    mask = drawn(seed, share, grain)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    areas = stats[1:count, cv2.CC_STAT_AREA]
    kept = areas >= max(floors[0], floors[1] * max(areas, default=0))
    plausible, runs, found, box, _ = find_components(mask, -3, 7, 1, *floors)
    left = mask * np.isin(labels, 1 + np.flatnonzero(kept))
    np.testing.assert_array_equal(runs, runs_of(left))
    np.testing.assert_array_equal(plausible, left)
    np.testing.assert_array_equal(np.sort(found), np.sort(areas[kept]))
    if kept.any():
        (v, u), (bottom, right) = (f(np.argwhere(left), axis=0).tolist() for f in (np.min, np.max))
        width, height = right - u + 1, bottom - v + 1
        assert box == (u - 3, v + 7, width, height)


@given(SEEDS, st.floats(0, 1), st.integers(1, 9))
def test_cells_hold_their_pixels_count_and_centroid(seed, share, edge):
    mask = drawn(seed, share, 1)
    row, column = np.nonzero(mask)
    pixels = np.stack([column, row + 7], axis=1)
    cells, inverse = np.unique(pixels[:, ::-1] // edge, axis=0, return_inverse=True)
    count = np.bincount(inverse.ravel(), minlength=len(cells))
    centroid = np.stack([np.bincount(inverse.ravel(), x, len(cells)) for x in pixels.T], axis=1)
    points, weight = gather_cells(runs_of(mask) + (0, 3, 3), edge)  # no image has columns below 0
    np.testing.assert_array_equal(weight, count)
    np.testing.assert_allclose(points, centroid / count[:, None])


LEFT, TOP = 5, -3  # of a traced mask in the image


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
        for outline in pieces:
            np.testing.assert_array_equal(outline, outlines[tuple(outline[0].astype(int).tolist())])


def test_a_component_is_as_wide_as_the_ribbon_of_its_area_and_outline():
    for mask in masks(100):
        _, areas, found = traced(mask)
        outlines, holes, owners = contours(mask)
        pieces = np.split(found.outlines, found.stops[:-1]) if len(areas) else []
        for outline, area, width in zip(pieces, areas, found.widths, strict=True):
            first = tuple(outline[0].astype(int).tolist())
            inner = [hole for start, hole in holes.items() if owners[start] == first and len(hole) >= SPECK]
            around = sum(cv2.arcLength(each.astype(np.float32), closed=True) for each in (outlines[first], *inner))
            half = around / 2 + 2
            assert width == pytest.approx(max((half - max(half**2 - 4 * area, 0) ** 0.5) / 2, 1), rel=1e-4)


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


def test_a_part_is_a_region_of_its_own():
    mask = np.zeros((60, 80), np.uint8)
    cv2.line(mask, (10, 10), (70, 10), 255, 5)
    cv2.line(mask, (10, 40), (70, 50), 255, 5)
    region = find_region(mask, Window(100, 50, 80, 60), 10, 0.0)
    curves = [np.linspace((110, v), (170, w), 60) for v, w in ((60, 60), (90, 100))]
    owners = share(region, curves, [5.0, 5.0], Reach(1.0, 0.5))[0]
    parts = [part_of(region, owners, [k], 10, 0.0) for k in (0, 1)]
    assert parts[0].area + parts[1].area == region.area
    assert parts[0].box.top < 65 < 85 < parts[1].box.top
    both = part_of(region, owners, [0, 1], 10, 0.0)
    assert (both.area, both.box) == (region.area, region.box)
    assert part_of(region, owners, [5], 10, 0.0).refusal == "the mask is empty"
