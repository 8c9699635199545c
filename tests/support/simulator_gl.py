"""Whether the simulated environments can be drawn by OpenGL here."""

from __future__ import annotations

import gymnasium as gym
import pytest

import shape_obs_envs  # noqa: F401
from shape_obs_envs.mujoco.cameras.gl_camera import GLUnavailableError


def has_gl() -> bool:
    env = gym.make("ShapeObs/Cable-v0", camera=[84, 84], renderer="gl")
    try:
        env.reset(seed=0)
    except GLUnavailableError:
        return False
    finally:
        env.close()
    return True


needs_gl = pytest.mark.skipif(not has_gl(), reason="there is no OpenGL here")
RENDERERS = ["rays", pytest.param("gl", marks=needs_gl)]
