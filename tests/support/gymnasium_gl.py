"""Run Gymnasium's renderer in separate processes, which take their OpenGL from MUJOCO_GL."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import cache
from importlib.util import find_spec

_PROBE = """
import mujoco
from gymnasium.envs.mujoco.mujoco_rendering import OffScreenViewer

model = mujoco.MjModel.from_xml_string('<mujoco><worldbody><geom size=".1"/></worldbody></mujoco>')
OffScreenViewer(model, mujoco.MjData(model), 16, 16).render("rgbd_tuple")
"""


def environment() -> dict[str, str]:
    """Return the variables of this process; on Linux MUJOCO_GL is EGL by default, which needs no display."""
    default = {"MUJOCO_GL": "egl"} if sys.platform.startswith("linux") else {}
    return {**default, **os.environ}


@cache
def missing() -> str:
    """Return why Gymnasium cannot draw a MuJoCo env here, or an empty string."""
    for name in ("mujoco", "imageio", "packaging"):
        if find_spec(name) is None:
            return f"Gymnasium's MuJoCo envs need {name}: pip install 'gymnasium[mujoco]'"
    done = subprocess.run(
        [sys.executable, "-c", _PROBE], env=environment(), capture_output=True, text=True, timeout=100, check=False
    )
    report = done.stderr.partition("Exception ignored")[0].strip()  # what comes after are complaints of destructors
    reason = report.splitlines()[-1] if report else f"exit code {done.returncode}"
    return "" if done.returncode == 0 else f"no OpenGL for Gymnasium's renderer: {reason}"
