"""The picture of 'The D455 model', and the figures of that page: uv run python docs/pictures/d455.py."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import gymnasium as gym
import numpy as np
from sheet import Key, grid, legend, save, titled

import shape_obs_envs  # noqa: F401
from shape_obs_envs.d455 import Cause, D455Camera, D455Model, D455Noise

IMAGES = Path(__file__).parent.parent / "images"
INK = (30, 30, 30)
LETTERS = 20  # pixels of panels 640 pixels wide
COLOURS = {
    Cause.LEFT_BAND: (120, 120, 130),
    Cause.EDGE: (235, 130, 40),
    Cause.DARK: (190, 40, 160),
    Cause.SPECKLE: (40, 150, 90),
}
NEAREST, FARTHEST = 500, 640  # millimetres
DETAIL = 180, 160  # row and column
NO_HOLES = D455Model(
    subpixel=0, disparity_step=0, left_band=False, edge_share=0, dark_share=0, speckle_share=0, min_z=0, max_z=None
)
SIZES = ((84, 84), (160, 120), (640, 480))


def views(seed: int = 3) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], D455Noise]:
    """The same moment of the cable environment, clean and through the model."""
    make: dict[str, Any] = {"camera": "d455", "renderer": "rays"}
    clean, _ = gym.make("ShapeObs/Cable-v0", **make).reset(seed=seed)
    env = D455Noise(gym.make("ShapeObs/Cable-v0", **make), fast=False)
    noisy, _ = env.reset(seed=seed)
    return clean, noisy, env


def coloured_depth(millimetres: np.ndarray) -> np.ndarray:
    """Near is yellow, far is blue, holes are black."""
    share = np.clip((FARTHEST - millimetres.astype(float)) / (FARTHEST - NEAREST), 0, 1)
    picture = cv2.applyColorMap((255 * share).astype(np.uint8), cv2.COLORMAP_VIRIDIS)[..., ::-1].copy()
    picture[millimetres == 0] = 0
    return picture


def coloured_causes(causes: np.ndarray) -> np.ndarray:
    """Each cause in its colour."""
    picture = np.full((*causes.shape, 3), 250, np.uint8)
    for cause, colour in COLOURS.items():
        picture[(causes & np.uint8(cause)) != 0] = colour
    keys = [Key((cause.name or "").lower().replace("_", " "), colour, "patch") for cause, colour in COLOURS.items()]
    return np.concatenate([legend(keys, picture.shape[1], LETTERS), picture])


def coloured_error(measured: np.ndarray, clean: np.ndarray) -> np.ndarray:
    """Measured minus true depth: red is too far, blue too near, full colour is 3 mm; holes are black."""
    error = np.clip(((measured - clean) / 0.003)[..., None], -1, 1)
    side = np.where(error > 0, (200, 40, 30), (30, 70, 200))
    picture = (250 + np.abs(error) * (side - 250.0)).astype(np.uint8)
    picture[measured == 0] = 0
    return picture


def with_detail(rgb: np.ndarray) -> np.ndarray:
    """The image with a gripper and what is around it, enlarged, in its lower left corner."""
    top, left = DETAIL
    part = cv2.resize(rgb[top : top + 40, left : left + 60], None, fx=5, fy=5, interpolation=cv2.INTER_NEAREST)
    picture = rgb.copy()
    cv2.rectangle(picture, (left - 1, top - 1), (left + 60, top + 40), INK, 1)
    picture[-210:-10, 10:310] = part
    cv2.rectangle(picture, (9, picture.shape[0] - 211), (310, picture.shape[0] - 10), INK, 1)
    return picture


def picture() -> np.ndarray:
    """Six panels: colour clean and noisy, what was lost to what; depth clean and measured, and its error."""
    clean, noisy, env = views()
    assert env.measurement is not None
    panels = {
        "Colour, clean": with_detail(clean["rgb"]),
        "Colour with D455Noise": with_detail(noisy["rgb"]),
        "Holes by cause": coloured_causes(env.measurement.causes),
        f"Depth, clean: {NEAREST} mm yellow, {FARTHEST} mm blue": coloured_depth(clean["depth"]),
        "Depth with D455Noise; holes black": coloured_depth(noisy["depth"]),
        "Its error: red too far, blue too near, full at 3 mm": coloured_error(
            env.measurement.metres, clean["depth"] / 1000
        ),
    }
    tiles = [titled(panel, title, LETTERS) for title, panel in panels.items()]
    rows = [grid(evened(pair), 2) for pair in zip(tiles[:3], tiles[3:], strict=True)]
    return np.concatenate(rows)


def evened(tiles: tuple[np.ndarray, ...]) -> list[np.ndarray]:
    """Pictures of one height, with white below the lower ones."""
    tallest = max(map(len, tiles))
    return [np.pad(tile, ((0, tallest - len(tile)), (0, 0), (0, 0)), constant_values=255) for tile in tiles]


def milliseconds(call: Callable[[], object], runs: int) -> float:
    """Return the shortest time of a call, since other load on the machine can only add to it."""
    call()
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return 1000 * min(times)


def print_times() -> None:
    """Rows of a table: milliseconds that the wrapper adds to a step, fast and exact, and their ratio."""
    cv2.setNumThreads(1)
    for width, height in SIZES:
        env = gym.make("ShapeObs/Cable-v0", camera=[width, height], renderer="rays")
        clean, _ = env.reset(seed=0)
        fast, exact = (
            milliseconds(partial(D455Noise(env, fast=fast).observation, clean), runs)
            for fast, runs in ((True, 1000), (False, 200))
        )
        print(f"| {width} × {height} | {fast:.2f} | {exact:.1f} | {exact / fast:.0f} |")


def print_noise() -> None:
    """Rows of a table: depth, its designed standard deviation, and by how much the exact and the fast form miss it."""
    model = replace(NO_HOLES, subpixel=D455Model().subpixel, disparity_step=D455Model().disparity_step)
    rng, white = np.random.default_rng(0), np.full((480, 640, 3), 255, np.uint8)
    cameras = [D455Camera(model, (480, 640), fast) for fast in (False, True)]
    for z in (0.4, 0.6, 0.8, 1.0, 1.25, 1.5):
        wall = np.full((480, 640), z)
        found = [np.std([camera.measure(wall, white, rng).metres for _ in range(4)]) for camera in cameras]
        exact, fast = (float(deviation) / model.sigma(z) for deviation in found)
        print(f"| {z:.2f} | {1000 * model.sigma(z):.2f} | {exact:.3f} | {fast:.3f} |")


def print_shares() -> None:
    """Rows of a table: cause, designed share, and that of the exact and the fast form, where the cause applies."""
    model, size = D455Model(), (480, 640)
    column, wide = np.arange(size[1]) % 32, round(model.edge_width)
    steps = np.broadcast_to(np.where(column < 16, 0.8, 0.6), size)
    beside = np.broadcast_to((column % 16 < wide) | (column % 16 >= 16 - wide), size).copy()
    beside[:, [*range(wide), *range(-wide, 0)]] = False  # no step at the image's border
    everywhere, wall = np.ones(size, bool), np.full(size, 0.8)
    scenes = {
        "edge": (Cause.EDGE, steps, 255, beside, model.edge_share),
        "dark, brightness 0": (Cause.DARK, wall, 0, everywhere, model.dark_probability(0)),
        "dark, brightness 50": (Cause.DARK, wall, 50, everywhere, model.dark_probability(50)),
        "speckle": (Cause.SPECKLE, wall, 255, everywhere, model.speckle_share),
        "left band, at 0.8 m": (Cause.LEFT_BAND, wall, 255, everywhere, model.band_width(0.8) / model.width),
    }
    rng = np.random.default_rng(0)
    for name, (cause, metres, value, where, designed) in scenes.items():
        rgb = np.full((*size, 3), value, np.uint8)
        exact, fast = (
            np.mean([camera.measure(metres, rgb, rng).lost_to(cause)[where].mean() for _ in range(30)])
            for camera in (D455Camera(model, size, fast) for fast in (False, True))
        )
        print(f"| {name} | {100 * designed:.2f} | {100 * exact:.2f} | {100 * fast:.2f} |")


def print_losses() -> None:
    """What the rope and the grippers of the cable environment lose."""
    for camera in ("d455", "rl"):
        make: dict[str, Any] = {"camera": camera, "renderer": "rays"}
        clean, noisy = gym.make("ShapeObs/Cable-v0", **make), D455Noise(gym.make("ShapeObs/Cable-v0", **make))
        lost: dict[str, list[float]] = {"rope": [], "grippers": [], "table": []}
        for seed in range(20):
            rgb, depth = clean.reset(seed=seed)[0]["rgb"].astype(int), noisy.reset(seed=seed)[0]["depth"]
            rope, grippers = rgb[..., 2] - rgb[..., 0] > 50, rgb.max(axis=2) < 75
            for name, where in (("rope", rope), ("grippers", grippers), ("table", ~rope & ~grippers)):
                lost[name].append(float((depth[where] == 0).mean()))
        print(camera, {name: f"{100 * np.mean(shares):.1f} %" for name, shares in lost.items()})


if __name__ == "__main__":
    save(IMAGES / "d455_noise.jpg", cv2.resize(picture(), None, fx=0.75, fy=0.75, interpolation=cv2.INTER_AREA))
    print_noise()
    print_shares()
    print_losses()
    print_times()
