"""MuJoCo's own viewer, for a person who watches."""

from __future__ import annotations

import importlib
import os
import sys
import time
from typing import Any

from shape_obs_envs.mujoco.cameras.gl_context import GLUnavailableError


def has_display() -> bool:
    """Whether a window can be expected to open."""
    if not sys.platform.startswith("linux"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


class Viewer:
    """A window on the running physics, shown in real time; the window is the user's to turn, zoom and close.

    Args:
        model: The MuJoCo model.
        data: Its data, as the environment steps it.
        dt: Seconds between two pictures.

    Raises:
        GLUnavailableError: There is no display to open a window on.
    """

    def __init__(self, model: Any, data: Any, dt: float) -> None:
        viewer: Any = importlib.import_module("mujoco.viewer") if has_display() else None
        # Without a display MuJoCo's launcher would wait for ever for a window that never opens.
        if viewer is None or (sys.platform.startswith("linux") and not viewer.glfw.init()):
            raise GLUnavailableError(
                'render_mode="human" opens MuJoCo\'s viewer, and there is no display here. Record a video instead: '
                'render_mode="rgb_array" with gymnasium.wrappers.RecordVideo.'
            )
        self._window = viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False)
        self._textures = int(model.ntex)
        self._dt, self._due = dt, time.monotonic()

    def sync(self) -> None:
        """Show the present state, no sooner than `dt` after the last one."""
        if not self._window.is_running():  # the user closed it; the episode goes on
            return
        self._window.sync()
        time.sleep(max(0.0, self._due - time.monotonic()))
        self._due = time.monotonic() + self._dt

    def refresh(self) -> None:
        """Take over textures of the model that have changed."""
        if self._window.is_running():
            for texture in range(self._textures):
                self._window.update_texture(texture)

    def close(self) -> None:
        """Close the window; may be called twice."""
        self._window.close()
