"""Which rows of pixels hang together: OpenCV's components, to the pixel."""

from __future__ import annotations

from importlib.util import find_spec

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shape_obs.compiled.numpy_pieces import pieces


def runs_of(mask):
    """(R,3) row, first column, column past the last one."""
    found = []
    for row, line in enumerate(mask):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], line > 0, [0]]).astype(int)))
        found += [(row + 7, start - 3, stop - 3) for start, stop in edges.reshape(-1, 2)]
    return np.array(found, np.int64).reshape(-1, 3)


@given(st.integers(0, 2**32 - 1), st.floats(0, 1), st.integers(1, 5))
def test_components_are_those_of_opencv_numbered_as_they_appear(seed, share, grain):
    rng = np.random.default_rng(seed)
    size = rng.integers(1, 40, 2)
    mask = np.kron(rng.uniform(size=-(-size // grain)) < share, np.ones((grain, grain), np.uint8))[: size[0], : size[1]]
    runs = runs_of(mask)
    label, count = pieces(runs)
    labels = np.asarray(cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)[1])
    assert count == labels.max()
    row, column = runs[:, 0] - 7, runs[:, 1] + 3
    assert len({*zip(label, labels[row, column], strict=True)}) == count
    first = [int(np.flatnonzero(label == k)[0]) for k in range(count)]
    assert first == sorted(first)


def test_corners_touch_and_a_gap_of_one_pixel_does_not():
    corner, gap = np.eye(5), np.array([[1, 0, 1, 1]])
    assert pieces(runs_of(corner))[1] == 1
    assert pieces(runs_of(gap))[0].tolist() == [0, 1]
    assert pieces(runs_of(np.zeros((3, 3))))[1] == 0
    below = np.array([[1, 1, 0, 0, 0], [0, 0, 0, 1, 1]])  # a column apart
    assert pieces(runs_of(below))[1] == 2


@pytest.mark.skipif(not find_spec("numba"), reason="no Numba")
def test_rows_in_a_ring_s_hole_are_a_piece_of_their_own():
    from shape_obs.compiled.numba_mask import _pieces

    mask = np.zeros((60, 60), np.uint8)
    cv2.circle(mask, (30, 30), 25, 255, 5)
    mask[28:33, 28:33] = 255
    runs = runs_of(mask)
    for a, b in zip(pieces(runs), _pieces(runs), strict=True):
        np.testing.assert_array_equal(a, b)
    assert pieces(runs)[1] == 2
