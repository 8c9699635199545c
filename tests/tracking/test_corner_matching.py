"""A hand over a corner of a tracked cloth: reported while it is there, and the numbering is kept."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from shape_obs import ShapeDetector, Surface
from shape_obs.bench.synthetic.sheets import Sheet, moving_sheet
from shape_obs.tracking.corner_matching import STRAYED, match_corners
from shape_obs.tracking.validation import validate_sheet


@pytest.mark.parametrize("radius", [12, 30])
@pytest.mark.parametrize("corner", [(0, 0), (-1, -1)])
def test_a_covered_corner_is_put_back_and_is_not_visible(radius, corner):
    detector = ShapeDetector([Surface(rows=4, cols=8, ends="tips")], max_age=1.0)
    first = None
    for index, sheet in enumerate(moving_sheet(np.random.default_rng(3), 4, 40)):
        true = sheet.lattice(4, 8, "tips")
        covered = 15 <= index < 30
        mask = sheet.mask.copy()
        if covered:
            cv2.circle(mask, np.rint(true[corner]).astype(int).tolist(), radius, 0, -1)
        shape = detector.detect_mask(mask).shapes[0]
        assert not shape.reason, index
        places = [Sheet(np.rot90(sheet.points, k), mask).lattice(4, 8, "tips") for k in range(4)]
        found = shape.pixels.reshape(4, 8, 2)
        if first is None:  # whichever corner the image calls the first, it stays the first
            first = int(np.argmin([np.abs(place - found).max() for place in places]))
        assert np.linalg.norm(places[first] - found, axis=-1).max() < 12
        at = np.argmin(np.linalg.norm(places[first].reshape(-1, 2) - true[corner], axis=1))
        assert shape.visible[at] != covered


QUAD = np.array([[0.0, 0], [200, 10], [190, 120], [-10, 110]])


def strayed(expected: np.ndarray, found: np.ndarray, freedom: float = STRAYED) -> str:
    _, corner, share = match_corners(expected, np.ascontiguousarray(found))
    return validate_sheet(0.0, (90.0, 0.0, 0.0, 0.0), "mask", 0.0, (corner, share), freedom).reason


def test_three_corners_that_move_together_give_the_place_of_the_fourth():
    rng = np.random.default_rng(0)
    turn = np.array([[0.9, -0.3], [0.3, 0.9]])
    moved = QUAD @ turn.T + (40, -25) + rng.normal(0, 1, (4, 2))
    assert strayed(QUAD, moved) == ""
    moved[2] += (-20, -12)
    assert strayed(QUAD, moved).startswith("corner 2 strays by ")
    assert strayed(QUAD, moved, freedom=0.3) == ""
    space = np.concatenate([QUAD, np.full((4, 1), 5.0)], axis=1)
    middle = space.mean(axis=0)
    assert strayed(space, Rotation.from_rotvec([0.7, -0.5, 0.3]).apply(space - middle) + middle) == ""


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), quarters=st.integers(0, 3), corner=st.integers(0, 3))
def test_the_corner_that_strays_is_that_of_least_squares(seed, quarters, corner):
    """Each corner is compared with the similarity transform of the other three, in the image and in space."""
    rng = np.random.default_rng(seed)
    found = QUAD + rng.uniform(-15, 15, (4, 2))
    found[corner] += rng.uniform(-25, 25, 2)
    away = []
    for k in range(4):
        rest = np.delete(np.arange(4), k)
        (x, y), ones = QUAD.T, np.ones(4)
        rows = np.stack([np.stack([x, -y, ones, 0 * ones], 1), np.stack([y, x, 0 * ones, ones], 1)], axis=1)
        solved = np.linalg.lstsq(rows[rest].reshape(6, 4), found[rest].reshape(6), rcond=None)[0]
        away.append(np.linalg.norm(rows[k] @ solved - found[k]))
    share = max(away) / np.linalg.norm(found - found.mean(axis=0), axis=1).max()
    expected = quarters, int(np.argmax(away)), pytest.approx(share)
    assert match_corners(QUAD, np.roll(found, quarters, axis=0)) == expected
    flat = (np.pad(points, ((0, 0), (0, 1))) for points in (QUAD, np.roll(found, quarters, axis=0)))
    assert match_corners(*flat) == expected
