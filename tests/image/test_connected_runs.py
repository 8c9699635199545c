"""Runs of pixels: the components of OpenCV to the pixel, cells and look-ups by brute force."""

from __future__ import annotations

import cv2
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from shape_obs.compiled import compiled
from shape_obs.image.connected_runs import find_components, gather_cells, label_runs, near_mask


def runs_of(mask):
    """Return row, first column and column past the last one of each run, (R, 3)."""
    found = []
    for row, line in enumerate(mask):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], line > 0, [0]]).astype(int)))
        found += [(row + 7, start - 3, stop - 3) for start, stop in edges.reshape(-1, 2)]
    return np.array(found, np.int64).reshape(-1, 3)


@compiled("(i8[:,::1],)")
def labelled(runs):
    """Call a function that is compiled for compiled callers only."""
    return label_runs(runs)


@st.composite
def masks(draw):
    """Return random blobs of any size, ``(h, w)`` uint8."""
    rng, grain = np.random.default_rng(draw(st.integers(0, 2**32 - 1))), draw(st.integers(1, 5))
    size, share = rng.integers(1, 40, 2), draw(st.floats(0, 1))
    coarse = rng.uniform(size=-(-size // grain)) < share
    return np.ascontiguousarray(np.kron(coarse, np.ones((grain, grain), np.uint8))[: size[0], : size[1]])


MASKS = masks()


@given(st.integers(0, 2**32 - 1), st.floats(0, 1), st.integers(1, 5))
def test_components_are_those_of_opencv_numbered_as_they_appear(seed, share, grain):
    rng = np.random.default_rng(seed)
    size = rng.integers(1, 40, 2)
    mask = np.kron(rng.uniform(size=-(-size // grain)) < share, np.ones((grain, grain), np.uint8))[: size[0], : size[1]]
    runs = runs_of(mask)
    label, count = labelled(runs)
    labels = np.asarray(cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)[1])
    assert count == labels.max()
    row, column = runs[:, 0] - 7, runs[:, 1] + 3
    assert len({*zip(label, labels[row, column], strict=True)}) == count
    first = [int(np.flatnonzero(label == k)[0]) for k in range(count)]
    assert first == sorted(first)


def test_corners_touch_and_a_gap_of_one_pixel_does_not():
    corner, gap = np.eye(5), np.array([[1, 0, 1, 1]])
    assert labelled(runs_of(corner))[1] == 1
    assert labelled(runs_of(gap))[0].tolist() == [0, 1]
    assert labelled(runs_of(np.zeros((3, 3))))[1] == 0
    below = np.array([[1, 1, 0, 0, 0], [0, 0, 0, 1, 1]])  # a column apart
    assert labelled(runs_of(below))[1] == 2


def test_rows_in_a_ring_s_hole_are_a_piece_of_their_own():
    mask = np.zeros((60, 60), np.uint8)
    cv2.circle(mask, (30, 30), 25, (255.0,), 5)
    mask[28:33, 28:33] = 255
    label, count = labelled(runs_of(mask))
    rows, columns = runs_of(mask)[:, 0] - 7, runs_of(mask)[:, 1] + 3
    assert count == 2
    labels = np.asarray(cv2.connectedComponents(mask, connectivity=8)[1])
    np.testing.assert_array_equal(label, labels[rows, columns] - 1)


@given(MASKS, st.integers(1, 30), st.floats(0, 1))
def test_plausible_components_are_those_of_opencv(mask, min_area, min_share):
    before = mask.copy()
    found, runs, areas, box, _ = find_components(mask, -3, 7, 1, min_area, min_share)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    sizes = stats[1:, cv2.CC_STAT_AREA]
    kept = sizes >= max(min_area, min_share * sizes.max(initial=0))
    expected = np.isin(labels, 1 + np.flatnonzero(kept))
    np.testing.assert_array_equal(runs, runs_of(expected))
    np.testing.assert_array_equal(np.sort(areas), np.sort(sizes[kept]))
    np.testing.assert_array_equal(found, np.where(expected, mask, 0))
    np.testing.assert_array_equal(mask, before)
    if kept.any():
        (top, left), (bottom, right) = (f(np.argwhere(expected), axis=0).tolist() for f in (np.min, np.max))
        width, height = right - left + 1, bottom - top + 1
        assert box == (left - 3, top + 7, width, height)


@given(MASKS, st.integers(1, 9))
def test_cells_are_the_means_of_their_pixels(mask, edge):
    points, weight = gather_cells(runs_of(mask) + (0, 8, 8), edge)  # no image has negative columns
    v, u = np.nonzero(mask)
    pixels = np.stack([u + 5, v + 7], axis=1)
    cells, of = np.unique(pixels // edge, axis=0, return_inverse=True)
    held = np.bincount(of.ravel(), minlength=len(cells))
    means = np.stack([np.bincount(of.ravel(), pixels[:, d], len(cells)) for d in range(2)], axis=1) / held[:, None]
    order, expected = np.lexsort(points.T), np.lexsort(means.T)
    np.testing.assert_allclose(points[order], means[expected])
    np.testing.assert_array_equal(weight[order], held[expected])


@given(MASKS, st.integers(0, 2), st.integers(0, 2**32 - 1))
def test_a_point_is_near_the_mask_where_opencv_dilates_it(mask, reach, seed):
    points = np.random.default_rng(seed).uniform(-6, 50, (40, 2))
    grown = np.pad(mask, 9)
    if reach:
        grown = np.asarray(cv2.dilate(grown, np.ones((2 * reach + 1,) * 2, np.uint8)))
    grown = np.pad(grown, 60)
    column, row = np.rint(points - (-3, 7)).astype(int).T + 69
    np.testing.assert_array_equal(near_mask(mask, -3, 7, points, reach), grown[row, column] > 0)
