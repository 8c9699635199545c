"""Cameras that render a scene: OpenGL if available, otherwise rays."""

from __future__ import annotations

import logging
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.cameras.gl_camera import GLCamera, GLUnavailableError
from shape_obs_envs.mujoco.cameras.ray_camera import RayCamera
from shape_obs_envs.mujoco.scene import CameraSpec

RENDERERS = ("auto", "gl", "rays")
_logger = logging.getLogger("shape_obs_envs")
_logged: set[str] = set()
_no_gl: list[str] = []


class Camera(Protocol):
    """An RGB-D camera in a compiled scene."""

    name: str

    def render(self, data: Any) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Render RGB ``(H, W, 3)`` and depth ``(H, W)`` in metres along the optical axis to new arrays."""
        ...

    def refresh(self) -> None:
        """Reload textures and lights of the model; everything else is read for each image."""
        ...

    def close(self) -> None:
        """Free the camera's resources; may be called twice."""
        ...


def open_camera(renderer: str, spec: CameraSpec, model: Any) -> Camera:
    """Open the camera for an environment's argument ``renderer``.

    Args:
        renderer: "gl", "rays", or "auto" for OpenGL with rays as a fallback.
        spec: Size of the camera.
        model: A model from ``compile_scene``.

    Raises:
        GLUnavailableError: ``renderer="gl"``, and OpenGL is not available.
    """
    if renderer == "rays":
        return RayCamera(spec, model)
    if renderer == "gl":
        try:
            return GLCamera(spec, model)
        except GLUnavailableError as error:
            raise GLUnavailableError(
                f'renderer="gl": {error}. Correct the variable, or install a GL library that is missing (on Debian: '
                'apt-get install libegl1 libgl1-mesa-dri), or pass renderer="rays", which needs none.'
            ) from error
    if not _no_gl:
        try:
            camera = GLCamera(spec, model)
        except GLUnavailableError as error:
            _no_gl.append(str(error))  # detecting it takes time, and it does not change
        else:
            _log_once("gl", logging.INFO, "Rendering with OpenGL.")
            return camera
    message = "Rendering with rays, which is slower: OpenGL is not available (%s)."
    _log_once("rays", logging.WARNING, message, _no_gl[0])
    return RayCamera(spec, model)


def _log_once(key: str, level: int, message: str, *args: str) -> None:
    """Log once per process."""
    if key not in _logged:
        _logged.add(key)
        _logger.log(level, message, *args)
