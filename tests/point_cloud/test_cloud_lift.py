"""Clouds under masks (``lift="cloud"``), clouds as observed geometry, and samples of their claims."""

from __future__ import annotations

import numpy as np
import pytest

from shape_obs import Centerline, Intrinsics, ShapeDetector
from shape_obs.geometry.polyline import resample
from shape_obs.image.find_region import find_region
from shape_obs.image.roi import Window
from shape_obs.point_cloud.deprojection import deproject
from tests.scenes.images import CAMERA, tilted_rope
from tests.scenes.tangles import crossing_rope


class TestUnderAMask:
    """Detection with ``lift="cloud"``."""

    def test_pixels_are_the_projection(self):
        rope = tilted_rope(np.random.default_rng(3))
        detector = ShapeDetector(Centerline(ends="tips", lift="cloud"))
        shape = detector.detect_mask(rope.mask, rope.depth, CAMERA).shapes[0]
        assert shape.ok
        assert shape.points3d is not None
        projected = CAMERA.project(shape.points3d[shape.valid])
        np.testing.assert_allclose(shape.pixels[shape.valid], projected, atol=0.01)

    @pytest.mark.parametrize("seed", [2, 9, 14, 17])
    def test_a_rope_that_crosses_itself_is_traced_in_the_image(self, seed):
        rng = np.random.default_rng(seed)
        tangle = crossing_rope(rng, 1 + seed % 2)
        rays = CAMERA.rays(np.stack(np.meshgrid(np.arange(640), np.arange(480)), axis=-1).astype(float))
        leaning = 0.9 / (rays @ (0.3, -0.5, 1.0))
        depth = leaning + rng.normal(0, 0.0015, leaning.shape)
        detector = ShapeDetector(Centerline(n=40, ends="tips", lift="cloud"))
        shape = detector.detect_mask(tangle.mask, depth, CAMERA).shapes[0]
        assert shape.ok, shape.reason
        rays = CAMERA.rays(tangle.curve)
        true = resample(rays * (0.9 / (rays @ (0.3, -0.5, 1.0)))[:, None], 40)
        gap = np.linalg.norm(np.diff(true, axis=0), axis=1).mean()
        assert shape.points3d is not None
        apart = [np.linalg.norm(shape.points3d - order, axis=1)[shape.valid] for order in (true, true[::-1])]
        assert min(distance.max() for distance in apart) < 0.5 * gap

    @pytest.mark.parametrize("given_arguments", [{}, {"camera": CAMERA}, {"depth": np.ones((480, 640))}])
    def test_it_needs_depth_and_a_camera(self, given_arguments):
        mask = tilted_rope(np.random.default_rng(3)).mask
        with pytest.raises(ValueError, match="lift='cloud' needs depth and a camera; give both, or lift='points'"):
            ShapeDetector(Centerline(lift="cloud")).detect_mask(mask, **given_arguments)

    def test_no_depth_is_a_reason(self):
        mask = tilted_rope(np.random.default_rng(3)).mask
        shape = ShapeDetector(Centerline(lift="cloud")).detect_mask(mask, np.zeros((480, 640)), CAMERA).shapes[0]
        assert (shape.ok, shape.reason) == (False, "the cloud is empty")
        assert (
            ShapeDetector(Centerline(lift="cloud")).detect_mask(mask * 0, np.ones((480, 640)), CAMERA).shapes[0].reason
        )

    def test_a_hole_in_the_depth_is_visible_and_not_valid(self, wave, intrinsics):
        depth = np.full((240, 320), 0.8)
        depth[:, 130:190] = 0
        shape = ShapeDetector(Centerline(n=40, lift="cloud")).detect_mask(wave.mask, depth, intrinsics).shapes[0]
        assert shape.ok, shape.reason
        inside = (shape.pixels[:, 0] > 150) & (shape.pixels[:, 0] < 170)
        outside = (shape.pixels[:, 0] < 125) | (shape.pixels[:, 0] > 195)
        assert inside.any()
        assert not shape.valid[inside].any()
        assert shape.visible[inside].all()
        assert shape.valid[outside].all()

    def test_a_pixel_and_a_base_frame_point_are_anchors(self, wave, overhead):
        depth = np.full((240, 320), 0.8)
        for end in ((50.0, 140.0), (270.0, 112.0)):
            x, y, z = (float(value) for value in overhead.to_base(overhead.intrinsics.deproject(end, 0.8)))
            for anchor in (end, (x, y, z)):
                detector = ShapeDetector(Centerline(ends="tips", lift="cloud", anchor=anchor))
                first = detector.detect_mask(wave.mask, depth, overhead).shapes[0].pixels[0]
                np.testing.assert_allclose(first, end, atol=5)


def test_depth_that_flies_between_the_object_and_the_table_is_no_part_of_the_cloud():
    """Depth cameras report values in between at an edge: here one pixel in ten, up to 0.2 m off."""
    mask, rng = np.zeros((240, 320), np.uint8), np.random.default_rng(0)
    mask[100:140, 20:300] = 1
    depth = 0.7 + 0.0005 * np.arange(320) + rng.normal(0, 0.0005, mask.shape)  # a slope and noise stay
    slope = depth.copy()
    flying = rng.random(mask.shape) < 0.1
    depth[flying] += rng.uniform(0.02, 0.2, np.count_nonzero(flying))
    region = find_region(mask, Window(0, 0, 320, 240), 1, 0.0)
    cloud = deproject(region, depth, Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5))
    u, v = cloud.intrinsics.project(cloud.points).round().astype(int).T
    np.testing.assert_allclose(cloud.points[:, 2], slope[v, u], atol=1e-9)
    assert len(cloud.points) > 4000
