"""A program that trains and steps several envs, one process each: ``python vector_training.py START_METHOD``."""

from __future__ import annotations

import sys
from typing import Any

import gymnasium as gym
from gymnasium.vector import AsyncVectorEnv, AutoresetMode

from shape_obs import ShapeObservation

WORKERS = 2
NET = {"net_arch": [16]}


def make(renderer: str = "auto", clustering: str = "som") -> gym.Env[Any, Any]:
    env = gym.make("shape_obs_envs:ShapeObs/Cable-v0", camera=[84, 84], renderer=renderer, max_episode_steps=25)
    ends = "tips" if clustering == "som" else "centers"
    return ShapeObservation(env, [{"kind": "centerline", "anchor": "gripper0", "ends": ends}], clustering=clustering)


def use_here() -> None:
    """Warm up Numba, OpenCV and scikit-learn, as a notebook may have done; a fork does not copy their threads."""
    env = make("rays", "kmeans")
    env.reset(seed=0)
    env.step(env.action_space.sample())
    env.close()


def subproc(method: str) -> int:
    """Train PPO on a vector env of Stable-Baselines3, and return the steps."""
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import SubprocVecEnv, VecNormalize

    envs = VecNormalize(SubprocVecEnv([make] * WORKERS, start_method=method))
    model = PPO("MultiInputPolicy", envs, n_steps=25, batch_size=25, n_epochs=1, policy_kwargs=NET, device="cpu")
    before = [value.clone() for value in model.policy.parameters()]
    model.learn(100)
    assert any((old != new).any() for old, new in zip(before, model.policy.parameters(), strict=True))
    envs.close()
    return model.num_timesteps


def asynchronous(method: str) -> int:
    """Step a vector env of Gymnasium, which Stable-Baselines3 refuses, and return the steps."""
    envs = AsyncVectorEnv([make] * WORKERS, context=method, autoreset_mode=AutoresetMode.SAME_STEP)
    envs.reset(seed=0)
    for _ in range(50):
        envs.step(envs.action_space.sample())
    envs.close()
    return 50 * WORKERS


if __name__ == "__main__":
    import torch

    torch.set_num_threads(1)
    use_here()
    print("trained", subproc(sys.argv[1]), asynchronous(sys.argv[1]))
