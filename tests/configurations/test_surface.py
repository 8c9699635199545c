"""Surfaces: lattices over drawn and real sheets, their numbering, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shape_obs import Intrinsics, ShapeDetector, Surface
from shape_obs.bench.scenes import Sheet, draw_sheet
from shape_obs.metrics import calinski_harabasz, nearest
from tests.benchmarks.scores import ASPECTS, best_corner, by_the_rule
from tests.scenes.crumpled import from_above, waved
from tests.scenes.flat_objects import FlatScene, View, cloth, noisy_depth, rolled, seen
from tests.scenes.sheets import random_sheet, rotation, true_lattice

REAL = Path(__file__).parents[3] / "shared" / "data" / "real"


def one(mask: np.ndarray, spec: Surface | None = None, **kwargs: Any) -> Any:
    return ShapeDetector([spec or Surface()]).detect_mask(mask, **kwargs).shapes[0]


def placed(points: np.ndarray, degrees: float = 0.0, scale: float = 1.0, size: tuple[int, int] = (480, 640)) -> Sheet:
    """Return a lattice about the origin, turned and put into the middle of an image."""
    return draw_sheet(points @ rotation(degrees).T * scale + np.array([size[1] - 1, size[0] - 1]) / 2, size)


@pytest.fixture(scope="module")
def towel() -> Sheet:
    return random_sheet(np.random.default_rng(4), 1.5, 20.0)


@pytest.mark.parametrize("ends", ["centers", "tips"])
@pytest.mark.parametrize(("rows", "cols"), [(4, 8), (2, 2), (3, 3), (8, 8), (6, 10)])
def test_points_of_bent_sheets_lie_on_their_material_from_the_first_corner_on(rows, cols, ends):
    rng, spec, distances = np.random.default_rng(12), Surface(rows=rows, cols=cols, ends=ends), []
    for number in range(8):
        sheet = random_sheet(rng, ASPECTS[number % 4], 45 * number + rng.uniform(-5, 5), tilt=0.02)
        shape = one(sheet.mask, spec)
        assert shape.ok, shape.reason
        assert shape.quality > 0.35
        right, off = by_the_rule(shape, sheet, spec)
        assert right
        assert off.slip <= 0.5
        assert off.mean <= 3.0
        distances.append(off.mean)
    assert np.mean(distances) <= 1.5


class TestLattice:
    @pytest.mark.parametrize("ends", ["centers", "tips"])
    @pytest.mark.parametrize("lattice", [(4, 8), (2, 2), (7, 3)])
    def test_a_rectangle_is_divided_into_equal_pieces(self, ends, lattice):
        mask = np.zeros((240, 320), np.uint8)
        mask[60:180, 40:280] = 255  # from -0.5 to +0.5 beyond the outermost pixels' centres
        shape = one(mask, Surface(rows=lattice[0], cols=lattice[1], ends=ends))
        sides = [(np.arange(n) + 0.5) / n if ends == "centers" else np.linspace(0, 1, n) for n in lattice]
        v, u = np.meshgrid(59.5 + 120 * sides[0], 39.5 + 240 * sides[1], indexing="ij")
        assert shape.ok
        assert shape.visible.all()
        np.testing.assert_allclose(shape.points2d.reshape(*lattice, 2), np.stack([u, v], axis=-1), atol=0.7)


class TestNumbering:
    @settings(max_examples=15)
    @given(seed=st.integers(0, 2**32 - 1), aspect=st.sampled_from(ASPECTS), degrees=st.floats(0, 360))
    def test_rows_run_down_and_columns_right(self, seed, aspect, degrees):
        sheet = random_sheet(np.random.default_rng(seed), aspect, degrees)
        shape = one(sheet.mask)
        assert shape.ok, shape.reason
        lattice = shape.points2d.reshape(4, 8, 2)
        right, down = (np.diff(lattice, axis=axis).mean(axis=(0, 1)) for axis in (1, 0))
        assert right[0] * down[1] - right[1] * down[0] > 0  # never mirrored
        right, down = right / np.linalg.norm(right), down / np.linalg.norm(down)
        assert right[0] + down[1] >= 2 * np.cos(np.radians(45)) - 0.05
        assert by_the_rule(shape, sheet, Surface())[0]

    @pytest.mark.parametrize("corner", range(4))
    def test_an_anchor_begins_at_its_corner(self, towel, corner):
        places = towel.points[[0, 0, -1, -1], [0, -1, -1, 0]]
        outside = places[corner] + 0.3 * (places[corner] - towel.points.mean(axis=(0, 1)))
        shape = one(towel.mask, Surface(ends="tips", anchor=(float(outside[0]), float(outside[1]))))
        np.testing.assert_allclose(shape.points2d[0], places[corner], atol=3)
        np.testing.assert_allclose(shape.points2d[7], places[(corner + 1) % 4], atol=3)


class TestGate:
    @pytest.mark.parametrize(
        ("draw", "reason"),
        [
            (lambda m: cv2.circle(m, (320, 240), 100, (255,), -1), "the outline has 0 corners, a sheet has four"),
            (lambda m: cv2.fillPoly(m, [np.array([[100, 400], [500, 400], [300, 60]])], (255,)), "3 corners"),
            (lambda m: cv2.rectangle(m, (50, 200), (600, 210), (255,), -1), "too slender for a sheet"),
            (lambda m: cv2.rectangle(m, (50, 200), (54, 206), (255,), -1), "too small for a sheet"),
            (lambda m: cv2.rectangle(m, (-50, 100), (300, 300), (255,), -1), "corners are out of sight"),
        ],
    )
    def test_what_is_no_sheet_is_refused(self, draw, reason):
        mask = np.zeros((480, 640), np.uint8)
        draw(mask)
        shape = one(mask)
        assert not shape.ok
        assert reason in shape.reason

    def test_two_pieces_are_no_sheet(self, towel):
        mask = towel.mask.copy()
        cv2.line(mask, (0, 0), (639, 479), (0,), 12)
        assert "falls into 2 pieces" in one(mask).reason

    def test_a_hand_over_a_side_hides_what_is_under_it_alone(self, towel):
        detector = ShapeDetector([Surface()])
        before = detector.detect_mask(towel.mask).shapes[0]
        bitten = towel.mask.copy()
        cv2.circle(bitten, tuple(np.round(towel.points[0, 32]).astype(int).tolist()), 34, (0,), -1)
        covered = detector.detect_mask(bitten).shapes[0]
        distance = np.linalg.norm(before.pixels - towel.points[0, 32], axis=1)
        assert np.count_nonzero(distance < 32) == 2
        assert not covered.visible[distance < 32].any()
        assert covered.visible[distance > 36].all()
        np.testing.assert_allclose(covered.pixels, before.pixels, atol=2)
        after = detector.detect_mask(towel.mask).shapes[0]
        np.testing.assert_allclose(after.pixels, before.pixels, atol=0.1)

    def test_a_hole_hides_its_points_alone(self, towel):
        mask = towel.mask.copy()
        whole = one(mask)
        cv2.circle(mask, tuple(np.round(whole.points2d[12]).astype(int).tolist()), 12, (0,), -1)
        shape = one(mask)
        assert shape.ok
        assert np.flatnonzero(~shape.visible).tolist() == [12]
        np.testing.assert_allclose(shape.points2d, whole.points2d, atol=0.1)


class TestSmallImages:
    @pytest.mark.parametrize(("size", "scale"), [((84, 84), 0.16), ((120, 160), 0.25)])
    def test_training_frames(self, size, scale):
        for seed in range(4):
            big = random_sheet(np.random.default_rng(seed), ASPECTS[seed % 4], 0.0, bend=0.02)
            points = big.points - big.points.mean(axis=(0, 1))
            sheet = placed(points, 31.0 * seed, scale, size)
            shape = one(sheet.mask)
            assert shape.ok, shape.reason
            _, best = best_corner(shape, sheet, Surface())
            assert best.mean <= 0.8
            assert best.slip <= 0.5


CAMERA = Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)


@pytest.fixture(scope="module", params=[0, 25, 40])
def tilted(request):
    """Return a flat cloth of 0.3 x 0.2 m under a tilt: its material in metres, its mask and its depth."""
    angle = np.radians(request.param)
    v, u = np.meshgrid(np.linspace(-0.1, 0.1, 65), np.linspace(-0.15, 0.15, 65), indexing="ij")
    points = np.stack([u, v * np.cos(angle), 0.8 + v * np.sin(angle)], axis=-1)
    mask = draw_sheet(CAMERA.project(points.reshape(-1, 3)).reshape(65, 65, 2)).mask
    # On the plane z = 0.8 + y tan(angle), and y = z (v - cy) / fy.
    slope = np.tan(angle) * (np.arange(480.0) - CAMERA.cy) / CAMERA.fy
    depth = np.repeat((0.8 / (1 - slope))[:, None], 640, axis=1)
    noisy = depth + np.random.default_rng(0).normal(0, 0.001, depth.shape)
    return points, mask, np.where(mask > 0, noisy, 1.5), request.param


@pytest.mark.parametrize(  # equal gaps in the image are not equal on the cloth
    ("options", "most"),
    [({"spacing": "m"}, 1.5), ({"lift": "cloud"}, 2), ({"lift": "cloud", "epochs": 1}, 3), ({}, 8)],
)
def test_points_of_a_tilted_cloth_lie_on_its_material_in_space(tilted, options, most):
    points, mask, depth, tilt = tilted
    shape = one(mask, Surface(ends="centers", **options), depth=depth, camera=CAMERA)
    assert shape.ok, shape.reason
    assert shape.valid.all()
    off = shape.points3d.reshape(4, 8, 3) - true_lattice(points, 4, 8, "centers")
    assert 1e3 * np.linalg.norm(off, axis=-1).mean() <= (most if tilt or options else 1.5)


@pytest.mark.skipif(not REAL.exists(), reason=f"the shared data is not there: {REAL}")
class TestRealMasks:
    def test_silhouettes_score_by_what_they_are(self):
        """The images are photos of towels, T-shirts and shorts: the aRTF Clothes data."""
        quality: dict[str, list[float]] = {}
        for garment in json.loads((REAL / "garment_silhouettes.json").read_text()):
            mask = np.zeros((garment["height"] // 3, garment["width"] // 3), np.uint8)
            cv2.fillPoly(mask, [np.round(np.array(garment["polygon"]) / 3).astype(np.int32)], (255,))
            shape = one(mask)
            assert shape.ok == (not shape.reason)
            quality.setdefault(garment["kind"], []).append(shape.quality)
        assert min(quality["towels"]) > 0.4
        assert np.median(quality["towels"]) > 0.8
        for kind in ("tshirts", "shorts"):
            assert np.mean(np.array(quality[kind]) == 0) > 0.5
            assert np.quantile(quality[kind], 0.9) < 0.5

    def test_harnesses_are_no_sheets(self):
        for path in sorted(REAL.glob("harness_mask_*.png")):
            mask = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            assert mask is not None
            assert "too slender" in one(mask).reason


BEYOND = {"beneath": (1, 1, -1), "over": (1, 1, 1)}  # a cloth rolled up lies over itself, its mirror image beneath


def folded(where: str, degrees: float, share: float, radius: float = 0.008) -> FlatScene:
    """Draw a cloth that is folded over a line at a share of the way from its middle, seen from straight above."""
    flat, way = cloth(1.0), np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    space = rolled(flat, way, share * (flat @ way).max(), radius, np.pi if where else 0.0)
    return seen(space * BEYOND.get(where, (1, 1, 1)) + [0, 0, 0.62], False, View(), None)


def in_space(scene: FlatScene, **options: Any) -> Any:
    return one(scene.mask, Surface(**options), depth=scene.depth, camera=View().intrinsics)


@pytest.mark.parametrize("options", [{}, {"spacing": "m"}, {"lift": "cloud"}, {"rows": 8}])
@pytest.mark.parametrize(
    ("where", "degrees", "share", "radius"),
    [("beneath", 45, 0.5, 0.008), ("over", 45, 0.6, 0.008), ("over", 0, 0.6, 0.008), ("beneath", 0, 0.3, 0.02)],
)
def test_depth_shows_that_a_cloth_is_folded(where, degrees, share, radius, options):
    shape = in_space(folded(where, degrees, share, radius), **options)
    assert not shape.ok
    assert "beneath" in shape.reason


def test_a_small_corner_beneath_leaves_the_rest_of_a_cloth():
    laid, shape = in_space(folded("", 0, 1.0)), in_space(folded("beneath", 30, 0.8))
    assert laid.valid.all()
    assert laid.quality > 0.95
    assert shape.ok, shape.reason
    assert shape.quality < 0.8
    lost = ~shape.valid
    assert 1 <= lost.sum() <= 8
    assert shape.sigma[lost].min() > 3 * laid.sigma.max()


@pytest.mark.parametrize("steepest", [0.3, 0.6])
def test_gentle_waves_are_no_folds(steepest):
    for seed in range(6):
        rng = np.random.default_rng(seed)
        scenes = iter([from_above(waved(rng, steepest), View(), rng.uniform(0, 360))])
        shape = in_space(next(noisy_depth(scenes, View(), seed)))
        assert shape.ok, shape.reason
        assert shape.valid.all()
        assert shape.quality > 0.8


def test_the_noise_of_single_pixels_is_no_fold(towel):
    depth = np.random.default_rng(0).integers(695, 705, towel.mask.shape, np.uint16)
    shape = one(towel.mask, depth=depth, camera=Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5))
    assert shape.ok, shape.reason
    assert shape.valid.all()


def test_epochs_take_the_points_nearer_to_cluster_centres():
    """The cloth is wide at the left and narrow at the right: equal steps along its sides give unequal areas."""
    outline = np.array([[60, 40], [420, 130], [420, 210], [60, 300]], np.int32)
    trapezium = cv2.fillPoly(np.zeros((340, 480), np.uint8), [outline], 255)
    pixels, scores = np.argwhere(trapezium)[:, ::-1], []
    for epochs in (0, 1, 3):
        shape = one(trapezium, Surface(epochs=epochs))
        assert shape.ok, shape.reason
        scores.append(calinski_harabasz(pixels, nearest(pixels, shape.points2d)))
    assert scores[0] < scores[1] < scores[2]
