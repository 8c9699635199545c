"""Compare Gymnasium's envs with their simulator's truth as JSON, in a separate process for OpenGL.

Run by test_foreign_envs.py; on Linux without a display with MUJOCO_GL=egl.
"""

# ruff: noqa: E402

from __future__ import annotations

import gc
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "examples"), str(ROOT / "docs" / "pictures")]

import foreign  # pyright: ignore[reportMissingImports]
import foreign_env  # pyright: ignore[reportMissingImports]
import foreign_env_depth  # pyright: ignore[reportMissingImports]

from shape_obs import CameraModel, ShapeObservation

Array = npt.NDArray[np.float64]

STEPS = 30
# Bodies, and places on their x axes: the nose, the joints, the tail. Rounded tips included.
SWIMMER = (("torso", 1.6), ("torso", 0.5), ("mid", -1.0), ("back", -1.1))
# What can be seen of the blue links: from the edge of the cylinder at the root to where the fingertip's sphere begins.
REACHER = (("body0", 0.011), ("body1", 0.0), ("body1", 0.105))


def joints(data: Any, chain: tuple[tuple[str, float], ...]) -> Array:
    """Return the positions of the chain in the world frame, (J, 3) metres."""
    return np.array([data.body(name).xpos + x * data.body(name).xmat.reshape(3, 3)[:, 0] for name, x in chain])


def spread(corners: Array, n: int) -> Array:
    """Return n equidistant points along a polyline, (n, 3)."""
    arc = np.append(0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1)))
    return np.stack([np.interp(np.linspace(0, arc[-1], n), arc, axis) for axis in corners.T], axis=1)


def follow(
    make_env: Callable[[], ShapeObservation],
    act: Callable[[int], Any],
    chain: tuple[tuple[str, float], ...],
    camera: CameraModel | None = None,
) -> dict[str, Any]:
    """Return the distances of the points from their true positions along the simulator's chain over an episode."""
    gc.collect()  # Gymnasium's renderer serves one env a process; what is left of the last one would spoil the next
    env = make_env()
    camera = camera or env.get_wrapper_attr("camera_model")
    assert camera is not None
    pixels, metres, ok = [], [], []
    n = env.detector.shapes[0].layout.size
    _, info = env.reset(seed=0)
    for step in range(STEPS):
        _, _, _, _, info = env.step(act(step))
        assert env.detection is not None
        shape = env.detection.shapes[0]
        truth = spread(joints(env.get_wrapper_attr("data"), chain), n)
        ok.append(info["shape/ok"] and bool(shape.valid.all()))
        pixels.append(np.linalg.norm(shape.pixels - camera.project_from_base(truth), axis=1))
        if shape.points3d is not None:
            metres.append(np.linalg.norm(camera.to_base(shape.points3d) - truth, axis=1))
    env.close()
    out = {"ok": all(ok), "pixels": np.mean(pixels), "worst_pixels": np.max(pixels)}
    return out | ({"metres": np.mean(metres), "worst_metres": np.max(metres)} if metres else {})


def main() -> None:
    above = foreign_env_depth.make_env().get_wrapper_attr("camera_model")  # the colour env's too
    measured = {
        "rgb": follow(foreign_env.make_env, foreign_env.stroke, SWIMMER, above),
        "rgbd": follow(foreign_env_depth.make_env, foreign_env.stroke, SWIMMER),
        "reacher": follow(foreign.reacher, foreign.swing, REACHER),
    }
    print(json.dumps(measured, default=float))


if __name__ == "__main__":
    main()
