"""Wrap your own env, which was not written for shape_obs: describe the colour of the object and the camera.

The env here is an example: a red band that swings, seen by a depth camera. Your env only needs an RGB image in its
observation, and a depth image if you want metres.

Run: ``uv run examples/wrap_your_env.py``
"""

import cv2
import gymnasium as gym
import numpy as np
from gymnasium import spaces

from shape_obs import Centerline, HSVRange, Intrinsics, ShapeObservation

WIDTH, HEIGHT = 320, 240


class SwingingBand(gym.Env):
    """A band that actions bend; the observation has an image, depth and the bend."""

    observation_space = spaces.Dict(
        {
            "image": spaces.Box(0, 255, (HEIGHT, WIDTH, 3), np.uint8),
            "range": spaces.Box(0.0, 10.0, (HEIGHT, WIDTH), np.float32),
            "bend": spaces.Box(-1.0, 1.0, (1,), np.float32),
        }
    )
    action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
    dt = 1 / 30  # seconds per step

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self._bend = 0.0
        return self._observe(), {}

    def step(self, action):
        self._bend = float(np.clip(self._bend + 0.2 * action[0], -1, 1))
        return self._observe(), 0.0, False, False, {}

    def _observe(self):
        s = np.linspace(-1, 1, 60)
        band = np.stack([160 + 110 * s, 120 + 60 * self._bend * (1 - s**2)], axis=1)
        image = np.full((HEIGHT, WIDTH, 3), 200, np.uint8)
        cv2.polylines(image, [np.round(band).astype(np.int32)], False, (200, 30, 30), 9)
        distance = np.where(image[..., 1] < 100, 0.78, 0.80).astype(np.float32)
        return {"image": image, "range": distance, "bend": np.array([self._bend], np.float32)}


def main() -> None:
    env = ShapeObservation(
        SwingingBand(),
        shapes=[Centerline(n=12, ends="tips")],
        segmentation=HSVRange(low=(170, 120, 80), high=(10, 255, 255)),  # red: the hue wraps around
        features=["points3d", "ok", "age"],  # the last two show a policy how reliable the points are
        camera=Intrinsics(WIDTH, HEIGHT, fx=300.0, fy=300.0, cx=159.5, cy=119.5),
        rgb_key="image",
        depth_key="range",
        keep=["bend"],
    )
    observation, info = env.reset(seed=0)
    for _ in range(4):
        observation, *_, info = env.step(np.array([1.0], np.float32))
    points = observation["shape"][:36].reshape(12, 3)
    print("space:", env.observation_space)
    sag = 1e3 * (points[6, 1] - points[0, 1])
    print(f"bend {observation['bend'][0]:.1f}: the middle lies {sag:.0f} mm below the ends")
    print("ok, age:", observation["shape"][36:], " info:", {key: info[key] for key in ("shape/ok", "shape/age")})


if __name__ == "__main__":
    main()
