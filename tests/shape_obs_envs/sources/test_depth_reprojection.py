"""Reprojection of depth: the compiled loop gives the pixels of an independent NumPy implementation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy_reprojection import reproject  # pyright: ignore[reportMissingImports]

from shape_obs import Intrinsics
from shape_obs_envs.sources.realsense.driver import d455_geometry
from shape_obs_envs.sources.registration import DepthReprojection, check_pose

D455 = d455_geometry(640, 480, 0.001)
POSE = D455.rotation, D455.translation


def noisy_plane(camera: Intrinsics) -> np.ndarray:
    """Return the depth in millimetres of a tilted plane with noise, a block in front, holes and outliers."""
    rng = np.random.default_rng(3)
    rays = camera.rays(np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1))
    normal = np.array([np.sin(np.radians(10)), 0, np.cos(np.radians(10))])
    depth = np.rint(620 * normal[2] / (rays @ normal)).astype(np.uint16) + rng.normal(0, 3, camera.size)
    depth[100:200, 300:400] -= 200
    depth = depth.astype(np.uint16)
    depth[rng.random(camera.size) < 0.05] = 0
    depth[rng.random(camera.size) < 0.01] = rng.integers(1, 65536)
    depth[0, :20] = np.arange(20)
    depth[1, :2] = 65535
    return depth


@pytest.mark.parametrize("size", [(640, 480), (1280, 720)])
def test_the_compiled_loop_gives_the_pixels_of_numpy(size: tuple[int, int]) -> None:
    target = replace(
        D455.colour, width=size[0], height=size[1], fx=600.0 * size[1] / 720, cx=size[0] / 2, cy=size[1] / 2,
        model="pinhole", coeffs=(0.0,) * 5,
    )  # fmt: skip
    metres = np.multiply(noisy_plane(D455.depth), np.float32(0.001), dtype=np.float32)
    compiled = DepthReprojection(D455.depth, target, *POSE, 0.001)(metres)
    assert (compiled == reproject(metres, D455.depth, target, *check_pose(*POSE))).all()
    assert (compiled > 0).mean() > 0.4


def test_the_identity_changes_nothing() -> None:
    depth = noisy_plane(D455.depth)
    metres = np.multiply(depth, np.float32(0.001), dtype=np.float32)
    same = DepthReprojection(D455.depth, D455.depth, np.eye(3), np.zeros(3), 0.001)(metres)
    alone = np.ones_like(depth, bool)  # the margin lets nearer neighbours reach one pixel over
    for rows, columns in ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)):
        moved = np.roll(depth, (rows, columns), axis=(0, 1))
        alone &= (moved >= depth) | (moved == 0)
    alone &= (depth > 0) & (depth < 65535)
    assert alone.mean() > 0.05
    assert (same[alone] == depth[alone]).all()


def test_a_target_with_distortion_is_refused() -> None:
    with pytest.raises(ValueError, match="DepthReprojection: expected a target without distortion"):
        DepthReprojection(D455.depth, D455.colour, *POSE, 0.001)
