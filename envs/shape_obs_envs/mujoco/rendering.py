"""Rendering of an environment: the observation's camera, the camera of ``render``, and MuJoCo's viewer."""

from __future__ import annotations

import importlib
import os
import sys
import time
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.bodies import Body
from shape_obs_envs.mujoco.cameras import Camera, open_camera
from shape_obs_envs.mujoco.cameras.gl_camera import GLUnavailableError
from shape_obs_envs.mujoco.scene import CameraSpec

RENDER_MODES: Final = ("rgb_array", "rgbd_tuple", "human")
Images = tuple[NDArray[np.uint8], NDArray[np.float32]]


class Rendering:
    """Cameras and viewer of one environment, opened on first use.

    They are not opened with the environment: vector environments build one in the parent process only to read spaces.

    Args:
        renderer: One of ``shape_obs_envs.mujoco.cameras.RENDERERS``.
        observing: The observation's camera.
        displaying: The camera of ``render``; if it equals the observation's, the last images are returned again.
        dt: Duration of a step in seconds, for the viewer.
    """

    def __init__(self, renderer: str, observing: CameraSpec, displaying: CameraSpec, dt: float) -> None:
        self._renderer = renderer
        self._observing, self._displaying, self._dt = observing, displaying, dt
        self._cameras: dict[CameraSpec, Camera] = {}
        self._last: Images | None = None
        self._viewer: Viewer | None = None

    @property
    def camera_name(self) -> str | None:
        """Name of the renderer in use; None before the first image."""
        camera = self._cameras.get(self._observing)
        return None if camera is None else camera.name

    def capture(self, body: Body, spec: CameraSpec | None = None) -> Images:
        """Render colours ``(H, W, 3)`` and depth ``(H, W)`` in metres to new arrays."""
        spec = spec or self._observing
        if spec not in self._cameras:
            self._cameras[spec] = open_camera(self._renderer, spec, body.model)
        try:
            return self._cameras[spec].render(body.data)
        except GLUnavailableError:  # in a forked worker, where rays still work
            if self._renderer != "auto":
                raise
            self._cameras[spec] = open_camera(self._renderer, spec, body.model)
            return self._cameras[spec].render(body.data)

    def observe(self, body: Body) -> dict[str, NDArray[Any]]:
        """Render the images of an observation: ``rgb`` uint8 and ``depth`` uint16 in millimetres, 0 where invalid."""
        self._last = rgb, depth = self.capture(body)
        # Millimetres as of a depth camera; values beyond the range of uint16 are invalid.
        millimetres = depth * 1000
        np.rint(millimetres, out=millimetres)
        millimetres[millimetres > 65535] = 0
        return {"rgb": rgb.copy(), "depth": millimetres.astype(np.uint16)}

    def render(self, body: Body, mode: str) -> Any:
        """Return the result of ``render`` for a render mode."""
        if mode == "human":
            self.show(body, mode)
            return None
        again = self._last if self._displaying == self._observing else None
        rgb, depth = again or self.capture(body, self._displaying)
        return rgb.copy() if mode == "rgb_array" else (rgb.copy(), depth.copy())

    def show(self, body: Body, mode: str | None) -> None:
        """Update the viewer if the render mode is "human"."""
        if mode == "human":
            self._viewer = self._viewer or Viewer(body.model, body.data, self._dt)
            self._viewer.sync()

    def refresh(self) -> None:
        """Reload textures and lights of the model."""
        for camera in self._cameras.values():
            camera.refresh()
        if self._viewer is not None:
            self._viewer.refresh()

    def close(self) -> None:
        """Free cameras and viewer; they are reopened on their next use."""
        for camera in self._cameras.values():
            camera.close()
        self._cameras.clear()
        self._last = None
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None


class Viewer:
    """MuJoCo's viewer: a window on the running physics, in real time, that the user can turn, zoom and close.

    Args:
        model: The MuJoCo model.
        data: Its data, as stepped by the environment.
        dt: Time between two images in seconds.

    Raises:
        GLUnavailableError: There is no display.
    """

    def __init__(self, model: Any, data: Any, dt: float) -> None:
        viewer: Any = importlib.import_module("mujoco.viewer") if has_display() else None
        # Without a display MuJoCo's launcher would wait forever for a window that never opens.
        if viewer is None or (sys.platform.startswith("linux") and not viewer.glfw.init()):
            raise GLUnavailableError(
                'render_mode="human" opens MuJoCo\'s viewer, and there is no display. Record a video instead: '
                'render_mode="rgb_array" with gymnasium.wrappers.RecordVideo.'
            )
        self._window = viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False)
        self._textures = int(model.ntex)
        self._dt, self._due = dt, time.monotonic()

    def sync(self) -> None:
        """Show the present state, at least ``dt`` after the last one."""
        if not self._window.is_running():  # the user closed it; the episode continues
            return
        self._window.sync()
        time.sleep(max(0.0, self._due - time.monotonic()))
        self._due = time.monotonic() + self._dt

    def refresh(self) -> None:
        """Reload the textures of the model."""
        if self._window.is_running():
            for texture in range(self._textures):
                self._window.update_texture(texture)

    def close(self) -> None:
        """Close the window; may be called twice."""
        self._window.close()


def has_display() -> bool:
    """Return whether a window can be expected to open."""
    if not sys.platform.startswith("linux"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
