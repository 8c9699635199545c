"""The pictures of the simulated environments: uv run --extra sim python docs/pictures/envs.py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import gymnasium as gym
import numpy as np
from sheet import FIRST_KEY, GOAL_KEY, Key, band, legend, save, width_of, write_text

import shape_obs_envs  # noqa: F401
from shape_obs import ShapeObservation
from shape_obs.drawing import GOAL, HIDDEN, VALID, draw_curve, draw_point
from shape_obs.utils.arrays import write_gif

IMAGES = Path(__file__).parent.parent / "images"
FIRST, PAPER = (20, 20, 20), 6
LETTERS = 20  # pixels, in the sheet
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
# Examples in which far goals are farther than middle ones, which single goals of a difficulty need not be.
SEEDS = {"cable": 3, "cable, one gripper": 26, "cables": 33, "ring": 12, "cloth": 5, "hanging": 6}
MARGIN = 34  # pixels around everything in a row of the sheet
KEYS = (Key("point", VALID), FIRST_KEY, GOAL_KEY)
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


def frame(env: ShapeObservation) -> np.ndarray:
    """The camera's picture with the goal and the points that were found, or the true ones; the first one ringed."""
    canvas: Any = env.render()
    for line in goal_lines(env):
        draw_curve(canvas, line, GOAL, thickness=4)
    pixels, valid = points_of(env)
    for point, good in zip(pixels, valid.tolist(), strict=True):
        draw_point(canvas, point, VALID if good else HIDDEN, size=1.1)
    cv2.circle(canvas, np.rint(pixels[0]).astype(int).tolist(), 9, FIRST, 2, cv2.LINE_AA)
    return canvas


def points_of(env: ShapeObservation) -> tuple[np.ndarray, np.ndarray]:
    """The points (N, 2) in pixels and whether they are valid: those that were found, or the true ones of ropes."""
    inner: Any = env.unwrapped
    if hasattr(inner, "crossings"):
        pixels = inner.truth(frame="pixels")
        return np.asarray(pixels, np.float64), np.full(len(pixels), True)
    assert env.detection is not None
    shape = env.detection.shapes[0]
    return shape.pixels.astype(np.float64), shape.valid


def episode(name: str, difficulty: str, seed: int) -> list[np.ndarray]:
    """The motion that leads to the goal, as the wrapper sees it."""
    env = make(name, difficulty=difficulty)
    env.reset(seed=seed)
    inner: Any = env.unwrapped
    idle = np.zeros((IDLE, *inner.action_space.shape), np.float32)
    frames, info = [], {}
    for action in np.concatenate([inner.goal_actions, idle]):
        info = env.step(action)[-1]
        shown = frame(env)[ALL_ROWS if name == "cables" else ROWS, COLS]
        title = band(f"{1e3 * info['truth/mean_error']:.0f} mm from the goal", shown.shape[1], 16)
        frames.append(np.concatenate([title, legend(KEYS, shown.shape[1], 14), shown]))
    env.close()
    return frames + frames[-1:] * 10


def sheet() -> np.ndarray:
    """Start and goal of every environment at every difficulty."""
    rows = [row(name) for name in ENVS]
    width = rows[0].shape[1]
    heads = np.full((round(1.8 * LETTERS), width, 3), 255, np.uint8)
    for column, difficulty in enumerate(DIFFICULTIES):
        heads = write_text(heads, f"{difficulty} goal", (column * (CELL + PAPER) + 6, LETTERS), LETTERS, bold=True)
    keys = write_text(legend(KEYS, width, LETTERS), "numbers: mean distance from the goal", (480, 19), LETTERS)
    return np.concatenate([keys, heads, *rows])


CELL = COLS.stop - COLS.start


def row(name: str) -> np.ndarray:
    """An environment at every difficulty, from the same start, cropped to what is in it."""
    shown, places, texts = [], [], []
    for difficulty in DIFFICULTIES:
        env = make(name, difficulty=difficulty)
        _, info = env.reset(seed=SEEDS[name])
        shown.append(frame(env))
        places += [points_of(env)[0], *goal_lines(env)]
        texts.append(f"{1e3 * info['truth/mean_error']:.0f} mm")
        env.close()
    rows = np.concatenate(places)[:, 1]
    visible = slice(max(int(rows.min()) - MARGIN - 10, 0), int(rows.max()) + MARGIN)
    if name == "cables":
        visible = ALL_ROWS
    cells = []
    for picture, text in zip(shown, texts, strict=True):
        cell = np.ascontiguousarray(picture[visible, COLS])
        place = CELL - width_of(text, LETTERS, bold=True) - 10, cell.shape[0] - LETTERS
        cell = write_text(cell, text, place, LETTERS, bold=True, halo=3)
        cells.append(np.pad(cell, ((0, PAPER), (0, PAPER), (0, 0)), constant_values=255))
    title = np.full((round(1.6 * LETTERS), CELL, 3), 255, np.uint8)
    title = write_text(title, f"{name[0].upper()}{name[1:]}", (6, round(0.8 * LETTERS)), LETTERS)
    title = np.pad(title, ((0, 0), (0, 2 * CELL + 3 * PAPER), (0, 0)), constant_values=255)
    return np.concatenate([title, np.concatenate(cells, axis=1)])


def main() -> None:
    """Write them all."""
    save(IMAGES / "envs_sheet.jpg", sheet())
    for name, difficulty in EPISODES:
        write_gif(IMAGES / f"env_{name}.gif", episode(name, difficulty, seed=2)[::2], 0.1)


if __name__ == "__main__":
    main()
