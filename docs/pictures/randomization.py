"""The picture of 'Domain randomisation': uv run python docs/pictures/randomization.py."""

from __future__ import annotations

import cv2
import gymnasium as gym
import numpy as np
from sheet import band
from stages import write

import shape_obs_envs  # noqa: F401

SIZE = (320, 240)
COLUMNS, ROWS = 6, 2  # for each environment
STEPS = 15
SHOWN = (240, 180)


def frames(name: str, first: int) -> list[np.ndarray]:
    """One frame of each of a few randomised episodes."""
    env = gym.make(f"ShapeObs/{name}-v0", camera=SIZE, randomize=True)
    out = []
    assert env.action_space.shape is not None
    for seed in range(first, first + COLUMNS * ROWS):
        rng = np.random.default_rng(seed)
        observation, _ = env.reset(seed=seed)
        for _ in range(STEPS):
            observation, *_ = env.step(rng.uniform(-1, 1, env.action_space.shape).astype(np.float32))
        out.append(cv2.resize(observation["rgb"], SHOWN, interpolation=cv2.INTER_AREA))
    env.close()
    return out


if __name__ == "__main__":
    parts = []
    for i, name in enumerate(("Cable", "Ring", "Cloth")):
        tiles = frames(name, 100 * i)
        rows = [np.concatenate(tiles[k : k + COLUMNS], axis=1) for k in range(0, len(tiles), COLUMNS)]
        parts += [band(f"{name}-v0", rows[0].shape[1], 24), *rows]
    write("randomization.jpg", np.concatenate(parts))
