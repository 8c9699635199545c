"""Wrap one of Gymnasium's own envs, seen in RGB-D: the Swimmer as 13 points in metres, in the world's frame.

``RGBDCamera`` is for ``render_mode="rgbd_tuple"`` what ``AddRenderObservation`` is for ``"rgb_array"``. It publishes
the pose of the camera, and works with any ``gymnasium.envs.mujoco.MujocoEnv``, including your own.

Run: ``uv run --extra sim --with "gymnasium[mujoco]" examples/foreign_env_depth.py``; on Linux without a display put
``MUJOCO_GL=egl`` before the command.
"""

from typing import Any

import gymnasium as gym
import numpy as np
from foreign_env import FROM_ABOVE, HEIGHT, ORANGE, WIDTH, stroke

from shape_obs import CameraModel, Centerline, Intrinsics, ShapeObservation


class RGBDCamera(gym.ObservationWrapper):
    """Observe ``rgb`` and ``depth`` [m] of a MuJoCo env, and publish ``camera_model``."""

    def __init__(self, env: gym.Env) -> None:
        super().__init__(env)
        self._mujoco: Any = env.unwrapped
        # Before the first image. Antialiasing samples depth next to the pixel's centre.
        self._mujoco.model.vis.quality.offsamples = 0
        self._mujoco.model.vis.quality.shadowsize = 0  # no shadows: faster without a GPU
        env.reset()
        rgb, _ = self._render()
        self.observation_space = gym.spaces.Dict(
            {
                "rgb": gym.spaces.Box(0, 255, rgb.shape, np.uint8),
                "depth": gym.spaces.Box(0, np.inf, rgb.shape[:2], np.float32),
            }
        )

    def observation(self, observation: Any) -> dict[str, np.ndarray]:
        rgb, buffer = self._render()
        # The buffer runs from 0 at the near plane to 1 at the far one, as 1/z does.
        near, far = self._eye.frustum_near, self._eye.frustum_far
        depth = near * far / (far - buffer.astype(np.float64) * (far - near))
        depth[buffer >= 1] = 0  # no surface
        return {"rgb": rgb, "depth": depth.astype(np.float32)}

    @property
    def camera_model(self) -> CameraModel:
        """Return the camera of the last image: free, fixed or tracking."""
        forward, down = np.float64(self._eye.forward), -np.float64(self._eye.up)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([np.cross(down, forward), down, forward], axis=1)
        pose[:3, 3] = np.mean([eye.pos for eye in self._eyes], axis=0)  # between two eyes
        w, h = self._mujoco.width, self._mujoco.height
        focal = h * self._eye.frustum_near / (self._eye.frustum_top - self._eye.frustum_bottom)
        return CameraModel(Intrinsics(w, h, focal, focal, (w - 1) / 2, (h - 1) / 2), pose)

    def _render(self) -> tuple[np.ndarray, np.ndarray]:
        picture: Any = self.env.render()
        self._eyes = self._mujoco.mujoco_renderer.viewer.scn.camera
        self._eye = self._eyes[0]
        return picture


def make_env() -> ShapeObservation:
    view: dict[str, Any] = {"camera_id": -1, "default_camera_config": FROM_ABOVE}
    env = gym.make("Swimmer-v5", render_mode="rgbd_tuple", width=WIDTH, height=HEIGHT, **view)
    return ShapeObservation(
        RGBDCamera(env),
        shapes=[Centerline(n=13, ends="tips", spacing="m", radius=0.1, anchor=(1.5, 0, 0))],
        segmentation=ORANGE,
        features=[{"kind": "points3d", "frame": "base"}, "ok"],
        workspace=((-3.5, -2.5, -0.2), (3.5, 2.5, 0.2)),  # the default: 2 m
    )


def main() -> None:
    env = make_env()
    observation, info = env.reset(seed=0)
    for step in range(25):
        observation, *_, info = env.step(stroke(step))
    points = observation[:-1].reshape(13, 3)
    torso = env.get_wrapper_attr("data").body("torso")
    nose = torso.xpos + torso.xmat.reshape(3, 3) @ (1.6, 0, 0)
    print(f"{len(points)} points in metres, ok: {info['shape/ok']}")
    print("nose:", points[0].round(3), "tail:", points[-1].round(3))
    print(f"the nose is off by {1e3 * np.linalg.norm(points[0] - nose):.0f} mm")
    env.close()


if __name__ == "__main__":
    main()
