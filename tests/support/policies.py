"""Small environments and untrained or briefly trained policies for the tests of ``shape_obs.policy``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.spaces.utils import flatdim

from shape_obs.policy import load_policy, save_policy

VECTOR = spaces.Box(-3, 3, (5,), np.float64)
IMAGE = spaces.Box(0, 255, (36, 36, 3), np.uint8)
GOALS = spaces.Dict({name: spaces.Box(-1, 1, (6,)) for name in ("observation", "achieved_goal", "desired_goal")})
FORCE = spaces.Box(-np.array([1, 2], np.float32), np.array([1, 2], np.float32))


class Sampled(gym.Env[Any, Any]):
    """Return random observations, and refuse actions outside of the space."""

    dt = 0.05

    def __init__(self, observations: spaces.Space[Any] = VECTOR, actions: spaces.Space[Any] = FORCE) -> None:
        self.observation_space, self.action_space, self.steps = observations, actions, 0
        observations.seed(0)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.steps = 0
        return self.observation_space.sample(), {}

    def step(self, action: Any) -> Any:
        assert self.action_space.contains(action), action
        self.steps += 1
        return self.observation_space.sample(), -float(np.sum(np.abs(action))), False, self.steps > 20, {}

    def action_masks(self) -> Any:
        return np.ones(flatdim(self.action_space), bool)


def learner(env: Any, algorithm: str = "PPO", policy: Any = "Mlp", **options: Any) -> Any:
    """Return an untrained model with a small network, of a class of policies or of one of the learner's by its name."""
    import sb3_contrib
    import stable_baselines3 as sb3
    import torch

    torch.set_num_threads(1)
    kind = getattr(sb3, algorithm, None) or getattr(sb3_contrib, algorithm)
    if algorithm in ("PPO", "A2C", "TRPO", "MaskablePPO", "RecurrentPPO"):
        options = {"n_steps": 64, **options}
    elif algorithm != "ARS":
        options = {"buffer_size": 500, "learning_starts": 50, **options}
    layers = {"net_arch": [16], **options.pop("policy_kwargs", {})}
    policy = f"{policy}Policy" if isinstance(policy, str) else policy
    return kind(policy, env, seed=0, device="cpu", policy_kwargs=layers, **options)


def saved(model: Any, env: Any, path: Path, **options: Any) -> Any:
    """Save a policy, and load it again."""
    save_policy(model, env, path, **options)
    return load_policy(path)


# ---- The simulated cable

POINTS = {"kind": "points3d", "frame": "base"}
WORKSPACE = ((-1.0, -1.0, -1.0), (1.0, 1.0, 2.0))


def cable(keep: Any = None, **options: Any) -> Any:
    """Return the cable's environment, whose goals and points are in the base frame."""
    import shape_obs_envs  # noqa: F401
    from shape_obs import ShapeObservation

    env = gym.make("ShapeObs/Cable-v0", disable_env_checker=True, camera=[84, 84], reward_type="sparse")
    return ShapeObservation(env, keep=keep, **options)


def untrained(env: Any) -> Any:
    """Return an untrained model for the observations of an environment."""
    goals = isinstance(env.observation_space, spaces.Dict)
    return learner(env, "SAC", "MultiInput" if goals else "Mlp")


def trained_cable(path: Path) -> Any:
    """Save a briefly trained policy with hindsight replay, normalisation, monitor and curriculum, and load it."""
    from stable_baselines3 import HerReplayBuffer
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    from shape_obs.training import Curriculum

    env = VecNormalize(DummyVecEnv([lambda: Monitor(Curriculum(cable(), ["near"]))]), norm_reward=False, epsilon=1e-4)
    model = learner(env, "SAC", "MultiInput", replay_buffer_class=HerReplayBuffer, learning_starts=100)
    model.learn(12)
    return saved(model, env, path, summary={"note": "quick"})
