"""The picture of 'Wrap your env': uv run python docs/pictures/foreign.py, after MUJOCO_GL=egl where no display is."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from sheet import grid, titled
from stages import write

from shape_obs import Centerline, HSVRange, ShapeObservation
from shape_obs.drawing import draw_detection

sys.path.append(str(Path(__file__).parents[2] / "examples"))

from foreign_env import make_env as swimmer
from foreign_env import stroke
from foreign_env_depth import RGBDCamera

TABLE_FROM_ABOVE = {"lookat": [0.0, 0.0, 0.0], "distance": 0.65, "azimuth": 90.0, "elevation": -90.0}
MIDDLE = slice(70, 410)


def reacher() -> ShapeObservation:
    """Two blue links, from the joint at the origin to the green fingertip."""
    size: dict[str, Any] = {"width": 320, "height": 240}
    env = gym.make("Reacher-v5", render_mode="rgbd_tuple", camera_id=-1, default_camera_config=TABLE_FROM_ABOVE, **size)
    return ShapeObservation(
        RGBDCamera(env),
        shapes=[Centerline(n=9, ends="tips", radius=0.01, anchor=(0, 0, 0.01))],
        segmentation=HSVRange(low=(95, 100, 40), high=(115, 255, 255)),
        features=[{"kind": "points3d", "frame": "base"}, "ok"],
    )


def swing(step: int) -> np.ndarray:
    """An action of the Reacher: it bends while it turns."""
    return np.array([0.1, 0.15 * np.cos(step / 6)], np.float32)


def pictures(make_env: Callable[[], ShapeObservation], act: Any, steps: tuple[int, ...]) -> list[np.ndarray]:
    """What was found in some frames of an episode."""
    gc.collect()  # Gymnasium's renderer serves one env a process; what is left of the last one would spoil the next
    env, out = make_env(), []
    env.reset(seed=0)
    for step in range(steps[-1] + 1):
        if step in steps:
            assert env.detection is not None
            image = env.unwrapped.render()
            rgb = image[0] if isinstance(image, tuple) else image
            out.append(draw_detection(np.ascontiguousarray(rgb), env.detection, scale=2, size=1.5)[MIDDLE])
        env.step(act(step))
    env.close()
    return out


if __name__ == "__main__":
    rows = {"Swimmer": pictures(swimmer, stroke, (0, 25)), "Reacher": pictures(reacher, swing, (0, 25))}
    panels = [
        titled(picture, f"{name}, step {step}", 20)
        for name, row in rows.items()
        for step, picture in zip((0, 25), row, strict=True)
    ]
    write("foreign_envs.jpg", grid(panels, 2))
