"""A hand over a corner of a tracked cloth: told while it is there, and the numbering is kept."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from shape_obs import ShapeDetector, Surface
from shape_obs.bench.synthetic.sheets import moving_sheet
from shape_obs.tracking.occlusion import strayed_corner


@pytest.mark.parametrize("radius", [12, 30])
@pytest.mark.parametrize("corner", [(0, 0), (-1, -1)])
def test_a_covered_corner_is_told_and_the_lattice_goes_on_afterwards(radius, corner):
    detector = ShapeDetector([Surface(rows=4, cols=8, ends="tips")], max_age=1.0)
    first = None
    for index, sheet in enumerate(moving_sheet(np.random.default_rng(3), 4, 40)):
        true = sheet.lattice(4, 8, "tips")
        covered = 15 <= index < 30
        mask = sheet.mask.copy()
        if covered:
            cv2.circle(mask, np.rint(true[corner]).astype(int).tolist(), radius, 0, -1)
        shape = detector.detect_mask(mask).shapes[0]
        assert bool(shape.reason) is covered, index
        if covered:
            assert "strays" in shape.reason
            assert not shape.visible.any()
            continue
        found = shape.pixels.reshape(4, 8, 2)
        if first is None:  # whichever corner the image calls the first, it stays the first
            first = int(np.argmin(np.linalg.norm(true[[0, 0, -1, -1], [0, -1, -1, 0]] - found[0, 0], axis=1)))
        assert np.linalg.norm(true[[0, 0, -1, -1], [0, -1, -1, 0]][first] - found[0, 0]) < 6


def test_three_corners_that_move_together_tell_the_fourth():
    rng = np.random.default_rng(0)
    corners = np.array([[0.0, 0], [200, 10], [190, 120], [-10, 110]])
    turn = np.array([[0.9, -0.3], [0.3, 0.9]])
    moved = corners @ turn.T + (40, -25) + rng.normal(0, 1, (4, 2))
    assert strayed_corner(corners, moved) == ""
    moved[2] += (-20, -12)
    assert strayed_corner(corners, moved).startswith("corner 2 strays by ")
    assert strayed_corner(corners, moved, freedom=0.3) == ""
    space = np.concatenate([corners, np.full((4, 1), 5.0)], axis=1)
    assert strayed_corner(space, space[:, [2, 0, 1]]) == ""
