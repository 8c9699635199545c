"""The animation of the README: uv run --extra sim python docs/pictures/readme.py."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import gymnasium as gym
import numpy as np
from scipy.spatial import cKDTree
from sheet import FIRST_KEY, GOAL_KEY, VALID_KEY, grid, legend, titled

import shape_obs_envs  # noqa: F401
from envs import goal_lines
from shape_obs import Centerline, HSVRange, ShapeDetector, ShapeObservation
from shape_obs.bench.scenes import draw_rope
from shape_obs.drawing import GOAL, draw_detection

OUT = Path(__file__).parent.parent / "images" / "readme.gif"
PANEL = slice(66, 370), slice(116, 528)  # rows and columns of images of 640 x 480
LETTERS, FPS, COLOURS = 17, 7, 72
START, PLAYED, END = 4, 36, 12  # frames: the start, the motion, the goal
FRAMES = START + PLAYED + END
SIZE = (480, 640)
WIDTH, LENGTH, CENTRE = 15.0, 410.0, np.array([322.0, 214.0])  # of the drawn rope, in pixels
ROPE = HSVRange(low=(100, 110, 30), high=(125, 255, 255))
EPISODES = {"Simulated cable": ("Cable", 2), "Simulated ring": ("Ring", 2), "Simulated cloth": ("Cloth", 1)}


def photos() -> Iterator[np.ndarray]:
    """A drawn photo of a twisted rope that moves on a wooden table, in uneven light; it ends as it begins."""
    rng = np.random.default_rng(3)
    grain = cv2.GaussianBlur(rng.normal(0, 40, SIZE), (0, 0), sigmaX=40, sigmaY=0.8)
    rings = cv2.GaussianBlur(rng.normal(0, 40, SIZE), (0, 0), sigmaX=120, sigmaY=5)
    table = np.array([176.0, 146, 112]) + (2.2 * grain + 4 * rings)[..., None]
    light = np.linspace(1.14, 0.82, SIZE[1])[None, :, None] * np.linspace(1.05, 0.93, SIZE[0])[:, None, None]
    noise = rng.normal(0, 1.5, (*SIZE, 3))
    for frame in range(FRAMES):
        phase = 2 * np.pi * frame / FRAMES
        yield np.clip(painted(table, axis(phase)) * light + noise, 0, 255).astype(np.uint8)


def axis(phase: float) -> np.ndarray:
    """The rope's axis at a moment, (P, 2) pixels; always of one length."""
    along = np.linspace(0, 1, 900)
    u = 322 + (155 + 12 * np.sin(phase)) * (2 * along - 1)
    bend = 62 * np.sin(2 * np.pi * along + 0.9 * np.sin(phase)) + 26 * np.sin(4.2 * along + 2 * np.sin(phase + 0.6))
    curve = np.stack([u, 214 + bend], axis=1)
    length = np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()
    return CENTRE + (curve - CENTRE) * (LENGTH / length)  # ropes do not stretch


def painted(table: np.ndarray, curve: np.ndarray) -> np.ndarray:
    """The rope on the table, with its shadow, its roundness and its strands."""
    mask = draw_rope(curve, WIDTH, size=SIZE).mask
    shadow = cv2.GaussianBlur(np.roll(mask, (9, 7), axis=(0, 1)), (0, 0), 5)[..., None] / 255
    scene = table * (1 - 0.42 * shadow)
    rows, columns = np.nonzero(cv2.dilate(mask, np.ones((3, 3), np.uint8)))
    pixels = np.stack([columns, rows], axis=1).astype(np.float64)
    _, nearest = cKDTree(curve).query(pixels)
    tangent = np.gradient(curve, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    off = pixels - curve[nearest]
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)[nearest]
    across = np.clip((off * normal).sum(axis=1) / (WIDTH / 2), -1, 1)
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])[nearest]
    strands = 0.86 + 0.2 * np.sin((length + 6 * np.arcsin(across)) / 1.9)
    shade = strands * (0.5 + 0.55 * np.sqrt(np.clip(1 - 0.9 * (across + 0.15) ** 2, 0, 1)))
    rope = np.zeros_like(table)
    rope[rows, columns] = np.array([38.0, 84, 205]) * shade[:, None]
    soft = cv2.GaussianBlur(mask, (0, 0), 0.8)[..., None] / 255
    return scene * (1 - soft) + rope * soft


def photographed() -> Iterator[np.ndarray]:
    """The photos with the points that the detector tracks."""
    detector = ShapeDetector([Centerline(n=20)], ROPE)
    for photo in photos():
        detection = detector.detect(photo)
        assert detection.shapes[0].valid.all()
        yield draw_detection(photo, detection)


def episode(name: str, seed: int) -> Iterator[np.ndarray]:
    """An episode in which the shape is brought to its goal."""
    difficulty = "middle" if name == "Cloth" else "far"
    env: Any = ShapeObservation(
        gym.make(f"ShapeObs/{name}-v0", camera="d455", renderer="rays", render_mode="rgb_array", difficulty=difficulty)
    )
    env.reset(seed=seed)
    inner: Any = env.unwrapped
    actions = list(inner.goal_actions)
    for frame in range(FRAMES):
        under = [(line, GOAL) for line in goal_lines(env)]
        yield draw_detection(np.asarray(env.render()), env.detection, under=under)
        step = frame - START
        if step >= 0:
            idle = np.zeros(inner.action_space.shape, np.float32)
            env.step(actions[step] if step < len(actions) else idle)
    env.close()


def main() -> None:
    """Write the animation."""
    from PIL import Image

    sources = {"Rope on a table (drawn photo)": photographed()}
    sources |= {title: episode(*of) for title, of in EPISODES.items()}
    frames = []
    for pictures in zip(*sources.values(), strict=True):
        panels = [
            titled(np.ascontiguousarray(picture[PANEL]), title, LETTERS)
            for title, picture in zip(sources, pictures, strict=True)
        ]
        sheet = grid(panels, 2, gap=6)
        frames.append(np.concatenate([legend([VALID_KEY, FIRST_KEY, GOAL_KEY], sheet.shape[1], LETTERS), sheet]))
    some = np.concatenate(frames[:: len(frames) // 5])
    palette = Image.fromarray(some).quantize(COLOURS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    indices = [np.asarray(Image.fromarray(f).quantize(palette=palette, dither=Image.Dither.NONE)) for f in frames]
    shown = []
    for last, now in zip([None, *indices], indices, strict=False):
        # Equal pixels are transparent, which packs far better.
        part = Image.fromarray(now if last is None else np.where(now == last, COLOURS, now).astype(np.uint8))
        part.putpalette([*palette.getpalette()[: 3 * COLOURS], 0, 0, 0])
        shown.append(part)
    shown[0].save(
        OUT, save_all=True, append_images=shown[1:], duration=round(1000 / FPS), loop=0, optimize=False,
        transparency=COLOURS, disposal=1,
    )  # fmt: skip
    print(f"{OUT.stat().st_size} bytes, {len(frames)} frames of {frames[0].shape[1]} x {frames[0].shape[0]}")


if __name__ == "__main__":
    main()
