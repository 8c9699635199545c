"""What of OpenGL the simulated environments find here."""

from __future__ import annotations

import importlib


def no_opengl() -> str:
    """Why the environments cannot draw with OpenGL here; empty where they can."""
    return _asked()[1]


def opengl() -> str:
    """What draws: the driver's own name for it; empty without OpenGL."""
    return _asked()[0]


def _asked() -> tuple[str, str]:
    """What draws, and why nothing does: one of them is empty."""
    from shape_obs_envs.mujoco.cameras.gl_camera import GLUnavailableError, open_context
    from shape_obs_envs.mujoco.scene import mujoco

    try:
        gl, context = open_context(mujoco.MjModel.from_xml_string("<mujoco/>"), 16, 16)
    except GLUnavailableError as error:
        return "", str(error)
    try:
        functions = importlib.import_module("OpenGL.GL")
        return functions.glGetString(functions.GL_RENDERER).decode(), ""
    finally:
        context.free()
        gl.free()
