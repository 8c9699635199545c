"""Which camera draws the pictures: OpenGL where there is one, rays where there is none."""

from __future__ import annotations

import logging
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.cameras.gl_camera import GLCamera
from shape_obs_envs.mujoco.cameras.gl_context import GLUnavailableError
from shape_obs_envs.mujoco.cameras.ray_camera import RayCamera
from shape_obs_envs.mujoco.scene import CameraSpec

RENDERERS = ("auto", "gl", "rays")
_logger = logging.getLogger("shape_obs_envs")
_told: set[str] = set()
_no_gl: list[str] = []


class Camera(Protocol):
    """An RGB-D camera over a compiled scene."""

    name: str

    def render(self, data: Any) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """RGB (H, W, 3) and depth (H, W) [m] along the optical axis; new arrays at each call."""
        ...

    def refresh(self) -> None:
        """Take over textures and lights of the model that have changed; all else is looked at for each picture."""
        ...

    def close(self) -> None:
        """Free what the camera holds; may be called twice."""
        ...


def open_camera(renderer: str, spec: CameraSpec, model: Any) -> Camera:
    """Open the camera that an environment's argument `renderer` asks for.

    Args:
        renderer: "gl", "rays", or "auto" for OpenGL with rays as a fallback.
        spec: The camera's size.
        model: A model from `compile_scene`.

    Raises:
        GLUnavailableError: `renderer="gl"` and there is no OpenGL.
    """
    if renderer == "rays":
        return RayCamera(spec, model)
    if renderer == "gl":
        try:
            return GLCamera(spec, model)
        except GLUnavailableError as error:
            raise GLUnavailableError(
                f'renderer="gl": {error}. Install a GL library (on Debian: apt-get install libegl1 libgl1-mesa-dri), '
                'or pass renderer="rays", which needs none.'
            ) from error
    if not _no_gl:
        try:
            camera = GLCamera(spec, model)
        except GLUnavailableError as error:
            _no_gl.append(str(error))  # it takes time to find out, and does not change
        else:
            _tell("gl", logging.INFO, "Rendering with OpenGL.")
            return camera
    _tell("rays", logging.WARNING, "Rendering with rays, which is slower: there is no OpenGL (%s).", _no_gl[0])
    return RayCamera(spec, model)


def _tell(key: str, level: int, message: str, *args: str) -> None:
    """Log once a process."""
    if key not in _told:
        _told.add(key)
        _logger.log(level, message, *args)
