"""Cloths and outlines under a slow hand, tilted and folded: what is hidden is put back, and what is seen stays."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from shape_obs import Intrinsics, ShapeDetector, Surface
from shape_obs.frame import depth_images
from shape_obs.geometry.topology import Grid
from shape_obs.tracking.hidden_border import rim_depth
from shape_obs.tracking.validation import FOLDED, validate_gaps
from tests.benchmarks.outlines import seen_outline
from tests.benchmarks.scenes.flat_objects import View, cloth, in_space, ring, under_hand
from tests.benchmarks.scenes.images import CAMERA, tilted_sheet
from tests.benchmarks.scores import tally_visible
from tests.benchmarks.sheets import seen_points

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


class TestDepthAlongAnOutline:
    """A disc of 60 px, 20 mm above a table at 0.6 m; a hand may come over it from above."""

    @staticmethod
    def disc(centre: float = 160.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return its outline, clockwise, 400 points; its mask, and the frame's depth."""
        around, (v, u) = 2 * np.pi * np.arange(400) / 400, np.mgrid[:240, :320]
        outline = np.stack([centre + 60 * np.cos(around), 120 + 60 * np.sin(around)], axis=1)
        mask = ((u - centre) ** 2 + (v - 120) ** 2 <= 3600).astype(np.uint8)
        return outline, mask, np.where(mask > 0, 0.58, 0.6)

    @staticmethod
    def read(outline: np.ndarray, mask: np.ndarray, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        images = depth_images(depth.astype(np.float32))
        return rim_depth(images, (0, 0, 320, 240), mask, 0, 0, np.ascontiguousarray(outline), 100.0)

    def under_a_hand(self, z: float, wide: int, gap: int) -> np.ndarray:
        """Return where the visible outline is taken for the hand's, of those points where it is."""
        outline, mask, depth = self.disc()
        over = np.zeros(mask.shape, bool)
        over[:100, 160 - wide : 160 + wide] = True
        mask[over], depth[over] = 0, z
        depth[(cv2.dilate(mask, np.ones((2 * gap + 1, 2 * gap + 1))) > 0) & (mask == 0)] = 0.0
        border = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0][0][::-1, 0].astype(float)
        at = np.linspace(0, len(border), 400, endpoint=False)
        outline = np.stack([np.interp(at, np.arange(len(border)), column) for column in border.T], axis=1)
        cut = self.read(outline, mask, depth)[1]
        its = (np.abs(outline[:, 0] - 160) < wide + 1.5) & (outline[:, 1] < 102)
        assert not cut[(np.abs(outline[:, 0] - 160) > wide + 8) | (outline[:, 1] > 110)].any()
        return cut[its]

    @pytest.mark.parametrize("gap", [0, 3])
    @pytest.mark.parametrize(("z", "wide"), [(0.5, 20), (0.555, 20), (0.5, 4)])
    def test_an_outline_under_a_hand_is_the_hands(self, z, wide, gap):
        """Also under a flat one, 25 mm above, and a finger of 8 px; next to an edge a camera may have no depth."""
        assert self.under_a_hand(z, wide, gap).mean() > 0.8

    def test_what_lies_four_millimetres_higher_hides_nothing(self):
        assert not self.under_a_hand(0.576, 20, 0).any()

    @pytest.mark.parametrize(("centre", "cut"), [(60.0, True), (62.0, False)])
    def test_an_outline_is_cut_by_the_border_only_where_it_touches_it(self, centre, cut):
        assert self.read(*self.disc(centre))[1].any() == cut

    def test_depth_along_an_outline_has_half_the_noise_of_a_pixel(self):
        outline, mask, depth = self.disc()
        noise = np.random.default_rng(0).normal(0, 0.002, depth.shape)
        z, cut = self.read(outline, mask, depth + noise)
        assert not cut.any()
        assert np.sqrt(np.mean((z - 0.58) ** 2)) < 0.001

    def test_depth_along_the_outline_of_a_bowl_is_that_at_its_rim(self):
        """It is 200 px wide and 100 mm deep: a tenth of what its depth changes in a pixel."""
        around, (v, u) = 2 * np.pi * np.arange(400) / 400, np.mgrid[:240, :320]
        square = (u - 160.0) ** 2 + (v - 120.0) ** 2
        mask, depth = (square <= 1e4).astype(np.uint8), np.where(square <= 1e4, 0.6 - 1e-5 * square, 0.6)
        outline = np.stack([160 + 100 * np.cos(around), 120 + 100 * np.sin(around)], axis=1)
        z, _ = rim_depth(depth_images(depth.astype(np.float32)), (0, 0, 320, 240), mask, 0, 0, outline, 200.0)
        assert np.abs(z - 0.5).max() < 0.0002

    def test_depth_along_a_narrow_outline_follows_its_slope(self):
        """A ribbon of 120 x 10 px, aslant by 5 mm in a pixel across it: a fiftieth of that."""
        corners, share = np.array([(100.0, 115), (220, 115), (220, 125), (100, 125)]), np.arange(100)[:, None] / 100
        outline = np.concatenate(
            [a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
        )
        v, u = np.mgrid[:240, :320]
        mask = ((abs(u - 160) <= 60) & (abs(v - 120) <= 5)).astype(np.uint8)
        depth = np.where(mask > 0, 0.6 + 0.005 * (v - 120) + 0.0015 * (u - 160), 0.9)
        z, _ = rim_depth(depth_images(depth.astype(np.float32)), (0, 0, 320, 240), mask, 0, 0, outline, 10.0)
        true = 0.6 + 0.005 * (outline[:, 1] - 120) + 0.0015 * (outline[:, 0] - 160)
        assert np.sqrt(np.mean((z - true) ** 2)) < 0.0001
