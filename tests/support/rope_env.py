"""A small env that draws a rope with known truth, without physics and renderer."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from shape_obs import CameraModel, Intrinsics, ShapeObservation
from shape_obs.bench.scenes import draw_rope

SIZE = (120, 160)
INTRINSICS = Intrinsics(160, 120, 150.0, 150.0, 79.5, 59.5)
DOWN = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]])  # camera looks along -z of the base
BLUE = {"kind": "hsv", "low": [100, 120, 60], "high": [125, 255, 255]}
DEPTH = 0.5


class RopeEnv(gym.Env[Any, Any]):
    """A blue rope 7 px thick on gray, half a metre under a camera whose height is drawn at each reset.

    The rope's start height in the image is drawn too; the action moves it by 2 px.

    Args:
        hide: Steps at which there is no rope (0 is the reset).
        holes: Whether the rope's right half has no depth.
        length: Steps until truncation.
    """

    metadata = {"render_modes": [], "render_fps": 10}  # noqa: RUF012

    def __init__(self, hide: Sequence[int] = (), holes: bool = False, length: int = 8) -> None:
        self.hide, self.holes, self.length = list(hide), holes, length
        self.action_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.observation_space = gym.spaces.Dict(
            {
                "rgb": gym.spaces.Box(0, 255, (*SIZE, 3), np.uint8),
                "depth": gym.spaces.Box(0.0, 10.0, SIZE, np.float32),
                "hand": gym.spaces.Box(-5.0, 5.0, (3,), np.float32),
                "phase": gym.spaces.Discrete(100),
                "deep": gym.spaces.Dict({"row": gym.spaces.Box(0.0, 120.0, (1,), np.float32)}),
            }
        )
        self.row, self.height, self.steps = 60.0, 1.0, 0

    @property
    def camera_model(self) -> CameraModel:
        pose = DOWN.copy()
        pose[2, 3] = self.height
        return CameraModel(INTRINSICS, pose)

    @property
    def anchors(self) -> dict[str, tuple[float, float, float]]:
        """The position of the hand, which holds the right end."""
        x, y, z = self.camera_model.to_base(INTRINSICS.deproject(self.curve()[-1], DEPTH)).tolist()
        return {"hand": (x, y, z)}

    def curve(self) -> np.ndarray:
        """Return the true centreline from left to right, (P, 2) pixels."""
        u = np.linspace(25, 135, 300)
        return np.stack([u, self.row + 14 * np.sin((u - 25) / 22)], axis=1)

    def true_points(self, n: int = 20) -> np.ndarray:
        """Return the true points from the hand's end, at the centres of equal pieces, (n, 2) pixels."""
        curve = self.curve()[::-1]
        arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
        at = (np.arange(n) + 0.5) / n * arc[-1]
        return np.stack([np.interp(at, arc, curve[:, d]) for d in range(2)], axis=1)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.row, self.height, self.steps = self.np_random.uniform(45, 75), self.np_random.uniform(0.8, 1.2), 0
        return self._observe(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.row = float(np.clip(self.row + 2 * float(np.asarray(action)[0]), 30, 90))
        self.steps += 1
        return self._observe(), 0.0, False, self.steps >= self.length, {}

    def _observe(self) -> dict[str, Any]:
        rgb = np.full((*SIZE, 3), 150, np.uint8)
        depth = np.full(SIZE, DEPTH, np.float32)
        if self.steps not in self.hide:
            rgb[draw_rope(self.curve()[::3], 7, size=SIZE).mask > 0] = (30, 60, 200)
            if self.holes:
                depth[:, 80:] = 0
        hand = np.array(self.anchors["hand"], np.float32)
        row = {"row": np.array([self.row], np.float32)}
        return {"rgb": rgb, "depth": depth, "hand": hand, "phase": np.int64(self.steps), "deep": row}


class PixelEnv(gym.ObservationWrapper[Any, Any, Any]):
    """A wrapper that leaves only the RGB image."""

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        self.observation_space = env.observation_space["rgb"]  # type: ignore[index]

    def observation(self, observation: Any) -> Any:
        return observation["rgb"]


def wrapped(env: gym.Env[Any, Any] | None = None, **kwargs: Any) -> ShapeObservation:
    return ShapeObservation(env or RopeEnv(), segmentation=BLUE, **kwargs)


def walk(env: gym.Env[Any, Any], seed: int = 0, steps: int = 6) -> Iterator[Any]:
    observation, info = env.reset(seed=seed)
    yield observation, None, False, False, info
    rng = np.random.default_rng(seed)
    for _ in range(steps):
        yield env.step(rng.uniform(-1, 1, 1).astype(np.float32))


def run(env: gym.Env[Any, Any], seed: int = 0, steps: int = 6) -> list[Any]:
    return list(walk(env, seed, steps))
