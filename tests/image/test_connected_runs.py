"""Connected runs and their statistics against OpenCV's components and brute force."""

from __future__ import annotations

import cv2
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from shape_obs.image.connected_runs import find_components, gather_cells

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
