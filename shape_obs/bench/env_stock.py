"""The simulated environments drawn as one does at first: ``mujoco.Renderer`` as it comes, colours and depth in turn."""

from __future__ import annotations

import contextlib
import copy
import sys
from collections.abc import Iterator
from typing import Any, Final

import gymnasium as gym
import numpy as np

_QUALITY: Final = ("offsamples", "shadowsize", "numslices", "numstacks", "numquads")


class StockDrawing(gym.Wrapper[Any, Any, Any, Any]):
    """Adds ``rgb`` and ``depth`` [mm] to the observations of an environment that was told to draw nothing.

    The scene has the quality that MuJoCo gives a model that asks for none, and MuJoCo's scene flags; the lamp casts
    shadows, as lamps do by default, unless ``shadows`` is False. An object of geoms is drawn by these and not by the
    skin that spares the environment's camera drawing them.

    Args:
        env: A simulated environment with ``render_observation=False``.
        width: Of the images, pixels.
        height: Of the images, pixels.
        shadows: Whether the lamp casts them.

    Raises:
        GLUnavailableError: There is no OpenGL here.
    """

    def __init__(self, env: gym.Env[Any, Any], width: int, height: int, shadows: bool = True) -> None:
        from shape_obs_envs.mujoco.bodies import OBJECT_GROUP
        from shape_obs_envs.mujoco.scene import mujoco

        super().__init__(env)
        simulator: Any = env.unwrapped
        model, self._data = copy.copy(simulator._body.model), simulator._body.data
        usual = mujoco.MjModel.from_xml_string("<mujoco/>").vis.quality
        for name in _QUALITY:
            setattr(model.vis.quality, name, getattr(usual, name))
        model.light_castshadow[:] = shadows
        self._option = mujoco.MjvOption()
        self._option.flags[mujoco.mjtVisFlag.mjVIS_SKIN] = OBJECT_GROUP not in model.geom_group
        with _our_context(model, width, height):
            self._renderer = mujoco.Renderer(model, height, width)

    def step(self, action: Any) -> Any:
        """Step and draw."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._renderer.update_scene(self._data, "camera", self._option)
        rgb = self._renderer.render()
        self._renderer.enable_depth_rendering()
        depth = self._renderer.render()
        self._renderer.disable_depth_rendering()
        seen = {**observation, "rgb": rgb, "depth": np.rint(depth * 1000).astype(np.uint16)}
        return seen, reward, terminated, truncated, info

    def close(self) -> None:
        """Free the renderer and close the environment."""
        self._renderer.close()
        super().close()


@contextlib.contextmanager
def _our_context(model: Any, width: int, height: int) -> Iterator[None]:
    """Let ``mujoco.Renderer`` have the kind of OpenGL context that our cameras have, and the display they opened.

    By itself it takes the kind that MUJOCO_GL named when MuJoCo was imported, and without that a window's.
    """
    from shape_obs_envs.mujoco.cameras.gl_camera import open_context
    from shape_obs_envs.mujoco.scene import mujoco

    gl, context = open_context(model, width, height)
    context.free()
    gl.free()
    module = sys.modules[mujoco.Renderer.__module__].gl_context
    before = getattr(module, "GLContext", None)
    module.GLContext = type(gl)
    try:
        yield
    finally:
        module.GLContext = before
