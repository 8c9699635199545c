"""A small env that draws a sheet with known truth, without physics and renderer."""

from __future__ import annotations

from typing import Any

import cv2
import gymnasium as gym
import numpy as np

from shape_obs import CameraModel, Intrinsics

INTRINSICS = Intrinsics(160, 120, 150.0, 150.0, 79.5, 59.5)


class SheetEnv(gym.Env[Any, Any]):
    """A red sheet on gray that drifts and turns; half a metre under the camera."""

    metadata = {"render_modes": [], "render_fps": 10}  # noqa: RUF012

    def __init__(self) -> None:
        self.action_space = gym.spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space = gym.spaces.Dict(
            {
                "rgb": gym.spaces.Box(0, 255, (120, 160, 3), np.uint8),
                "depth": gym.spaces.Box(0.0, 10.0, (120, 160), np.float32),
            }
        )
        self.camera_model = CameraModel(INTRINSICS)
        self.centre, self.angle = np.array([80.0, 60.0]), 0.0

    def corners(self) -> np.ndarray:
        """Return the corners, clockwise from the sheet's own top left, (4, 2) pixels."""
        turn = np.array([[np.cos(self.angle), np.sin(self.angle)], [-np.sin(self.angle), np.cos(self.angle)]])
        return np.array([[-45.0, -28], [45, -28], [45, 28], [-45, 28]]) @ turn + self.centre

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.centre, self.angle = 60.0 + self.np_random.uniform(0, 6, 2) + [20, 0], self.np_random.uniform(-0.2, 0.2)
        return self._observe(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.angle += 0.1 * float(np.asarray(action)[0])
        self.centre = np.clip(self.centre + [float(np.asarray(action)[1]), 0], 56, 100)
        return self._observe(), 0.0, False, False, {}

    def _observe(self) -> dict[str, np.ndarray]:
        mask = np.zeros((120, 160), np.uint8)
        cv2.fillPoly(mask, [np.rint(self.corners() * 16).astype(np.int32)], 255, shift=4)
        rgb = np.where(mask[..., None] > 0, np.array([200, 40, 30]), np.array([150, 150, 150])).astype(np.uint8)
        return {"rgb": rgb, "depth": np.full(mask.shape, 0.5, np.float32)}
