"""A cable environment and a small trained policy for tests of bundles."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from rope_env import wrapped

import shape_obs_envs  # noqa: F401
from shape_obs import ShapeObservation, save_bundle
from shape_obs.training import Curriculum

CABLE = {"camera": [84, 84], "reward_type": "sparse"}
POINTS = {"kind": "points3d", "frame": "base"}


def cable(keep=None, **options) -> Any:
    env = gym.make("shape_obs_envs:ShapeObs/Cable-v0", disable_env_checker=True, **CABLE)
    return ShapeObservation(env, keep=keep, **options)


def learner(env, algorithm="SAC", **options) -> Any:
    import stable_baselines3 as sb3
    import torch

    torch.set_num_threads(1)
    if algorithm == "SAC":
        options = {"buffer_size": 100, **options}
    policy = "MultiInputPolicy" if isinstance(env.observation_space, gym.spaces.Dict) else "MlpPolicy"
    return getattr(sb3, algorithm)(policy, env, policy_kwargs={"net_arch": [16]}, seed=0, device="cpu", **options)


def train(path: Path, **options: Any) -> Any:
    """Return a saved model and its vector env with hindsight replay, normalisation, monitor and curriculum."""
    import stable_baselines3 as sb3
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    env = VecNormalize(
        DummyVecEnv([lambda: Monitor(Curriculum(cable(**options), ["near"]))]), norm_reward=False, epsilon=1e-4
    )
    model = learner(env, replay_buffer_class=sb3.HerReplayBuffer, learning_starts=100)
    model.learn(12)
    save_bundle(model, env, path, summary={"note": "quick"})
    return model, env


def old_bundle(model, env, path: Path) -> None:
    """Write a bundle as version 1 was, with the model's own zip file."""
    from safetensors.numpy import load

    from shape_obs.deploy.policy_bundle.archive import read_archive, write_archive

    save_bundle(model, env, path)
    members = read_archive(path).members
    record = json.loads(members["policy.json"])
    record["algorithm"] = f"stable_baselines3:{record.pop('network')['algorithm']}"
    described = json.loads(members["env.json"])
    described["additional_wrappers"] = described.pop("wrappers")
    saved, statistics = io.BytesIO(), io.BytesIO()
    model.save(saved)
    np.savez(statistics, **load(members["statistics.safetensors"]))  # type: ignore[arg-type]
    old = {
        "model.zip": saved.getvalue(),
        "statistics.npz": statistics.getvalue(),
        "env.json": json.dumps(described).encode(),
        "policy.json": json.dumps(record).encode(),
        "config.yaml": members["config.yaml"],
    }
    write_archive(path, old, version=1)


WORKSPACE = ((-1.0, -1.0, -1.0), (1.0, 1.0, 2.0))


class Twice(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """A frame skip of a user."""

    def __init__(self, env: Any) -> None:
        RecordConstructorArgs.__init__(self)
        gym.Wrapper.__init__(self, env)

    def step(self, action: Any) -> Any:
        self.env.step(action)
        return self.env.step(action)


def rope(n: int, around: Callable[[Any], Any] = lambda env: env) -> Any:
    shapes = [{"kind": "centerline", "n": n}]
    env = around(gym.make(registered(), disable_env_checker=True))
    return wrapped(env, shapes=shapes, features=[POINTS], workspace=WORKSPACE)


def registered() -> str:
    if "BundleRope-v0" not in gym.registry:
        gym.register("BundleRope-v0", "rope_env:RopeEnv")
    return "BundleRope-v0"
