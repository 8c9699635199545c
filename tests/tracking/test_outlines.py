"""Outlines and cloths that turn, move, are tilted and folded, or lie under a hand: visible points keep their index."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import cv2
import numpy as np
import pytest

from shape_obs import Contour, Intrinsics, Shape, ShapeDetector, Surface
from shape_obs.bench.scenes import draw_blob, moving_blob, moving_sheet
from tests.benchmarks.outlines import MOTIONS, seen_outline
from tests.benchmarks.scores import tally_visible
from tests.benchmarks.sheets import seen_points
from tests.scenes.blobs import random_blob
from tests.scenes.flat_objects import FlatScene, View, cloth, in_space, ring, under_hand
from tests.scenes.images import CAMERA, tilted_sheet
from tests.scenes.sheets import true_lattice


@pytest.mark.parametrize("radius", [12, 30])
@pytest.mark.parametrize("corner", [(0, 0), (-1, -1)])
def test_a_covered_corner_is_put_back_and_is_not_visible(radius, corner):
    detector = ShapeDetector([Surface(rows=4, cols=8, ends="tips")], max_age=1.0)
    first = None
    for index, sheet in enumerate(moving_sheet(np.random.default_rng(3), 4, 40)):
        true = true_lattice(sheet.points, 4, 8, "tips")
        covered = 15 <= index < 30
        mask = sheet.mask.copy()
        if covered:
            cv2.circle(mask, np.rint(true[corner]).astype(int).tolist(), radius, 0, -1)
        shape = detector.detect_mask(mask).shapes[0]
        assert not shape.reason, index
        places = [true_lattice(np.rot90(sheet.points, k), 4, 8, "tips") for k in range(4)]
        found = shape.pixels.reshape(4, 8, 2)
        if first is None:  # whichever corner the image calls the first, it stays the first
            first = int(np.argmin([np.abs(place - found).max() for place in places]))
        assert np.linalg.norm(places[first] - found, axis=-1).max() < 12
        at = np.argmin(np.linalg.norm(places[first].reshape(-1, 2) - true[corner], axis=1))
        assert shape.visible[at] != covered


VIEW, SMALL = View(), View(height=240)


@pytest.mark.parametrize(
    ("with_depth", "place", "moving"),
    [(False, "corner", 4.0), (False, "side", 0.0), (True, "corner", 0.0), (True, "side", 4.0)],
)
def test_a_hand_over_a_cloth_moves_no_visible_point(with_depth, place, moving):
    scenes = under_hand(np.random.default_rng(1), cloth(1.5), VIEW, place, 3.0, moving, level=not with_depth)
    found = tally_visible(list(seen_points(scenes, VIEW, with_depth)))
    assert (found.slips, found.refused) == (0, 0), found
    assert found.seen > 97
    assert found.hidden_valid < 25


@pytest.mark.parametrize("motion", ["tilted", "corner up"])
def test_a_cloth_in_space_keeps_its_index(motion):
    scenes = in_space(np.random.default_rng(3), cloth(2.0), VIEW, motion, 30.0, 60)
    found = tally_visible(list(seen_points(scenes, VIEW, True)))
    assert found.slips == 0, found
    assert found.refused < 2
    assert found.mm < 5


def in_clouds(scenes: Iterable[FlatScene]) -> list[tuple[FlatScene, Shape]]:
    """Track a cloth in the cloud under each mask."""
    detector = ShapeDetector([Surface(rows=4, cols=8, lift="cloud")])
    return [(scene, detector.detect_mask(scene.mask, scene.depth, SMALL.intrinsics).shapes[0]) for scene in scenes]


@pytest.mark.parametrize("motion", ["tilted", "corner up"])
@pytest.mark.parametrize("seed", range(3))
def test_a_cloth_in_a_cloud_is_never_refused_in_full_view(motion, seed):
    """A corner that bends up moves as the others do not; the sides keep their lengths."""
    for scene, shape in in_clouds(in_space(np.random.default_rng(seed), cloth(1.5), SMALL, motion, 10.0, 30)):
        assert not shape.reason
        assert shape.points3d is not None
        if motion == "tilted":
            places = [true_lattice(np.rot90(scene.space, k), 4, 8, "centers").reshape(-1, 3) for k in range(4)]
            assert min(np.linalg.norm(shape.points3d - each, axis=1).max() for each in places) < 0.015


@pytest.mark.parametrize("seed", range(3))
def test_a_cloth_in_a_cloud_is_refused_only_while_a_corner_is_hidden(seed):
    found = in_clouds(under_hand(np.random.default_rng(seed), cloth(1.5), SMALL, "corner", 6.0, 4.0))
    hidden = np.array([scene.hidden[[0, 0, -1, -1], [0, -1, -1, 0]].any() for scene, _ in found])
    refused = np.array([bool(shape.reason) for _, shape in found])
    assert not refused[~hidden].any()
    assert refused[hidden].mean() > 0.7
    assert any("side" in shape.reason for _, shape in found)


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


@pytest.mark.parametrize("seed", [13, 39])
def test_a_hole_in_the_depth_at_a_border_bends_no_sheet(seed):
    sheet = tilted_sheet(np.random.default_rng(seed))
    detector = ShapeDetector([Surface(rows=4, cols=8, ends="tips", spacing="m")])
    shape = detector.detect_mask(sheet.mask, sheet.depth, CAMERA).shapes[0]
    assert shape.ok, shape.reason
    assert shape.points3d is not None
    away = np.linalg.norm(shape.points3d - sheet.lattice(4, 8), axis=1)
    assert np.median(away) < 0.004


@pytest.mark.parametrize(
    ("hollow", "seed", "speed", "moving"),
    [
        (True, 0, 2.0, 4.0),
        (False, 1, 8.0, 4.0),
        pytest.param(True, 1, 1.0, 0.0, marks=pytest.mark.nightly),
        pytest.param(False, 0, 2.0, 4.0, marks=pytest.mark.nightly),
    ],
)
def test_a_hand_that_only_the_mask_shows_moves_no_visible_point(hollow, seed, speed, moving):
    rng = np.random.default_rng((seed, round(10 * speed)))
    scenes = under_hand(rng, ring(rng, hollow), VIEW, "side", speed, moving, level=True)
    frames = list(seen_outline(scenes, VIEW, False))
    found = tally_visible(frames)
    assert found.slips <= 1, found
    assert (found.refused, found.renewed) == (0, 0)
    assert found.seen > 98
    assert found.hidden_valid < 15
    last = frames[-1]
    assert last.visible.all()
    assert last.off.max() < 0.1


@pytest.mark.parametrize("motion", ["deforming", "40 px a frame", "nearly round"])
def test_an_outline_that_moves_and_changes_its_form_hides_nothing(motion):
    detector = ShapeDetector(Contour())
    for blob in moving_blob(np.random.default_rng(3), frames=60, **MOTIONS[motion]):
        assert detector.detect_mask(blob.mask).shapes[0].visible.all()


def test_what_only_touches_an_outline_hides_nothing():
    camera = Intrinsics(160, 120, 110.0, 110.0, 80.0, 60.0)
    free, touched = (ShapeDetector(Contour(spacing="m")) for _ in range(2))
    around = 2 * np.pi * np.arange(400) / 400
    away = 25 * (1 + 0.12 * np.cos(3 * around + 0.4) + 0.06 * np.cos(2 * around + 1))
    for frame in range(70):
        wide = 0.1 * np.sin(np.pi * frame / 70) ** 2  # it changes its form
        points = np.stack([away * np.cos(around) * (1 + wide), away * np.sin(around) * (1 - wide)], axis=1) + [82, 62]
        mask = cv2.fillPoly(np.zeros((120, 160), np.uint8), [np.rint(16 * points).astype(int)], 255, shift=4)
        depth = np.where(mask > 0, np.uint16(600), np.uint16(650))
        expected = free.detect_mask(mask, depth, camera).shapes[0]
        top, (v, u) = points[np.argmin(points[:, 1])], np.mgrid[:120, :160]
        if frame >= 20:
            depth[(abs(u - top[0]) < 5) & (v < top[1] + 6) & (mask == 0)] = 500
        found = touched.detect_mask(mask, depth, camera).shapes[0]
        assert found.visible.all()
        gap = np.linalg.norm(np.diff(expected.pixels, axis=0), axis=1).mean()
        assert np.linalg.norm(found.pixels - expected.pixels, axis=1).max() < 0.2 * gap


def one(mask: np.ndarray, detector: ShapeDetector | None = None) -> Any:
    return (detector or ShapeDetector([Contour()])).detect_mask(mask).shapes[0]


class TestRegistration:
    def test_a_marked_shape_is_found_again_after_any_turn(self):
        """A weakly marked one may pass for one that deformed: the marks must outweigh the cost of the turn."""
        blob = random_blob(np.random.default_rng(4), "c", size=(480, 480))
        start = one(blob.mask).points2d[0]
        for angle in np.linspace(-3, 3, 7):
            detector = ShapeDetector([Contour()])
            one(blob.mask, detector)
            turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
            turned = draw_blob((blob.outline - 239.5) @ turn + 239.5, size=(480, 480))
            np.testing.assert_allclose(one(turned.mask, detector).points2d[0], (start - 239.5) @ turn + 239.5, atol=1.5)

    @pytest.mark.parametrize("spacing", ["px", "m"])
    def test_a_small_circle_does_not_turn_by_the_noise_of_its_pixels(self, spacing):
        camera = Intrinsics(160, 120, 110.0, 110.0, 80.0, 60.0)
        angle, ends = 2 * np.pi * np.arange(400) / 400, []
        for seed in range(4):
            rng, detector = np.random.default_rng(seed), ShapeDetector([Contour(spacing=spacing)])
            middle, radius, moved, start = rng.uniform(60, 80, 2), rng.uniform(20, 28), rng.uniform(-0.2, 0.2, 2), None
            for frame in range(90):
                circle = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1) + middle + frame * moved
                mask = cv2.fillPoly(np.zeros((120, 160), np.uint8), [np.rint(16 * circle).astype(int)], 255, shift=4)
                depth = np.where(mask > 0, np.uint16(600), np.uint16(650))
                seen: dict[str, Any] = {"depth": depth, "camera": camera} if spacing == "m" else {}
                shape = detector.detect_mask(mask, **seen).shapes[0]
                away = (shape.pixels - middle - frame * moved) @ (1, 1j)
                start = away if start is None else start
                ends.append(np.angle(np.vdot(start, away)) * 32 / 2 / np.pi)
        assert np.abs(ends).max() < 0.8
