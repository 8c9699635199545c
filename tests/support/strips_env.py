"""A goal-conditioned env that draws red strips on a table, without physics and renderer: a goal of several shapes."""

from __future__ import annotations

from typing import Any

import cv2
import gymnasium as gym
import numpy as np
from goal_envs import INTRINSICS, RED, tilted

from shape_obs import CameraModel, ShapeObservation
from shape_obs.robot import ActionSpec

POINTS = 9
CAP = 0.012  # m: half the width of a strip, by which a drawn line is longer at each end
BASE = {"kind": "points3d", "frame": "base"}


class StripsEnv(gym.Env[Any, Any]):
    """Bent strips side by side; the action moves strip k by up to a tenth of the way to its goal.

    Args:
        strips: Number of strips.
        goals: Whether it is goal-conditioned.
        counted: Whether ``goal_layout`` says that all strips have a goal; else only the first one has.
    """

    metadata = {"render_modes": [], "render_fps": 10}  # noqa: RUF012

    def __init__(self, strips: int = 2, goals: bool = True, counted: bool = True) -> None:
        self.strips, self.goals, self.hidden = strips, goals, set[int]()
        self.camera_model = CameraModel(INTRINSICS, tilted(0))
        self.counted = strips if counted else 1
        self.goal_layout = {"kind": "centerline", **({"count": strips} if counted else {})}
        self.action_space = gym.spaces.Box(-1.0, 1.0, (strips,), np.float32)
        limits = {"units": ["m"] * strips, "scale": [0.01] * strips, "low": [-1.0] * strips, "high": [1.0] * strips}
        self.action_spec = ActionSpec.from_dict({"names": [f"strip{k}" for k in range(strips)], **limits})
        images = {
            "rgb": gym.spaces.Box(0, 255, (120, 160, 3), np.uint8),
            "depth": gym.spaces.Box(0.0, 10.0, (120, 160), np.float32),
        }
        goal = gym.spaces.Box(-1.0, 1.0, (self.counted * POINTS * 3,), np.float32)
        self.observation_space = gym.spaces.Dict(
            {**images, **({"achieved_goal": goal, "desired_goal": goal} if goals else {})}
        )
        self.start = self.end = self.way = np.zeros(strips)

    def points(self, place: np.ndarray, cut: float = 0.0) -> np.ndarray:
        """Return points ``(strips, 9, 3)`` for places along y, without ``cut`` metres at the ends."""
        x = np.linspace(-0.12 + cut, 0.12 - cut, POINTS)
        y = place[:, None] + np.linspace(-0.1, 0.1, self.strips)[:, None] + 0.02 * np.cos(12 * x)
        return np.stack([np.broadcast_to(x, y.shape), y, np.zeros_like(y)], axis=-1)

    @property
    def anchors(self) -> dict[str, tuple[float, float, float]]:
        """Where each strip begins."""
        ends = self.points(self.start + self.way * (self.end - self.start))[:, 0].tolist()
        return {f"gripper{k}": (x, y, z) for k, (x, y, z) in enumerate(ends)}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.start, self.end = self.np_random.uniform(-0.02, 0.02, (2, self.strips))
        self.end = self.end + np.where(self.end > self.start, 0.01, -0.01)
        self.way = np.zeros(self.strips)
        return self._observe(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.way = np.clip(self.way + 0.1 * np.asarray(action), 0, 1)
        return self._observe(), 0.0, False, False, {}

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        apart = (np.asarray(achieved_goal, float) - desired_goal).reshape(*np.shape(achieved_goal)[:-1], -1, 3)
        reward = -np.linalg.norm(apart, axis=-1).mean(axis=-1)
        return float(reward) if reward.ndim == 0 else reward

    def _observe(self) -> dict[str, np.ndarray]:
        place = self.start + self.way * (self.end - self.start)
        strips = self.points(place)
        rgb = np.full((120, 160, 3), 150, np.uint8)
        for k, strip in enumerate(self.points(place, CAP)):
            if k not in self.hidden:
                pixels = np.rint(16 * self.camera_model.project_from_base(strip)).astype(np.int32)
                cv2.polylines(rgb, [pixels], False, (200, 40, 30), 6, cv2.LINE_AA, 4)
        seen = {"rgb": rgb, "depth": np.full((120, 160), 0.6, np.float32)}
        if not self.goals:
            return seen
        both = strips[: self.counted], self.points(self.end)[: self.counted]
        achieved, desired = (each.astype(np.float32).ravel() for each in both)
        return {**seen, "achieved_goal": achieved, "desired_goal": desired}


def observing_strips(strips: int = 2, **options: Any) -> ShapeObservation:
    """Return an env that observes strips in slots ``strip0``, ``strip1``, ...: slot k holds strip k."""
    shape = {
        "kind": "centerline", "name": "strip", "n": 12, "ends": "tips", "spacing": "m", "count": strips,
        "anchor": {f"strip{k}": f"gripper{k}" for k in range(strips)},
    }  # fmt: skip
    return ShapeObservation(StripsEnv(strips, **options), [shape], RED, [BASE, "ok"])
