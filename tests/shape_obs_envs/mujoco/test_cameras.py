"""Cameras of the simulated environments: compared with the truth and with each other, with and without OpenGL."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from typing import Any, cast

import cv2
import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("mujoco")

from simulator_gl import RENDERERS

import shape_obs_envs  # noqa: F401
from shape_obs_envs.mujoco import cameras
from shape_obs_envs.mujoco.cable import CableEnv
from shape_obs_envs.mujoco.cameras.rasterizer import draw_triangles
from shape_obs_envs.mujoco.cloth import ClothEnv

SIZES = {"square": [84, 84], "d455": "d455"}
NO_GL = """
import ctypes, os
for name in ("MUJOCO_GL", "PYOPENGL_PLATFORM", "DISPLAY", "WAYLAND_DISPLAY"):
    os.environ.pop(name, None)
class Hidden(ctypes.CDLL):
    def __init__(self, name, *args, **kwargs):
        if name and any(word in str(name) for word in ("libEGL", "libOSMesa", "libGL")):
            raise OSError(f"{name}: cannot open shared object file")
        super().__init__(name, *args, **kwargs)
ctypes.CDLL = Hidden
"""


def make(**kwargs: Any) -> CableEnv:
    return cast(CableEnv, gym.make("ShapeObs/Cable-v0", **{"camera": [84, 84], **kwargs}).unwrapped)


def views(env, seeds=3):
    """Play a few bent shapes, and yield picture and depth in metres after each."""
    rng = np.random.default_rng(0)
    for seed in range(seeds):
        env.reset(seed=seed)
        action = rng.uniform(-1, 1, 6)
        for _ in range(15):
            env._move(action)
        yield env._rendering.capture(env._body)


def blue(env, rgb):
    rule = env.shape_obs_defaults["segmentation"]
    low, high = (np.array(rule[key], np.uint8) for key in ("low", "high"))
    return cv2.inRange(cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV), low, high) > 0


def grown(mask, by=1):
    return cv2.dilate(mask.astype(np.uint8), np.ones((2 * by + 1,) * 2, np.uint8)) > 0


def run(code, tmp_path, **environment):
    kept = {k: v for k, v in os.environ.items() if k != "MUJOCO_GL"}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, timeout=100, capture_output=True, text=True, env=kept | environment
    )
    assert done.returncode == 0, done.stderr
    assert not list(tmp_path.iterdir()), "something was left behind"
    return done.stdout + done.stderr


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("renderer", RENDERERS)
def test_mask_is_the_true_rope(renderer, size):
    env = make(camera=SIZES[size], renderer=renderer)
    k = env.camera_model.intrinsics
    for rgb, _ in views(env):
        mask = blue(env, rgb)
        pixels, z = env.truth(400, frame="pixels"), env.truth(400, frame="camera")[:, 2].mean()
        assert np.isin(np.rint(pixels).astype(int) @ [1, k.width], np.flatnonzero(grown(mask))).all()
        vv, uu = np.nonzero(mask)
        away = np.sqrt(((np.stack([uu, vv], 1)[:, None] - pixels) ** 2).sum(-1).min(1))
        assert away.max() < k.fx * 0.008 / z * 1.15 + 0.8
        # the mask reaches the tips: nothing of the gripper covers them
        corners = np.rint(env.truth(30, frame="pixels")[[1, -2]]).astype(int)
        assert mask[corners[:, 1], corners[:, 0]].all()
        area = k.fx**2 / z**2 * 0.5 * 0.016
        assert mask.sum() == pytest.approx(area, rel=0.12)
    env.close()


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("renderer", RENDERERS)
def test_depth_is_the_true_surface(renderer, size):
    env = make(camera=SIZES[size], renderer=renderer)
    camera = env.camera_model
    v, u = np.mgrid[: camera.intrinsics.height, : camera.intrinsics.width]
    for rgb, depth in views(env):
        assert depth.dtype == np.float32
        points = camera.to_base(camera.intrinsics.deproject(np.stack([u, v], -1).reshape(-1, 2), depth.ravel()))
        table = ~grown((rgb.max(axis=2) < 150) | blue(env, rgb), 2)
        assert np.abs(points[table.ravel(), 2]).max() < 1e-3
        rope = points[blue(env, rgb).ravel()]
        assert rope[:, 2].max() < 0.0165
        axis = env.truth(501)[8:-8]  # without the 8 mm of the round caps
        distance = np.sqrt(((rope[:, None] - axis) ** 2).sum(-1).min(1))
        assert np.abs(distance - 0.008).max() < 1e-3
        millimetres = env._observe()["depth"]
        assert np.abs(millimetres / 1000 - depth).max() <= 0.000501
    env.close()


# ---- a sheet

Move = tuple[list[float], int]
SHAPES: dict[str, list[Move]] = {
    "flat": [],
    "lifted": [([0, 0, 1, 0, 0, 0.6], 8)],
    "bunched": [([1, 0, 0.5, -1, 0, 0.5], 14)],
    "sheared": [([0.5, -1, 0.5, 0.5, 0.5, 0], 10)],
    "folded": [([0, -1, 0.2, 0, -1, 0.2], 24)],
}


def sheets(env: ClothEnv) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yield the name, picture and depth in metres of each shape."""
    for seed, (name, moves) in enumerate(SHAPES.items()):
        env.np_random = np.random.default_rng(seed)
        env._target = env._draw_start()
        for move, steps in moves:
            for _ in range(steps):
                env._move(np.array(move, np.float64))
        yield name, *env._rendering.capture(env._body)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("renderer", RENDERERS)
