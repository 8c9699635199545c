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
from shape_obs.bench.synthetic.images import CAMERA, tilted_sheet
from shape_obs.geometry.topology import Grid
from shape_obs.tracking.validation import FOLDED, validate_gaps

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
    assert found.slips == 0, found
    assert found.refused < 2
    assert found.mm < 5


def test_what_a_fold_hides_is_not_valid():
    scenes = in_space(np.random.default_rng((0, 80)), cloth(1.0), VIEW, "folded", 8.0, 80)
    found = tally_visible(list(seen_points(scenes, VIEW, True)))
    assert found.slips < 1
    assert found.refused < 15
    assert found.hidden_valid < 5


def test_a_crumpled_cloth_is_refused_and_keeps_its_track():
    """The pull of grippers lays folds into a cloth whose outline still looks like a sheet's."""
    detector = ShapeDetector([Surface(rows=4, cols=8, spacing="m")], dt=0.1)
    scenes = in_space(np.random.default_rng((2, 80)), cloth(1.5), VIEW, "folded", 8.0, 120)
    shapes = [detector.detect_mask(scene.mask, scene.depth, VIEW.intrinsics).shapes[0] for scene in scenes]
    refused = [shape for shape in shapes if "differ in space" in shape.reason]
    assert 2 <= len(refused) <= 40
    assert not any(shape.visible.any() or shape.valid.any() for shape in refused)
    assert {shape.track_id for shape in shapes} == {1}
    assert not shapes[-1].reason, "after more than half a second"


class TestGapsInSpace:
    SHEET = Grid(4, 8)

    def points(self, stretch: float = 1.0) -> np.ndarray:
        across = np.cumsum(np.linspace(1, stretch, 8)) * 0.03
        return np.stack([*np.meshgrid(across, np.arange(4) * 0.04), np.full((4, 8), 0.6)], axis=-1).reshape(-1, 3)

    def test_equal_gaps_are_a_sheet_and_others_are_not(self):
        everything = np.ones(32, bool)
        assert not validate_gaps(self.points(), everything, self.SHEET, 0.0)
        assert not validate_gaps(self.points(1.1), everything, self.SHEET, 0.0)
        assert validate_gaps(self.points(1.5), everything, self.SHEET, 0.0) == FOLDED

    def test_what_is_not_measured_says_nothing(self):
        points, valid = self.points(), np.arange(32) % 8 < 6
        points[~valid] += 0.1
        assert not validate_gaps(points, valid, self.SHEET, 0.0)
        assert not validate_gaps(points, np.zeros(32, bool), self.SHEET, 0.0)

    def test_noise_is_no_fold(self):
        noise = np.random.default_rng(0).normal(0, 0.0025, (32, 3))
        assert validate_gaps(self.points() + noise, np.ones(32, bool), self.SHEET, 0.0005) == FOLDED
        assert not validate_gaps(self.points() + noise, np.ones(32, bool), self.SHEET, 0.004)


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


@pytest.mark.parametrize("seed", [13, 14, 37, 39, 43])
def test_a_hole_in_the_depth_at_a_border_bends_no_sheet(seed):
    sheet = tilted_sheet(np.random.default_rng(seed))
    detector = ShapeDetector([Surface(rows=4, cols=8, ends="tips", spacing="m")])
    shape = detector.detect_mask(sheet.mask, sheet.depth, CAMERA).shapes[0]
    assert shape.ok, shape.reason
    assert shape.points3d is not None
    away = np.linalg.norm(shape.points3d - sheet.lattice(4, 8), axis=1)
    assert np.median(away) < 0.004
