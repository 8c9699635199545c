"""Who looks at the scene: the observation's camera, the camera of `render`, and a person."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.bodies.base import Body
from shape_obs_envs.mujoco.cameras import RENDERERS, Camera, open_camera
from shape_obs_envs.mujoco.cameras.gl_context import GLUnavailableError
from shape_obs_envs.mujoco.scene import CameraSpec
from shape_obs_envs.mujoco.viewer import Viewer

__all__ = ["RENDERERS", "RENDER_MODES", "Studio"]

RENDER_MODES: Final = ("rgb_array", "rgbd_tuple", "human")
Picture = tuple[NDArray[np.uint8], NDArray[np.float32]]


class Studio:
    """Cameras and viewer of one environment, opened when they are first used.

    They are not opened with the environment: vector environments build one in the parent process only to read spaces.

    Args:
        renderer: One of `RENDERERS`.
        observing: The observation's camera.
        displaying: The camera of `render`; where it is the observation's, its last picture is shown again.
        dt: Seconds of a step, for the viewer.
    """

    def __init__(self, renderer: str, observing: CameraSpec, displaying: CameraSpec, dt: float) -> None:
        self._renderer = renderer
        self._observing, self._displaying, self._dt = observing, displaying, dt
        self._cameras: dict[CameraSpec, Camera] = {}
        self._last: Picture | None = None
        self._viewer: Viewer | None = None

    @property
    def camera_name(self) -> str | None:
        """Which renderer the observation's camera turned out to be; None before the first picture."""
        camera = self._cameras.get(self._observing)
        return None if camera is None else camera.name

    def capture(self, body: Body, spec: CameraSpec | None = None) -> Picture:
        """Colours (H, W, 3) and depth (H, W) [m], new arrays."""
        spec = spec or self._observing
        if spec not in self._cameras:
            self._cameras[spec] = open_camera(self._renderer, spec, body.model)
        try:
            return self._cameras[spec].render(body.data)
        except GLUnavailableError:  # in a forked worker; rays work there
            if self._renderer != "auto":
                raise
            self._cameras[spec] = open_camera(self._renderer, spec, body.model)
            return self._cameras[spec].render(body.data)

    def observe(self, body: Body) -> dict[str, NDArray[Any]]:
        """The images of an observation: `rgb` uint8 and `depth` uint16 [mm], 0 where it is invalid."""
        self._last = rgb, depth = self.capture(body)
        # Millimetres as a depth camera gives them; beyond its range is invalid.
        millimetres = depth * 1000
        np.rint(millimetres, out=millimetres)
        millimetres[millimetres > 65535] = 0
        return {"rgb": rgb.copy(), "depth": millimetres.astype(np.uint16)}

    def render(self, body: Body, mode: str) -> Any:
        """What a render mode returns."""
        if mode == "human":
            self.show(body, mode)
            return None
        again = self._last if self._displaying == self._observing else None
        rgb, depth = again or self.capture(body, self._displaying)
        return rgb.copy() if mode == "rgb_array" else (rgb.copy(), depth.copy())

    def show(self, body: Body, mode: str | None) -> None:
        """Bring the viewer up to date, where there is to be one."""
        if mode == "human":
            self._viewer = self._viewer or Viewer(body.model, body.data, self._dt)
            self._viewer.sync()

    def refresh(self) -> None:
        """Take over textures and lights of the model that have changed."""
        for camera in self._cameras.values():
            camera.refresh()
        if self._viewer is not None:
            self._viewer.refresh()

    def close(self) -> None:
        """Free the cameras and the viewer; they are opened again when they are used again."""
        for camera in self._cameras.values():
            camera.close()
        self._cameras.clear()
        self._last = None
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None
