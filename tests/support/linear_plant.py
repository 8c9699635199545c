"""A linear plant with noisy features, for tests of servoing."""

from __future__ import annotations

from typing import Any

import numpy as np

from shape_obs import Shape
from shape_obs.geometry.topology import Chain
from shape_obs.servo import ShapeServo

POINTS = 8


class Plant:
    """A linear plant, ``x += J a``, whose features are noisy; `lost` marks the shape as lost."""

    def __init__(self, seed: int = 0, features: int = 6, actions: int = 3, noise: float = 1e-3) -> None:
        self._rng = np.random.default_rng(seed)
        self.matrix = 0.01 * self._rng.normal(size=(features, actions))
        self.x, self.noise = np.zeros(features), noise
        self.goal = self.matrix @ self._rng.uniform(-8, 8, actions)
        self.valid, self.reason, self.blank = POINTS, "", False

    def seen(self) -> Shape:
        zeros = np.zeros((POINTS, 2), np.float32)
        known = np.arange(POINTS) < self.valid
        return Shape("rope", zeros, None, visible=known, valid=known, layout=Chain(POINTS), reason=self.reason)

    def observation(self) -> dict[str, Any]:
        seen = self.x + self.noise * self._rng.normal(size=len(self.x))
        return {"achieved_goal": np.full_like(seen, np.nan) if self.blank else seen, "desired_goal": self.goal}

    def away(self) -> float:
        return float(np.linalg.norm(self.goal - self.x) / np.linalg.norm(self.goal))

    def run(self, servo: ShapeServo, steps: int) -> np.ndarray:
        actions = np.array([self._step(servo) for _ in range(steps)])
        assert np.abs(actions).max() <= 1
        return actions

    def _step(self, servo: ShapeServo) -> np.ndarray:
        action = servo.act(self.observation())
        self.x = self.x + self.matrix @ action
        return action


def servo_of(plant: Plant, law: Any = "mfac", **options: Any) -> ShapeServo:
    return ShapeServo(law, actions=plant.matrix.shape[1], seen=plant.seen, **options)
