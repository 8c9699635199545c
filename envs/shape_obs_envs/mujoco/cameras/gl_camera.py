"""OpenGL camera: find a context that works, without a display if possible, and render RGB and depth in one pass."""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import importlib
import importlib.util
import os
import sys
import weakref
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.bodies import OBJECT_GROUP
from shape_obs_envs.mujoco.bodies.tube import TUBE
from shape_obs_envs.mujoco.cameras.rasterizer import SheetView
from shape_obs_envs.mujoco.scene import CAMERA, CameraSpec, mujoco

# Values of MUJOCO_GL that disable or do not restrict OpenGL.
_DISABLED = ("disable", "disabled", "off", "false", "0")
_ANY = ("", "enable", "enabled", "on", "true", "1")
_BACKENDS = ("egl", "osmesa", "glfw", "glx")
_LIBRARIES = {"egl": ("libEGL.so.1", "libEGL.so"), "osmesa": ("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so")}
# Effects that cost time and change nothing in a matt scene with one lamp.
_DISABLED_EFFECTS = ("SHADOW", "REFLECTION", "SKYBOX", "HAZE", "FOG")
_KEPT: list[Any] = []
_open: weakref.WeakSet[GLCamera] = weakref.WeakSet()
# The process that rendered first, and whether its driver works in a forked child.
_owner: dict[str, Any] = {"pid": None, "fork_safe": False}


class GLUnavailableError(RuntimeError):
    """No OpenGL context could be made; the message lists the attempts."""


class GLCamera:
    """Render RGB and depth in one pass.

    Args:
        spec: Size of the camera.
        model: A model from ``compile_scene``.

    Raises:
        GLUnavailableError: OpenGL is not available; the message lists the attempts.
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
        # Registered after the backend's exit function, which closes the display, and therefore run before it.
        atexit.unregister(_close_all)
        atexit.register(_close_all)
        _open.add(self)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        self._scene = mujoco.MjvScene(model, model.ngeom + 16)
        for flag in _DISABLED_EFFECTS:
            self._scene.flags[getattr(mujoco.mjtRndFlag, f"mjRND_{flag}")] = 0
        self._option = mujoco.MjvOption()
        if any(model.skin(i).name.endswith(TUBE) for i in range(model.nskin)):
            self._option.geomgroup[OBJECT_GROUP] = 0
        self._view = mujoco.MjvCamera()
        self._view.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._view.fixedcamid = model.camera(CAMERA).id
        self._rect = mujoco.MjrRect(0, 0, spec.width, spec.height)
        self._sheet = SheetView.of(model)

    def render(self, data: Any) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Render RGB ``(H, W, 3)`` and depth ``(H, W)`` in metres along the optical axis.

        Raises:
            GLUnavailableError: The camera is closed, or its process was forked and the driver does not survive it.
        """
        if self._context is None:
            raise GLUnavailableError("the camera is closed")
        if self._pid != os.getpid() and not fork_safe():
            self._abandon()
            raise GLUnavailableError("this process was forked from one that was already rendering")
        # Another camera of this process may have been current in the meantime.
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
        """Upload changed textures before the next image."""
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
        """Drop the parent process's context without running its destructors here."""
        _KEPT.append((self._gl, self._context))
        self._context = self._gl = None

    def __del__(self) -> None:
        if not sys.is_finalizing():  # the display may be closed by then, and the process frees everything
            self.close()


def _close_all() -> None:
    """Close the cameras that their environments left open."""
    for camera in list(_open):
        camera.close()


def fork_safe() -> bool:
    """Return whether contexts of a parent process work in its forked child: software rendering without threads."""
    return _owner["fork_safe"]


def open_context(model: Any, width: int, height: int) -> tuple[Any, Any]:
    """Make a GL context current and a MuJoCo drawing context in it.

    Args:
        model: The MuJoCo model to draw.
        width: Width of the images in pixels.
        height: Height of the images in pixels.

    Returns:
        The GL context (``make_current``, ``free``) and the ``mujoco.MjrContext``.

    Raises:
        GLUnavailableError: No backend works; the message contains the reason for each.
    """
    if _owner["pid"] not in (None, os.getpid()) and not fork_safe():
        raise GLUnavailableError(
            "this process was forked from one that was already rendering, which its GL driver does not survive: "
            'start workers with "spawn" or "forkserver", or before the first image'
        )
    backends, reasons = candidates(), []
    _bind_triton()
    for backend in backends:
        try:
            with _without_raster_threads():
                gl = make_context(backend, width, height)
                try:
                    gl.make_current()
                    model.vis.global_.offwidth, model.vis.global_.offheight = width, height
                    context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50.value)
                except (RuntimeError, mujoco.FatalError, *_gl_errors()) as error:
                    gl.free()
                    raise GLUnavailableError(f"{type(error).__name__}: {error}") from error
        except GLUnavailableError as error:
            reasons.append(f"{backend}: {error}")
            continue
        if _owner["pid"] is None:
            _owner.update(pid=os.getpid(), fork_safe=_is_threadless())
        return gl, context
    raise GLUnavailableError("; ".join(reasons))


