"""The pictures of the simulated environments: uv run --extra sim python docs/pictures/envs.py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import gymnasium as gym
import numpy as np

import shape_obs_envs  # noqa: F401
from shape_obs import ShapeObservation
from shape_obs.drawing import HIDDEN, VALID, draw_curve, draw_text
from shape_obs.utils.arrays import write_gif, write_image

IMAGES = Path(__file__).parent.parent / "images"
GOAL, FIRST, PAPER = (235, 130, 40), (20, 20, 20), 6
ROWS, COLS = slice(75, 375), slice(120, 520)  # where things happen, of 640 x 480
ALL_ROWS = slice(40, 430)  # of several ropes
ENVS: dict[str, tuple[str, dict[str, Any]]] = {
    "cable": ("ShapeObs/Cable-v0", {}),
    "cable, one gripper": ("ShapeObs/Cable-v0", {"grippers": 1}),
    "cables": ("ShapeObs/Cables-v0", {}),
    "ring": ("ShapeObs/Ring-v0", {}),
    "cloth": ("ShapeObs/Cloth-v0", {}),
    "hanging": ("ShapeObs/Hanging-v0", {}),
}
DIFFICULTIES = ("near", "middle", "far")
IDLE = 8
EPISODES = (("cable", "far"), ("cables", "middle"), ("ring", "far"), ("cloth", "middle"), ("hanging", "far"))


def make(name: str, **options: Any) -> ShapeObservation:
    """The wrapped environment, drawn by rays, which look the same on every machine."""
    env_id, arguments = ENVS[name]
    return ShapeObservation(
        gym.make(env_id, camera="d455", renderer="rays", render_mode="rgb_array", **arguments, **options)
    )


def goal_lines(env: ShapeObservation) -> list[np.ndarray]:
    """The goal's true points as lines (K, 2) in pixels: along the rope, around the outline, or the lattice's border."""
    inner: Any = env.unwrapped
    points = inner.camera_model.project_from_base(inner._goal.reshape(-1, 3).astype(np.float64))
    layout = inner.goal_layout
    if layout["kind"] == "centerline":
        return np.split(points, layout.get("count", 1))
    if layout["kind"] == "contour":
        return [np.concatenate([points, points[:1]])]
    lattice = points.reshape(layout["rows"], layout["cols"], 2)
    return [lattice[0], lattice[-1], lattice[:, 0], lattice[:, -1]]


def frame(env: ShapeObservation, text: str) -> np.ndarray:
    """The camera's picture with the goal and the points that were found, or the true ones; the first one ringed."""
    canvas: Any = env.render()
    for line in goal_lines(env):
        draw_curve(canvas, line, GOAL, thickness=2)
    inner: Any = env.unwrapped
    several = hasattr(inner, "crossings")
    if several:
        pixels = inner.truth(frame="pixels")
        draw_points(canvas, pixels, np.full(len(pixels), True))
    elif env.detection is not None:
        shape = env.detection.shapes[0]
        draw_points(canvas, shape.pixels, shape.valid)
    canvas = np.ascontiguousarray(canvas[ALL_ROWS if several else ROWS, COLS])
    draw_text(canvas, text, (10, 22))
    return canvas


def draw_points(canvas: np.ndarray, pixels: np.ndarray, valid: np.ndarray) -> None:
    """Draw points (N, 2) in pixels, in green where they are valid, the first one ringed."""
    places = np.rint(pixels).astype(int).tolist()
    for point, good in zip(places, valid.tolist(), strict=True):
        cv2.circle(canvas, point, 4, (255, 255, 255), -1, cv2.LINE_AA)
        cv2.circle(canvas, point, 3, VALID if good else HIDDEN, -1, cv2.LINE_AA)
    cv2.circle(canvas, places[0], 8, FIRST, 2, cv2.LINE_AA)


def episode(name: str, difficulty: str, seed: int) -> list[np.ndarray]:
    """The motion that leads to the goal, as the wrapper sees it."""
    env = make(name, difficulty=difficulty)
    env.reset(seed=seed)
    inner: Any = env.unwrapped
    idle = np.zeros((IDLE, *inner.action_space.shape), np.float32)
    frames, info = [], {}
    for action in np.concatenate([inner.goal_actions, idle]):
        info = env.step(action)[-1]
        frames.append(frame(env, f"{1e3 * info['truth/mean_error']:.0f} mm from the goal"))
    env.close()
    return frames + frames[-1:] * 10


def sheet() -> np.ndarray:
    """Start and goal of every environment at every difficulty."""
    rows = []
    for name in ENVS:
        cells = []
        for difficulty in DIFFICULTIES:
            env = make(name, difficulty=difficulty)
            _, info = env.reset(seed=4)
            text = f"{name}: {difficulty}, {1e3 * info['truth/mean_error']:.0f} mm"
            cells.append(np.pad(frame(env, text), ((0, PAPER), (0, PAPER), (0, 0)), constant_values=255))
            env.close()
        rows.append(np.concatenate(cells, axis=1))
    return np.concatenate(rows)[:-PAPER, :-PAPER]


def main() -> None:
    """Write them all."""
    write_image(IMAGES / "envs_sheet.jpg", sheet())
    for name, difficulty in EPISODES:
        write_gif(IMAGES / f"env_{name}.gif", episode(name, difficulty, seed=2)[::2], 0.1)


if __name__ == "__main__":
    main()
