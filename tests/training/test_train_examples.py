"""Trainings: the examples stop and resume, hindsight relabels, the settings of the zoo train, no process hangs."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import subprocess
import sys
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import yaml

EXAMPLES = Path(__file__).parents[2] / "examples"
OFF_POLICY = {"learning_starts": 90, "buffer": 250}
SLOW = {"learning_starts": 190, "buffer": 250, "size": 40}  # a convolution takes its time
TINY: dict[str, dict[str, Any]] = {
    "train_sac_her": OFF_POLICY | {"goals": 1},
    "train_sac": OFF_POLICY | {"starts": 1},
    "train_ppo": {"envs": 2, "rollout": 25, "starts": 1},
    "train_cnn": SLOW | {"goals": 1},
}


def example(name: str) -> Any:
    spec = spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def unpickled(path: Path) -> Any:
    with path.open("rb") as file:
        return pickle.load(file)


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore:rich is", "ignore:The last trajectory", "ignore:You have specified a mini-batch")
@pytest.mark.parametrize("name", TINY)
def test_a_training_stops_and_goes_on(name, tmp_path, capsys):
    pytest.importorskip("mujoco")
    pytest.importorskip("stable_baselines3")
    import torch
    from stable_baselines3.common.save_util import load_from_zip_file

    from shape_obs.policy import load_policy

    threads = torch.get_num_threads()
    module = example(name)
    tiny = TINY[name] | {"out": tmp_path / "run", "evaluate_every": 100, "checkpoint_every": 100}
    module.main(module.Args(steps=100, **tiny))
    module.main(module.Args(steps=200, resume=True, **tiny))
    torch.set_num_threads(threads)

    run = tmp_path / "run"
    assert "after 200 steps" in capsys.readouterr().out
    first, last = ({"at": at, "data": load_from_zip_file(run / f"model_{at}_steps.zip")[0]} for at in (100, 200))
    for saved in (first, last):
        at, data = saved["at"], saved["data"]
        assert data is not None
        assert data["num_timesteps"] == at
        # One observation more than steps, that of a reset, in each start of each env.
        count = next(iter(unpickled(run / f"model_vecnormalize_{at}_steps.pkl").obs_rms.values())).count
        assert at <= count <= at + 5
        if name != "train_ppo":
            # What was seen before is still known; the step of the checkpoint itself comes in after it.
            buffer = unpickled(run / f"model_replay_buffer_{at}_steps.pkl")
            assert at - 2 <= (buffer.buffer_size if buffer.full else buffer.pos) <= at
    assert list(run.glob("*_1/events.out.tfevents.*"))
    assert load_policy(run / "cable.policy").spec.trained["steps"] == 200


def test_hindsight_replay_relabels_with_what_the_camera_saw():
    pytest.importorskip("mujoco")
    pytest.importorskip("stable_baselines3")
    import stable_baselines3 as sb3
    import torch
    from stable_baselines3.common.env_util import make_vec_env

    import shape_obs_envs  # noqa: F401

    torch.set_num_threads(1)
    envs = make_vec_env("ShapeObs/CableShape-v0", n_envs=2, env_kwargs={"renderer": "rays", "camera": [84, 84]}, seed=0)
    model = sb3.SAC(
        "MultiInputPolicy", envs, replay_buffer_class=sb3.HerReplayBuffer, learning_starts=190, batch_size=16,
        policy_kwargs={"net_arch": [16]}, seed=0, device="cpu",
    )  # fmt: skip
    model.learn(200)
    batch: Any = model.replay_buffer.sample(64)  # type: ignore[union-attr]
    seen, wanted = (batch.next_observations[key].numpy() for key in ("achieved_goal", "desired_goal"))
    by_hand = -np.linalg.norm((seen - wanted).reshape(64, 20, 3), axis=2).mean(axis=1)
    np.testing.assert_allclose(batch.rewards.numpy().ravel(), by_hand, atol=1e-5)
    goals = {goal.tobytes() for goal in wanted}
    assert len(goals) > 4  # two envs have two or four goals; the others are relabelled
    assert all(np.isfinite(value.numpy()).all() for value in batch.observations.values())


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


@pytest.mark.nightly
@pytest.mark.parametrize("method", ["fork", "forkserver", "spawn"])
def test_subproc_and_async_train(method):
    pytest.importorskip("mujoco")
    pytest.importorskip("stable_baselines3")
    if method not in multiprocessing.get_all_start_methods():
        pytest.skip(f"there is no {method} here")
    # As users run it: libraries may start as many threads as they like.
    free = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run(
        [sys.executable, Path(__file__).parents[1] / "support" / "vector_training.py", method],
        capture_output=True, text=True, timeout=280, env=free, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["trained", "100", "100"]