def candidates() -> list[str]:
    """Return the backends to try, best first. ``MUJOCO_GL`` is respected if set, and never changed.

    Raises:
        GLUnavailableError: ``MUJOCO_GL`` disables OpenGL, or names no backend.
    """
    wish = os.environ.get("MUJOCO_GL", "").lower().strip()
    if wish in _DISABLED:
        raise GLUnavailableError(f"the environment variable MUJOCO_GL={wish} turns OpenGL off")
    if not sys.platform.startswith("linux"):
        return ["native"]  # MuJoCo's own choice there (CGL, WGL) needs no display server
    if wish not in (*_ANY, *_BACKENDS):
        raise GLUnavailableError(f"MUJOCO_GL={wish}: expected {', '.join(_BACKENDS)} or {_DISABLED[0]}")
    if wish not in _ANY:
        return ["glfw" if wish == "glx" else wish]
    display = ["glfw"] if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY") else []
    return ["egl", "osmesa", *display]


def make_context(backend: str, width: int, height: int) -> Any:
    """Make an OpenGL context with one of MuJoCo's backends; it is not current yet.

    Raises:
        GLUnavailableError: The context cannot be made; the message contains the reason.
    """
    if backend == "native":
        return mujoco.GLContext(width, height)
    platform = os.environ.get("PYOPENGL_PLATFORM")
    if backend in _LIBRARIES and platform not in (None, backend):
        raise GLUnavailableError(f"PYOPENGL_PLATFORM={platform}: expected {backend}, or no value")
    device = os.environ.get("MUJOCO_EGL_DEVICE_ID")
    if backend == "egl" and device is not None and not device.strip().isdecimal():
        raise GLUnavailableError(f"MUJOCO_EGL_DEVICE_ID={device}: expected the number of one device, such as 0")
    if backend in _LIBRARIES:
        _require_library(backend)
    try:
        module = importlib.import_module(f"mujoco.{backend}")
        if backend == "glfw" and not module.glfw.init():
            raise OSError("GLFW finds no display")
        return module.GLContext(width, height)
    # PyOpenGL raises AttributeError or TypeError for an incomplete library, and GLError for a failed call
    except (ImportError, AttributeError, TypeError, OSError, RuntimeError, *_gl_errors()) as error:
        if platform is None:  # MuJoCo's backend has set it, and the next one would refuse to load because of it
            os.environ.pop("PYOPENGL_PLATFORM", None)
        raise GLUnavailableError(f"{type(error).__name__}: {str(error).strip() or 'no message'}") from error


def _require_library(backend: str) -> None:
    """Check for the backend's library before PyOpenGL, which binds permanently to the first one that is requested."""
    for name in _LIBRARIES[backend]:
        try:
            ctypes.CDLL(name)
        except OSError:
            continue
        return
    raise GLUnavailableError(f"{_LIBRARIES[backend][0]} is not installed")


def _gl_errors() -> tuple[type[Exception], ...]:
    """Return PyOpenGL's error class if PyOpenGL has been imported."""
    module = sys.modules.get("OpenGL.error")
    return (module.Error,) if module else ()


def _bind_triton() -> None:
    """Bind triton's library to its own LLVM if triton is installed and not loaded yet.

    Mesa loads its drivers, and the LLVM they use, into the process's global scope. Triton, which torch loads with its
    first optimiser, would then use that LLVM and crash. Loading the library takes 12 ms once and imports neither triton
    nor torch.
    """
    if not sys.platform.startswith("linux") or "triton" in sys.modules:
        return
    spec = importlib.util.find_spec("triton")
    for folder in (spec.submodule_search_locations or ()) if spec else ():
        with contextlib.suppress(OSError):
            ctypes.CDLL(os.path.join(folder, "_C", "libtriton.so"))


@contextlib.contextmanager
def _without_raster_threads() -> Iterator[None]:
    """Make Mesa's software rasteriser draw in the calling thread.

    Its threads do not exist in a forked child, which would wait for them forever; and they gain nothing when many
    environments share the cores. The driver reads the variable when a display is first opened, so it is set only
    for that moment; a value set by the user is kept.
    """
    if "LP_NUM_THREADS" in os.environ:
        yield
        return
    os.environ["LP_NUM_THREADS"] = "0"
    try:
        yield
    finally:
        os.environ.pop("LP_NUM_THREADS", None)


def _is_threadless() -> bool:
    """Return whether the current context is a software one that draws in the calling thread."""
    if os.environ.get("LP_NUM_THREADS", "0") != "0":
        return False
    gl = sys.modules.get("OpenGL.GL") or importlib.import_module("OpenGL.GL")
    return any(name in gl.glGetString(gl.GL_RENDERER) for name in (b"llvmpipe", b"softpipe"))
