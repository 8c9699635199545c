"""Randomised environments for several tests."""

from __future__ import annotations

from typing import Any, cast

import gymnasium as gym
import numpy as np

import shape_obs_envs  # noqa: F401
from shape_obs_envs.mujoco.goal_env import ShapeGoalEnv

#: Environments with one object, and all of them.
SINGLE = ("Cable", "Ring", "Cloth", "Hanging")
ENVS = (*SINGLE, "Cables")


def make(name: str, randomize: Any = True, **options: Any) -> ShapeGoalEnv:
    """Return the bare environment."""
    env = gym.make(f"ShapeObs/{name}-v0", **{"camera": [84, 84], "renderer": "rays", **options}, randomize=randomize)
    return cast(ShapeGoalEnv, env.unwrapped)


def reset(env: ShapeGoalEnv, seed: int) -> tuple[Any, Any]:
    """Reset without the search for a goal, which takes most of the time."""
    return env.reset(seed=seed, options={"goal": np.zeros(env._goal.size)})


def play(env: ShapeGoalEnv, seed: int, steps: int = 4) -> list[Any]:
    """Return observations of a few random steps."""
    rng = np.random.default_rng(seed)
    assert env.action_space.shape is not None
    actions = rng.uniform(-1, 1, (steps, *env.action_space.shape)).astype(np.float32)
    return [reset(env, seed)[0], *(env.step(action)[0] for action in actions)]


def same(one: list[Any], other: list[Any], *keys: str) -> bool:
    """Return whether all observations, or these parts of them, are equal."""
    return all(np.array_equal(a[key], b[key]) for a, b in zip(one, other, strict=True) for key in keys or a)
