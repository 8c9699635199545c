"""Cloths and outlines under a slow hand, tilted and folded: what is hidden is put back, and what is seen stays."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from shape_obs import Intrinsics, ShapeDetector, Surface
from shape_obs.bench.contour_claims import seen_outline
from shape_obs.bench.scores import tally_visible
from shape_obs.bench.surface_claims import seen_points
from shape_obs.bench.synthetic.flat_objects import View, cloth, in_space, ring, under_hand

VIEW = View()


@pytest.mark.parametrize("with_depth", [False, True])
@pytest.mark.parametrize("place", ["corner", "side"])
@pytest.mark.parametrize("moving", [0.0, 4.0])
def test_a_hand_over_a_cloth_moves_no_visible_point(with_depth, place, moving):
    scenes = under_hand(np.random.default_rng(1), cloth(1.5), VIEW, place, 3.0, moving, level=not with_depth)
    found = tally_visible(list(seen_points(scenes, VIEW, with_depth)))
    assert (found.slips, found.refused) == (0, 0), found
    assert found.seen > 97
    assert found.hidden_valid < 25


def test_a_hand_that_creeps_is_no_change_of_the_cloth():
    scenes = under_hand(np.random.default_rng(2), cloth(1.0), VIEW, "corner", 0.8, level=True)
    found = tally_visible(list(seen_points(scenes, VIEW, False)))
    assert (found.slips, found.refused) == (0, 0), found


@pytest.mark.parametrize("motion", ["tilted", "corner up"])
def test_a_cloth_in_space_keeps_its_index(motion):
    scenes = in_space(np.random.default_rng(3), cloth(2.0), VIEW, motion, 30.0, 60)
    found = tally_visible(list(seen_points(scenes, VIEW, True)))
    assert (found.slips, found.refused) == (0, 0), found
    assert found.mm < 5


def test_what_a_fold_hides_is_not_valid():
    scenes = in_space(np.random.default_rng((0, 80)), cloth(1.0), VIEW, "folded", 8.0, 80)
    found = tally_visible(list(seen_points(scenes, VIEW, True)))
    assert found.slips < 5
    assert found.refused < 5
    assert found.hidden_valid < 15


@pytest.mark.parametrize("hollow", [True, False])
def test_an_outline_in_space_keeps_its_index(hollow):
    rng = np.random.default_rng(0)
    found = tally_visible(list(seen_outline(in_space(rng, ring(rng, hollow), VIEW, "tilted", 20.0, 60), VIEW, True)))
    assert (found.slips, found.refused) == (0, 0), found
    assert found.mm < 4


@pytest.mark.parametrize("hollow", [True, False])
def test_a_hand_over_an_outline_moves_no_visible_point(hollow):
    rng = np.random.default_rng(1)
    scenes = under_hand(rng, ring(rng, hollow), VIEW, "side", 6.0, 4.0)
    found = tally_visible(list(seen_outline(scenes, VIEW, True)))
    assert (found.slips, found.refused) == (0, 0), found
    assert found.hidden_valid < 15


@pytest.mark.parametrize(("seed", "draw", "speed"), [(3, 400, 40.0), (2, 80, 30.0)])
def test_an_outline_of_which_a_side_is_lifted_keeps_its_index(seed, draw, speed):
    """It moves far between the first frame and the second, and bends by 75 degrees after that."""
    rng = np.random.default_rng((seed, draw))
    found = tally_visible(list(seen_outline(in_space(rng, ring(rng, False), VIEW, "corner up", speed, 60), VIEW, True)))
    assert (found.slips, found.refused) == (0, 0), found
    assert found.worst < 0.25
    assert found.mm < 1.5


def test_a_slow_hand_over_a_small_outline_moves_no_visible_point():
    rng, view = np.random.default_rng((3, 10)), View(height=120)
    found = tally_visible(list(seen_outline(under_hand(rng, ring(rng, True), view, "side", 1.0, 4.0), view, True)))
    assert found.slips < 1, found
    assert found.refused == 0


def test_a_sheet_that_is_pushed_together_in_full_view_is_shorter_and_not_hidden():
    """It becomes a sixth narrower, as a cloth that buckles; the camera sees the table where it was."""
    camera = Intrinsics(640, 480, 500.0, 500.0, 320.0, 240.0)
    detector = ShapeDetector([Surface(rows=4, cols=8, ends="tips", spacing="m")])
    for narrower in range(0, 39, 3):
        mask, depth = np.zeros((480, 640), np.uint8), np.full((480, 640), 0.70, np.float32)
        corners = np.array([(210, 180), (430 - narrower, 180), (430 - narrower, 320), (210, 320)])
        cv2.fillPoly(mask, [corners], 255)
        depth[mask > 0] = 0.66
        shape = detector.detect_mask(mask, depth, camera).shapes[0]
        assert not shape.reason
        assert shape.valid.all()
        np.testing.assert_allclose(shape.pixels[[0, 7, 31, 24]], corners, atol=3)
