"""Cameras on a sheet: compared with the truth and with each other, flat, lifted, bunched and folded."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, cast

import cv2
import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("mujoco")

from simulator_gl import RENDERERS

import shape_obs_envs  # noqa: F401
from shape_obs_envs.mujoco.cameras.rasterizer import draw_triangles
from shape_obs_envs.mujoco.cloth import ClothEnv

SIZES = {"square": [84, 84], "d455": "d455"}
Move = tuple[list[float], int]
SHAPES: dict[str, list[Move]] = {
    "flat": [],
    "lifted": [([0, 0, 1, 0, 0, 0.6], 8)],
    "bunched": [([1, 0, 0.5, -1, 0, 0.5], 14)],
    "sheared": [([0.5, -1, 0.5, 0.5, 0.5, 0], 10)],
    "folded": [([0, -1, 0.2, 0, -1, 0.2], 24)],
}


def make(**options: Any) -> ClothEnv:
    return cast(ClothEnv, gym.make("ShapeObs/Cloth-v0", **{"camera": [84, 84], **options}).unwrapped)


def views(env: ClothEnv) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yield the name, picture and depth in metres of each shape."""
    for seed, (name, moves) in enumerate(SHAPES.items()):
        env.np_random = np.random.default_rng(seed)
        env._target = env._draw_start()
        for move, steps in moves:
            for _ in range(steps):
                env._move(np.array(move, np.float64))
        yield name, *env._rendering.capture(env._body)


def cloth(env: ClothEnv, rgb: np.ndarray) -> np.ndarray:
    rule = env.shape_obs_defaults["segmentation"]
    low, high = (np.array(rule[key], np.uint8) for key in ("low", "high"))
    return cv2.inRange(cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV), low, high) > 0


def grown(mask: np.ndarray, by: int = 1) -> np.ndarray:
    return cv2.dilate(mask.astype(np.uint8), np.ones((2 * by + 1,) * 2, np.uint8)) > 0


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("renderer", RENDERERS)
def test_the_mask_is_the_true_sheet(renderer, size):
    env = make(camera=SIZES[size], renderer=renderer)
    for name, rgb, depth in views(env):
        mask = cloth(env, rgb)
        filled = np.zeros(mask.shape, np.uint8)
        places = env.camera_model.project_from_base(env._sheet.vertices().reshape(-1, 3))
        for face in np.rint(places[env._sheet.mesh.grid.faces] * 16).astype(np.int32):
            cv2.fillConvexPoly(filled, face, 1, shift=4)
        assert not (mask & ~grown(filled > 0)).any(), name
        gripper = rgb.max(axis=2) < 75
        # a held corner that is seen edge on is thinner than a pixel
        assert np.count_nonzero((filled > 0) & ~grown(mask) & ~grown(gripper, 2)) <= 4, name
        if env.unfolded:
            # of each true point the mask has a pixel within one, the held corners too: no gripper hides them
            at = np.rint(env.truth(13, 25, frame="pixels")).astype(int)
            assert grown(mask)[at[:, 1], at[:, 0]].all(), name
        if name == "folded":
            assert len(np.unique(rgb[mask], axis=0)) > 20, "without shading a fold is not to be seen"
        table = ~grown(mask | gripper, 2)
        v, u = np.nonzero(table)
        points = env.camera_model.to_base(env.camera_model.intrinsics.deproject(np.stack([u, v], 1), depth[v, u]))
        assert np.abs(points[:, 2]).max() < 5e-4, name
    env.close()


def test_triangles_are_drawn_by_pixel_centres_and_the_nearest_wins():
    places = np.array([[1.0, 1], [6, 1], [1, 6], [0, 0], [7, 0], [0, 7], [3, 3], [3, 3], [4, 4]])
    depth = np.array([2.0, 2, 2, 1, 3, 3, 1, 1, 1])
    faces = np.array([[0, 1, 2], [3, 5, 4], [6, 7, 8]])  # the second turned over, the third seen edge on
    drawn = draw_triangles(places, depth, faces, (6, 6))
    u, v = drawn.pixels % 6, drawn.pixels // 6
    assert len(np.unique(drawn.pixels)) == len(drawn.pixels)
    assert set(zip(u.tolist(), v.tolist(), strict=True)) == {(i, j) for i in range(6) for j in range(6) if i + j <= 7}
    # on the second triangle 1 / z falls from 1 to a third over seven pixels of u + v
    inverse = 1 - (2 / 3) * (u + v) / 7
    second = (inverse >= 0.5) | (u < 1) | (v < 1)
    assert np.array_equal(drawn.faces == 1, second)
    assert np.allclose(drawn.depth, np.where(second, 1 / inverse, 2.0))
    assert np.allclose(drawn.shares.sum(axis=1), 1)
    # shares are those in space: of the vertices' depths they make the depth
    assert np.allclose(np.einsum("pk,pk->p", drawn.shares, depth[faces[drawn.faces]]), drawn.depth)
    none = draw_triangles(places + 100, depth, faces, (6, 6))
    assert len(none.pixels) == 0