def test_the_mask_is_the_true_sheet(renderer, size):
    env = cast(ClothEnv, gym.make("ShapeObs/Cloth-v0", camera=SIZES[size], renderer=renderer).unwrapped)
    for name, rgb, depth in sheets(env):
        mask = blue(env, rgb)
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


# ---- the choice of a renderer


def test_camera_is_the_d455():
    k = make(camera="d455").camera_model.intrinsics
    assert (k.width, k.height, k.fx, k.fy, k.cx, k.cy) == (640, 480, 386.0, 386.0, 319.5, 239.5)
    small = make(camera=[84, 84]).camera_model
    assert small.intrinsics.fx == pytest.approx(386 * 84 / 480)
    assert np.allclose(small.project_from_base(np.zeros((1, 3))), 41.5)
    transform = small.transform_camera_to_base
    assert transform is not None
    assert 0.5 < transform[2, 3] < 0.6
    assert np.degrees(np.arccos(-transform[2, 2])) == pytest.approx(10)
    assert np.allclose(transform[:3, :3] @ transform[:3, :3].T, np.eye(3))
    assert np.linalg.det(transform[:3, :3]) == pytest.approx(1)


FORK = """
import os
import gymnasium as gym, numpy as np, shape_obs_envs
names = ("MUJOCO_GL", "LP_NUM_THREADS")
before = [os.environ.get(name) for name in names]
action = np.full((2, 6), 0.5, np.float32)
one = gym.make("ShapeObs/Cable-v0")
one.reset(seed=1)
picture = one.step(action[0])[0]["rgb"]
envs = gym.make_vec("ShapeObs/Cable-v0", num_envs=2, vectorization_mode="async", vector_kwargs={"context": "fork"})
envs.reset(seed=[1, 2])
assert np.array_equal(envs.step(action)[0]["rgb"][0], picture)
envs.close()
pid = os.fork()
if pid == 0:  # the environment itself, inherited
    one.step(action[0])
    one.close()
    os._exit(0)
assert os.waitpid(pid, 0)[1] == 0
one.step(action[0])
assert [os.environ.get(name) for name in names] == before
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_rendering_goes_on_in_forked_workers(tmp_path):
    # The environment is left open: the process must end quietly all the same.
    assert "Error" not in run(FORK, tmp_path)


def test_auto_falls_back_on_rays_and_says_so_once(tmp_path):
    code = (
        NO_GL
        + """
import logging
logging.basicConfig(level=logging.INFO)
import gymnasium as gym, numpy as np, shape_obs_envs
envs = [gym.make("ShapeObs/Cable-v0", camera=[84, 84], renderer=r).unwrapped for r in ("auto", "auto", "rays")]
frames = [env.reset(seed=0)[0]["rgb"] for env in envs]
assert all(np.array_equal(frame, frames[2]) for frame in frames)
assert envs[0]._rendering.camera_name == "rays"
try:
    gym.make("ShapeObs/Cable-v0", renderer="gl").reset()
except RuntimeError as error:
    assert 'pass renderer="rays"' in str(error), error
else:
    raise SystemExit("GL was not hidden")
"""
    )
    assert run(code, tmp_path).count("Rendering with rays, which is slower: OpenGL is not available") == 1


@pytest.mark.parametrize(
    ("wish", "message"),
    [("disable", "MUJOCO_GL=disable turns OpenGL off"), ("osmesa", "osmesa: libOSMesa.so.8 is not installed")],
)
def test_mujoco_gl_is_obeyed(tmp_path, wish, message):
    code = (
        NO_GL
        + """
os.environ["MUJOCO_GL"], before = "WISH", os.environ.get("PYOPENGL_PLATFORM")
import gymnasium as gym, shape_obs_envs
env = gym.make("ShapeObs/Cable-v0", camera=[84, 84]).unwrapped
env.reset(seed=0)
assert env._rendering.camera_name == "rays"
assert os.environ["MUJOCO_GL"] == "WISH"
assert os.environ.get("PYOPENGL_PLATFORM") == before
"""
    )
    assert message in run(code.replace("WISH", wish), tmp_path)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="variables of Linux")
@pytest.mark.parametrize(
    "variable",
    ["MUJOCO_GL=vulkan", "MUJOCO_EGL_DEVICE_ID=0,1", "MUJOCO_EGL_DEVICE_ID=GPU-8f2e", "MUJOCO_EGL_DEVICE_ID=",
     "PYOPENGL_PLATFORM=glx"],
)  # fmt: skip
def test_a_variable_that_stops_opengl_is_named_and_auto_falls_back_on_rays(variable, monkeypatch, caplog):
    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.setenv(*variable.split("="))
    monkeypatch.setattr(cameras, "_no_gl", [])
    monkeypatch.setattr(cameras, "_logged", set())
    with pytest.raises(RuntimeError, match=f'renderer="gl": .*{variable}: expected'):
        make(renderer="gl").reset(seed=0)
    env = make(renderer="auto")
    env.reset(seed=0)
    assert env._rendering.camera_name == "rays"
    assert f"{variable}: expected" in caplog.text
