"""An environment whose images show the time."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from shape_obs import CameraModel, Intrinsics


class Clock(gym.Env):
    """Episodes of three steps whose images show their number, drawn into one reused buffer."""

    metadata = {"render_fps": 20}  # noqa: RUF012
    action_space = spaces.Box(0.5, 1.0, (2,), np.float32)

    def __init__(self, depth="uint16", stamped=False):
        images: dict[str, Any] = {"rgb": spaces.Box(0, 255, (24, 32, 3), np.uint8)}
        if depth:
            images["depth"] = spaces.Box(0, 9, (24, 32), np.dtype(depth).type)
        self.observation_space = spaces.Dict(images)
        self.count, self.stamped, self.actions, self.seeds = 0, stamped, [], []
        self.buffers = {key: np.zeros(space.shape, space.dtype) for key, space in images.items()}
        self.camera_model = CameraModel(Intrinsics(32, 24, 40.0, 40.0, 15.5, 11.5), np.eye(4))

    def _observe(self):
        for buffer in self.buffers.values():
            buffer[...] = self.count
        self.count += 1
        return self.buffers, {"stamp": 100.0 + self.count} if self.stamped else {}

    @property
    def anchors(self):
        return {"hand": (0.1 * self.count, 0.0, 1.0)}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.seeds.append(seed)
        return self._observe()

    def step(self, action):
        self.actions.append(action)
        self.steps += 1
        observation, info = self._observe()
        return observation, 0.0, False, self.steps == 3, info
