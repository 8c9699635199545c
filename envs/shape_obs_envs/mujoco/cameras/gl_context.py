"""Which OpenGL there is: a context that works without a display where possible, else a reason why there is none."""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import importlib.util
import os
import sys
from collections.abc import Iterator
from typing import Any

from shape_obs_envs.mujoco.engine import mujoco

_OFF = ("disable", "disabled", "off", "false", "0")
_ON = ("", "enable", "enabled", "on", "true", "1")
_LIBRARIES = {"egl": ("libEGL.so.1", "libEGL.so"), "osmesa": ("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so")}


class GLUnavailableError(RuntimeError):
    """No OpenGL context could be made here; the message says what was tried."""


# The process that first rendered, and whether its driver works on in a forked child.
_owner: dict[str, Any] = {"pid": None, "fork_safe": False}


def fork_safe() -> bool:
    """Whether contexts of a parent process can be used in its forked child: software rendering without threads."""
    return _owner["fork_safe"]


def open_context(model: Any, width: int, height: int) -> tuple[Any, Any]:
    """Make a GL context current and a MuJoCo drawing context in it.

    Args:
        model: The MuJoCo model to draw.
        width: Width of the pictures [px].
        height: Height of the pictures [px].

    Returns:
        The GL context (`make_current`, `free`) and the `mujoco.MjrContext`.

    Raises:
        GLUnavailableError: No backend works; the message says why, one after the other.
    """
    if _owner["pid"] not in (None, os.getpid()) and not fork_safe():
        raise GLUnavailableError(
            "this process was forked off one that was already rendering, which its GL driver does not survive: "
            'start workers with "spawn" or "forkserver", or before the first picture'
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


def _bind_triton() -> None:
    """Bind triton's library to the LLVM within it, where triton is installed and not yet loaded.

    Mesa loads its drivers, and the LLVM they use, into the process's global scope; triton, which torch loads when it
    first makes an optimiser, would then take that LLVM for its own and crash. Loading the library takes 12 ms once and
    imports neither triton nor torch.
    """
    if not sys.platform.startswith("linux") or "triton" in sys.modules:
        return
    spec = importlib.util.find_spec("triton")
    for folder in (spec.submodule_search_locations or ()) if spec else ():
        with contextlib.suppress(OSError):
            ctypes.CDLL(os.path.join(folder, "_C", "libtriton.so"))


@contextlib.contextmanager
def _without_raster_threads() -> Iterator[None]:
    """Have Mesa's software rasteriser draw in the calling thread.

    Its threads would not exist in a forked child, which then waits for them for ever; and they bring nothing where
    many environments share the cores. The driver reads the variable when a display is first opened, so it is set
    for that moment only, and a user's own value stands.
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
    """Whether the current context is a software one that draws in the calling thread."""
    if os.environ.get("LP_NUM_THREADS", "0") != "0":
        return False
    gl = sys.modules.get("OpenGL.GL") or importlib.import_module("OpenGL.GL")
    return any(name in gl.glGetString(gl.GL_RENDERER) for name in (b"llvmpipe", b"softpipe"))


def candidates() -> list[str]:
    """The backends to try, best first. `MUJOCO_GL` is obeyed where it is set, and never changed.

    Raises:
        GLUnavailableError: `MUJOCO_GL` turns OpenGL off.
    """
    wish = os.environ.get("MUJOCO_GL", "").lower().strip()
    if wish in _OFF:
        raise GLUnavailableError(f"the environment variable MUJOCO_GL={wish} turns OpenGL off")
    if not sys.platform.startswith("linux"):
        return ["native"]  # MuJoCo's own choice there (CGL, WGL) needs no display server
    if wish not in _ON:
        return ["glfw" if wish == "glx" else wish]
    display = ["glfw"] if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY") else []
    return ["egl", "osmesa", *display]


def make_context(backend: str, width: int, height: int) -> Any:
    """An OpenGL context from one of MuJoCo's backends, not yet current.

    Raises:
        GLUnavailableError: It cannot be made; the message says why.
    """
    if backend == "native":
        return mujoco.GLContext(width, height)
    if backend in _LIBRARIES:
        _require_library(backend)
    had_platform = "PYOPENGL_PLATFORM" in os.environ
    try:
        module = importlib.import_module(f"mujoco.{backend}")
        if backend == "glfw" and not module.glfw.init():
            raise OSError("GLFW finds no display")
        return module.GLContext(width, height)
    # PyOpenGL tells of a library that lacks something with AttributeError or TypeError, of a failed call with GLError
    except (ImportError, AttributeError, TypeError, OSError, RuntimeError, *_gl_errors()) as error:
        if not had_platform:  # MuJoCo's backend has set it, and the next one would refuse to load because of it
            os.environ.pop("PYOPENGL_PLATFORM", None)
        raise GLUnavailableError(f"{type(error).__name__}: {str(error).strip() or 'no message'}") from error


def _require_library(backend: str) -> None:
    """Look for the backend's library before PyOpenGL does, which binds itself for good to the first it is asked for."""
    for name in _LIBRARIES[backend]:
        try:
            ctypes.CDLL(name)
        except OSError:
            continue
        return
    raise GLUnavailableError(f"{_LIBRARIES[backend][0]} is not installed")


def _gl_errors() -> tuple[type[Exception], ...]:
    """PyOpenGL's error, if PyOpenGL could be imported at all."""
    module = sys.modules.get("OpenGL.error")
    return (module.Error,) if module else ()
