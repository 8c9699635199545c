"""Points in space: depth under each point, holes, equal spacing in metres, the axis behind the surface."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from shape_obs import CameraModel, Centerline, Frame, Intrinsics, ShapeDetector
from shape_obs.bench.scenes import Rope, draw_rope
from shape_obs.compiled import compiled
from shape_obs.configurations.shape_points import shape_of
from shape_obs.frame import DEPTH_TYPE, depth_images
from shape_obs.geometry.curve import FittedCurve
from shape_obs.image.find_region import find_region
from shape_obs.image.roi import Window
from shape_obs.point_cloud.strands import gather_lifted_cells
from shape_obs.tracking.clock import Clock
from shape_obs.tracking.predict import Fit
from shape_obs.tracking.scene import Scene

CAMERA = Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)


def one(detector: ShapeDetector, mask: np.ndarray, depth: np.ndarray, camera: Any = CAMERA, **kwargs: Any) -> Any:
    return detector.detect_mask(mask, depth, camera, **kwargs).shapes[0]


def gap_cv(points: np.ndarray) -> float:
    gap = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return float(gap.std() / gap.mean())


class Tilted:
    """A rope lying on a plane that leans 60 degrees away from the image plane: (rope, depth in metres, true points)."""

    def __init__(self) -> None:
        lean = np.radians(60)
        along, up = np.array([1.0, 0.0, 0.0]), np.array([0.0, np.cos(lean), -np.sin(lean)])
        origin = np.array([0.0, 0.0, 0.9])
        s = np.linspace(-1, 1, 2001)
        curve = origin + np.outer(0.18 * np.sin(2.2 * s), along) + np.outer(0.33 * s, up)
        step = np.linalg.norm(np.diff(curve, axis=0), axis=1)
        arc = np.concatenate([[0], np.cumsum(step)])
        self.curve, self.arc = curve, arc / arc[-1]
        self.rope: Rope = draw_rope(CAMERA.project(curve)[::4], 9)
        u, v = np.meshgrid(np.arange(640), np.arange(480))
        rays = CAMERA.rays(np.stack([u, v], axis=-1))
        normal = np.cross(along, up)
        self.depth = (origin @ normal) / (rays @ normal)

    def at(self, shares: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(shares, self.arc, self.curve[:, d]) for d in range(3)], axis=1)


@pytest.fixture(scope="module")
def tilted() -> Tilted:
    return Tilted()


def matched(points: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Return the distances of points from the truth, in the better of both directions."""
    return min((np.linalg.norm(points - order, axis=1) for order in (true, true[::-1])), key=np.mean)


def test_equal_gaps_in_metres_are_the_material_points(tilted):
    true = tilted.at(np.linspace(0, 1, 20))
    pixels = one(ShapeDetector(Centerline(ends="tips")), tilted.rope.mask, tilted.depth)
    metres = one(ShapeDetector(Centerline(ends="tips", spacing="m")), tilted.rope.mask, tilted.depth)
    assert metres.valid.all()
    assert matched(metres.points3d, true).max() < 0.006
    assert gap_cv(metres.points3d) < 0.03
    assert gap_cv(pixels.points2d) < 0.01
    assert matched(pixels.points3d, true).max() > 0.02  # under tilt, equal pixels are other points of the rope
    assert gap_cv(metres.points2d) > 0.1


def test_millimetres_and_metres_of_any_float_agree(tilted):
    spec = Centerline(ends="tips", spacing="m")
    metres = one(ShapeDetector(spec), tilted.rope.mask, tilted.depth).points3d
    for depth in (
        tilted.depth.astype(np.float32),
        np.rint(tilted.depth * 1000).astype(np.uint16),
        tilted.depth[..., None],
    ):
        np.testing.assert_allclose(one(ShapeDetector(spec), tilted.rope.mask, depth).points3d, metres, atol=0.004)


def test_a_lens_is_taken_into_account(wave):
    camera = Intrinsics(320, 240, 200.0, 200.0, 159.5, 119.5, "brown_conrady", (-0.1, 0.02, 0, 0, 0))
    shape = one(ShapeDetector(), wave.mask, np.full((240, 320), 0.8), camera)
    np.testing.assert_allclose(camera.project(shape.points3d), shape.points2d, atol=1e-3)
    assert np.linalg.norm(shape.points3d[0, :2] / 0.8 - (shape.points2d[0] - (159.5, 119.5)) / 200) > 0.003


