"""The camera as OpenGL draws it."""

from __future__ import annotations

import atexit
import os
import sys
import weakref
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.bodies.base import OBJECT_GROUP
from shape_obs_envs.mujoco.bodies.tube import TUBE
from shape_obs_envs.mujoco.cameras.gl_context import GLUnavailableError, fork_safe, open_context
from shape_obs_envs.mujoco.cameras.sheet_view import SheetView
from shape_obs_envs.mujoco.engine import mujoco
from shape_obs_envs.mujoco.scene import CAMERA, CameraSpec

# What costs time and brings nothing to a matt scene under one lamp.
_OFF = ("SHADOW", "REFLECTION", "SKYBOX", "HAZE", "FOG")
_KEPT: list[Any] = []
_open: weakref.WeakSet[GLCamera] = weakref.WeakSet()


class GLCamera:
    """Renders RGB and depth in one pass.

    Args:
        spec: The camera's size.
        model: A model from `compile_scene`.

    Raises:
        GLUnavailableError: There is no OpenGL here; the message says what was tried.
    """

    name = "gl"

    def __init__(self, spec: CameraSpec, model: Any) -> None:
        self._model = model
        self._size = (spec.height, spec.width)
        self._gl: Any = None
        self._context: Any = None
        self._pid = os.getpid()
        self._stale = False
        self._gl, self._context = open_context(model, spec.width, spec.height)
        # Registered after the backend's own exit function, which closes the display, and so run before it.
        atexit.unregister(_close_all)
        atexit.register(_close_all)
        _open.add(self)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        self._scene = mujoco.MjvScene(model, model.ngeom + 16)
        for flag in _OFF:
            self._scene.flags[getattr(mujoco.mjtRndFlag, f"mjRND_{flag}")] = 0
        self._option = mujoco.MjvOption()
        if any(model.skin(i).name == TUBE for i in range(model.nskin)):
            self._option.geomgroup[OBJECT_GROUP] = 0
        self._view = mujoco.MjvCamera()
        self._view.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._view.fixedcamid = model.camera(CAMERA).id
        self._rect = mujoco.MjrRect(0, 0, spec.width, spec.height)
        self._sheet = SheetView.of(model)

    def render(self, data: Any) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Draw the scene: rgb (H, W, 3) and depth (H, W) [m] along the optical axis.

        Raises:
            GLUnavailableError: After `close`, or in a process forked off one whose driver does not survive it.
        """
        if self._context is None:
            raise GLUnavailableError("the camera is closed")
        if self._pid != os.getpid() and not fork_safe():
            self._abandon()
            raise GLUnavailableError("this process was forked off one that was already rendering")
        # Another camera of this process may have been current since.
        self._gl.make_current()
        if self._stale:
            for texture in range(self._model.ntex):
                mujoco.mjr_uploadTexture(self._model, self._context, texture)
            self._stale = False
        mujoco.mjv_updateScene(
            self._model, data, self._option, None, self._view, mujoco.mjtCatBit.mjCAT_ALL.value, self._scene
        )
        if self._sheet is not None:
            self._sheet.fill(self._scene, data)
        mujoco.mjr_render(self._rect, self._scene, self._context)
        rgb, depth = np.empty((*self._size, 3), np.uint8), np.empty(self._size, np.float32)
        mujoco.mjr_readPixels(rgb, depth, self._rect, self._context)
        near, far = self._model.vis.map.znear, self._model.vis.map.zfar  # the model's extent is 1
        metres = near * far / (near + depth * np.float32(far - near))
        return np.ascontiguousarray(rgb[::-1]), np.ascontiguousarray(metres[::-1], np.float32)

    def refresh(self) -> None:
        """Have changed textures uploaded before the next picture."""
        self._stale = True

    def close(self) -> None:
        """Free the context; may be called twice."""
        if self._context is None:
            return
        if self._pid != os.getpid() and not fork_safe():
            self._abandon()
            return
        # The drawing context deletes its buffers by number from whichever GL context is current.
        self._gl.make_current()
        self._context.free()
        self._gl.free()
        self._context = self._gl = None

    def _abandon(self) -> None:
        """Let go of what belongs to the parent process without running its destructors here."""
        _KEPT.append((self._gl, self._context))
        self._context = self._gl = None

    def __del__(self) -> None:
        if not sys.is_finalizing():  # the display may be gone by then, and the process takes all with it
            self.close()


def _close_all() -> None:
    """Close the cameras that their environments left open."""
    for camera in list(_open):
        camera.close()
