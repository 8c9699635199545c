"""The hyperparameters for rl-baselines3-zoo fit the environment and train."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest
import yaml

ZOO = sorted((Path(__file__).parents[2] / "examples" / "zoo").glob("*.yml"))


def named(path: str) -> Any:
    """Import a class as the zoo's ``get_class_by_name`` does."""
    module, _, name = path.rpartition(".")
    return getattr(import_module(module), name)


def wrapping(wrappers: list[Any]) -> Any:
    def wrap(env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
        for wrapper in wrappers:
            ((path, arguments),) = wrapper.items()
            env = named(path)(env, **arguments)
        return env

    return wrap


@pytest.mark.nightly
@pytest.mark.parametrize("path", ZOO, ids=lambda path: path.name)
def test_hyperparameters_train(path):
    pytest.importorskip("mujoco")
    pytest.importorskip("stable_baselines3")
    import stable_baselines3 as sb3
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import VecNormalize

    import_module("shape_obs_envs")  # --gym-packages
    for name, given in yaml.safe_load(path.read_text(encoding="utf-8")).items():
        wrap = wrapping(given.pop("env_wrapper"))
        env = make_vec_env(name, env_kwargs=given.pop("env_kwargs"), wrapper_class=wrap)
        env = VecNormalize(env, **given.pop("normalize"))
        assert given.pop("n_timesteps") == 50_000
        known = {"HerReplayBuffer": sb3.HerReplayBuffer, "get_class_by_name": named}
        for key in ("policy_kwargs", "replay_buffer_class", "replay_buffer_kwargs"):
            given[key] = eval(given[key], known)
        model = sb3.SAC(env=env, device="cpu", **given | {"learning_starts": 98})
        model.learn(100)
        assert model._n_updates > 0
        assert model.policy.observation_space["observation"].shape == (60,)  # type: ignore[index]
        env.close()