def test_radius_gives_the_axis_of_a_cylinder():
    """The scene is a cylinder of 10 mm radius at 0.6 m, rendered ray by ray."""
    radius, distance = 0.010, 0.6
    v, u = np.mgrid[:480, :640]
    rays = CAMERA.rays(np.stack([u, v], axis=-1))
    # the axis is y = 0.02, z = 0.6 and runs along x
    a, b = rays[..., 1] ** 2 + 1, rays[..., 1] * 0.02 + distance
    inside = b**2 - a * (0.02**2 + distance**2 - radius**2)
    x = rays[..., 0] * (b / a)
    mask = (inside > 0) & (np.abs(x) < 0.2)
    depth = np.where(mask, (b - np.sqrt(np.maximum(inside, 0))) / a, 0.75)
    surface = one(ShapeDetector(Centerline(ends="tips")), mask, depth).points3d
    axis = one(ShapeDetector(Centerline(ends="tips", radius=radius)), mask, depth).points3d
    np.testing.assert_allclose(axis[:, 2], distance, atol=1.5e-3)
    np.testing.assert_allclose(axis[:, 1], 0.02, atol=1e-3)
    np.testing.assert_allclose(surface[:, 2], distance - radius, atol=1.5e-3)
    np.testing.assert_allclose(np.linalg.norm(axis - surface, axis=1), radius, atol=1e-6)


def test_one_bad_pixel_moves_nothing(wave, intrinsics):
    depth = np.full(wave.mask.shape, 0.8)
    clean = one(ShapeDetector(), wave.mask, depth, intrinsics)
    for u, v in np.rint(clean.points2d).astype(int):
        depth[v, u] = 0.3  # a flying pixel right under each point
    speckled = one(ShapeDetector(), wave.mask, depth, intrinsics)
    np.testing.assert_allclose(speckled.points3d, clean.points3d)
    assert speckled.valid.all()


def test_the_table_under_a_rope_does_not_bleed_in(wave, intrinsics):
    depth = np.where(wave.mask > 0, 0.78, 0.80)
    np.testing.assert_allclose(one(ShapeDetector(), wave.mask, depth, intrinsics).points3d[:, 2], 0.78)


@pytest.mark.parametrize("nothing", [0.0, np.nan, np.inf, -2.0])
def test_a_hole_is_reported_and_never_filled_unasked(wave, intrinsics, nothing):
    depth = np.full(wave.mask.shape, 0.8)
    depth[:, 140:200] = nothing
    shape = one(ShapeDetector(Centerline(n=30)), wave.mask, depth, intrinsics)
    inside = (shape.points2d[:, 0] > 144) & (shape.points2d[:, 0] < 195)
    outside = (shape.points2d[:, 0] < 135) | (shape.points2d[:, 0] > 204)
    assert inside.sum() > 3
    assert np.isnan(shape.points3d[inside]).all()
    assert not shape.valid[inside].any()
    assert shape.valid[outside].all()
    assert shape.visible.all()
    assert shape.ok
    assert shape.quality < one(ShapeDetector(Centerline(n=30)), wave.mask, np.full((240, 320), 0.8), intrinsics).quality


def test_a_bridged_point_is_not_valid_though_the_rope_next_to_it_has_depth(wave, intrinsics):
    mask = wave.mask.copy()
    mask[:, 150:164] = 0
    shape = one(ShapeDetector(Centerline(n=200)), mask, np.full(mask.shape, 0.8), intrinsics)
    bridged = ~shape.visible
    assert bridged.sum() > 4
    assert not shape.valid[bridged].any()
    assert np.isnan(shape.points3d[bridged]).all()


