"""Whether the simulated environments can be drawn by OpenGL here; asked when the first test needs it."""

from __future__ import annotations

from functools import cache

import pytest


@cache
def has_gl() -> bool:
    """Draw one image."""
    import gymnasium as gym

    import shape_obs_envs  # noqa: F401
    from shape_obs_envs.mujoco.cameras.gl_camera import GLUnavailableError

    env = gym.make("ShapeObs/Cable-v0", camera=[84, 84], renderer="gl")
    try:
        env.reset(seed=0)
    except GLUnavailableError:
        return False
    finally:
        env.close()
    return True


# A string is evaluated when the test is set up, not when it is collected.
needs_gl = pytest.mark.skipif("not __import__('simulator_gl').has_gl()", reason="there is no OpenGL here")
RENDERERS = ["rays", pytest.param("gl", marks=needs_gl)]
