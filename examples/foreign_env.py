"""Wrap one of Gymnasium's own envs, seen in colour: the Swimmer, a chain of three links, as 13 points in the image.

The env was not written for shape_obs and observes its joints; ``AddRenderObservation`` gives it an image instead.

Run: ``uv run --extra sim --with "gymnasium[mujoco]" examples/foreign_env.py``. Gymnasium's renderer needs OpenGL;
on Linux without a display put ``MUJOCO_GL=egl`` before the command.
"""

import gymnasium as gym
import numpy as np
from gymnasium.wrappers import AddRenderObservation

from shape_obs import Centerline, HSVRange, ShapeObservation

WIDTH, HEIGHT = 320, 240
# A fixed camera, 6 m above the start, that looks straight down. Without a choice Gymnasium
# 1.1 uses the Swimmer's own camera, which moves along, and 1.4 a fixed one at a slant.
FROM_ABOVE = {"lookat": [0.0, 0.0, 0.0], "distance": 6.0, "azimuth": 90.0, "elevation": -90}
# The floor is black, white and slightly green, so hue and saturation separate the links from
# it. They also exclude the white highlight along the links, which would leave a gap, so the
# mask is closed.
ORANGE = HSVRange(low=(5, 100, 60), high=(25, 255, 255), close=3)


def make_env() -> ShapeObservation:
    env = gym.make(
        "Swimmer-v5",
        render_mode="rgb_array",
        width=WIDTH,
        height=HEIGHT,
        camera_id=-1,  # the free camera, which default_camera_config describes
        default_camera_config=FROM_ABOVE,
    )
    return ShapeObservation(
        AddRenderObservation(env),
        # Point 0 is the nose, which starts at the right of the image.
        shapes=[Centerline(n=13, ends="tips", anchor=(WIDTH - 1, HEIGHT / 2))],
        segmentation=ORANGE,
        features=["points2d", "ok"],
    )


def stroke(step: int) -> np.ndarray:
    """Return an action that swings the joints, the second after the first."""
    return np.array([np.sin(step / 4), np.cos(step / 4)], np.float32)


def main() -> None:
    env = make_env()
    observation, info = env.reset(seed=0)
    print("observation:", observation.shape)
    for step in range(25):
        observation, *_, info = env.step(stroke(step))
    points = observation[:-1].reshape(13, 2)
    print("nose, tail:", points[0].round(1), points[-1].round(1))
    assert env.detection is not None
    print(f"ok: {info['shape/ok']}, in {env.detection.timings['total']:.1f} ms")
    env.close()


if __name__ == "__main__":
    main()