class TestInvalidPoints:
    """A point without depth is filled by the policy, and stays invalid."""

    @pytest.fixture
    def frames(self, wave):
        slope = np.broadcast_to(np.linspace(0.7, 1.0, 320), (240, 320))
        hole = slope.copy()
        hole[:, 140:200] = 0
        return wave.mask, slope, hole

    def test_interpolate(self, frames, intrinsics):
        mask, slope, hole = frames
        shape = one(ShapeDetector(on_invalid="interpolate"), mask, hole, intrinsics)
        true = one(ShapeDetector(), mask, slope, intrinsics).points3d
        known = shape.valid
        assert 0 < (~known).sum() < 10
        np.testing.assert_allclose(shape.points3d[known], true[known], atol=5e-4)
        filled = shape.points3d[~known]
        np.testing.assert_allclose(filled, true[~known], atol=0.02)

    def test_interpolate_repeats_the_depth_at_the_ends(self, wave, intrinsics):
        depth = np.full((240, 320), 0.8)
        depth[:, :90] = 0
        shape = one(ShapeDetector(on_invalid="interpolate"), wave.mask, depth, intrinsics)
        assert not shape.valid[:2].any()
        np.testing.assert_allclose(shape.points3d, intrinsics.deproject(shape.points2d, np.full(20, 0.8)), atol=1e-6)

    def test_hold(self, frames, intrinsics):
        mask, slope, hole = frames
        detector = ShapeDetector(on_invalid="hold")
        before = one(detector, mask, slope, intrinsics).points3d
        for _ in range(3):
            shape = one(detector, mask, hole, intrinsics)
            np.testing.assert_array_equal(shape.points3d[~shape.valid], before[~shape.valid])
            assert (~shape.valid).any()


@pytest.mark.parametrize(("every", "valid"), [(3, True), (8, False)])
def test_a_point_needs_depth_under_a_quarter_of_its_pixels(intrinsics, every, valid):
    mask = np.zeros((240, 320), np.uint8)
    mask[110:126, 20:300] = 1
    depth = np.zeros(mask.shape, np.uint16)
    depth[:, ::every] = 700
    depth[:, :60] = 700
    shape = ShapeDetector(Centerline(n=9)).detect_mask(mask, depth, intrinsics).shapes[0]
    assert shape.valid[0]
    assert shape.valid[3:].all() == shape.valid[3:].any() == valid


def test_a_centre_outside_the_mask_is_not_valid_though_depth_lies_near_it(intrinsics):
    """A clusterer may put a centre between two strands."""
    mask = np.zeros((240, 320), np.uint8)
    mask[108:132, 10:310] = 1
    region = find_region(mask, Window(0, 0, 320, 240), 1, 0.0)
    curve = FittedCurve.through(np.stack([np.linspace(20, 300, 99), np.full(99, 120.0)], axis=1), np.zeros(99, bool))
    centres = np.array([[50.0, 120.0], [150.0, 134.5], [250.0, 120.0]])
    frame = Frame(None, np.full(mask.shape, 0.7), CameraModel(intrinsics))
    found = Fit(curve, 1.0, observed=region, object_width=region.width, centres=centres)
    scene = Scene.in_image(frame, Clock(), mask.shape, None)
    shape = shape_of(Centerline(n=3), found, scene, None, "nan", 1)
    assert shape.visible.tolist() == [True, False, True]
    assert shape.valid.tolist() == [True, False, True]


@compiled("(i8[:,::1], i8, " + DEPTH_TYPE + ", f8, f8, f8[:,::1])")
def cells(runs, edge, depth, focal, width, expected):
    return gather_lifted_cells(runs, edge, depth, focal, width, expected)


@pytest.mark.parametrize("apart", [0.0, 0.2])
def test_strands_that_share_a_square_are_gathered_apart_in_depth(apart):
    """The left half of each square of 8 pixels lies at 1 m, and its right half so much farther."""
    runs = np.array([[row, 0, 64] for row in range(16)])
    depth = np.full((16, 64), 1.0, np.float32)
    depth[:, np.arange(64) % 8 >= 4] += apart
    nodes = np.array(
        [[4.0 + 8 * k, 8.0, log_depth] for k in range(8) for log_depth in (0.0, 300 * np.log(1.0 + apart))]
    )
    points, weight = cells(runs, 8, depth_images(depth), 300.0, 4.0, nodes)
    assert weight.sum() == runs.shape[0] * 64
    assert len(points) == 16 * (2 if apart else 1)
    assert set(np.round(np.exp(points[:, 2] / 300), 3)) == ({1.0, 1.2} if apart else {1.0})
