"""Policies compute the actions of the learner, with the wrappers of its training, or are refused by name."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from installed import needs
from policies import FORCE, GOALS, IMAGE, VECTOR, Sampled, learner, saved

import shape_obs
from shape_obs.policy import PolicyError, load_policy, save_policy, save_policy_onnx
from shape_obs.policy.policy import action_difference

pytestmark = needs("stable_baselines3", "sb3_contrib", "onnxscript", "onnxruntime")
W = gym.wrappers
DISCRETE = spaces.Discrete(4)


def vector(make: Any, *wrappers: Any, count: int = 1) -> Any:
    """Return a vector environment in wrappers of Stable-Baselines3, the innermost first."""
    from stable_baselines3.common import vec_env

    env: Any = vec_env.DummyVecEnv([make] * count)
    for name, options in wrappers:
        env = getattr(vec_env, name)(env, **options)
    return env


def actions(policy: Any, model: Any, seen: list[Any], **options: Any) -> float:
    """Return the largest difference of the actions of a policy and of its learner in one episode."""
    policy.reset()
    state, largest = None, 0.0
    for i, observation in enumerate(seen):
        masks = {"action_masks": options["mask"]} if options else {}
        wanted, state = model.predict(observation, state, np.array([i == 0]), deterministic=True, **masks)
        found = policy.act(observation, options.get("mask"))
        largest = max(largest, action_difference(policy.spec.action, found, wanted))
    return largest


ALGORITHMS = [
    ("SAC", FORCE), ("TQC", FORCE), ("TD3", FORCE), ("DDPG", FORCE), ("CrossQ", FORCE), ("ARS", FORCE), ("PPO", FORCE),
    ("A2C", FORCE), ("TRPO", FORCE), ("RecurrentPPO", FORCE), ("DQN", DISCRETE), ("QRDQN", DISCRETE),
    ("ARS", DISCRETE), ("MaskablePPO", DISCRETE), ("PPO", DISCRETE), ("PPO", spaces.MultiDiscrete([3, 4])),
    ("PPO", spaces.MultiBinary(3)), ("MaskablePPO", spaces.MultiDiscrete([3, 4])),
]  # fmt: skip
TRAINED = [
    *(pytest.param(*case, 2000, marks=pytest.mark.nightly) for case in ALGORITHMS),
    *((name, space, 100) for name, space in ALGORITHMS if (name, space) in (("SAC", FORCE), ("DQN", DISCRETE))),
]


@pytest.mark.parametrize(("algorithm", "space", "steps"), TRAINED)
def test_algorithms_act_as_the_learner_after_training(algorithm, space, steps, tmp_path):
    env = Sampled(VECTOR, space)
    model = learner(env, algorithm, "MlpLstm" if algorithm == "RecurrentPPO" else "Mlp")
    model.learn(steps)
    policy = saved(model, env, tmp_path / "a.policy")
    mask = np.random.default_rng(1).random(policy.spec.mask or 1) < 0.7
    mask[-1] = mask[0] = True
    options = {"mask": mask} if policy.spec.mask else {}
    assert actions(policy, model, [VECTOR.sample() for _ in range(1000)], **options) < 1e-5
    assert policy.spec.trained["algorithm"] == algorithm


NORMALIZED, STACKED = ("VecNormalize", {}), ("VecFrameStack", {"n_stack": 2})
ONE_NORMALIZED = ("VecNormalize", {"norm_obs_keys": ["observation"]})
ZERO = {"padding_type": "zero"}
IMAGE_AND_GOAL = spaces.Dict({**GOALS.spaces, "observation": IMAGE})


def goals() -> dict[str, Any]:
    from shape_obs.training import GoalDifference

    return {"policy_kwargs": {"features_extractor_class": GoalDifference}}


def pixels() -> dict[str, Any]:
    from shape_obs.training import ImageAndGoal, PixelPolicy

    return {"policy": PixelPolicy, "policy_kwargs": {"features_extractor_class": ImageAndGoal}}


MODELS: dict[str, Any] = {
    "VecNormalize": lambda: learner(vector(Sampled, NORMALIZED)),
    "NormalizeObservation": lambda: learner(W.NormalizeObservation(Sampled())),
    "frames repeated": lambda: learner(W.FlattenObservation(W.FrameStackObservation(Sampled(), 3))),
    "frames of zeros": lambda: learner(W.FrameStackObservation(W.NormalizeObservation(Sampled()), 3, **ZERO)),
    "VecFrameStack": lambda: learner(vector(Sampled, STACKED, NORMALIZED, count=2)),
    "VecFrameStack outside": lambda: learner(vector(Sampled, NORMALIZED, STACKED)),
    "RescaleAction": lambda: learner(W.RescaleAction(Sampled(), np.float32(-2), np.float32(2))),
    "goals": lambda: learner(vector(lambda: Sampled(GOALS), ONE_NORMALIZED), policy="MultiInput"),
    "filter": lambda: learner(W.FilterObservation(Sampled(GOALS), ["desired_goal"]), policy="MultiInput"),
    "reshape": lambda: learner(W.ReshapeObservation(Sampled(), (5, 1))),
    "image": lambda: learner(Sampled(IMAGE), policy="Cnn"),
    "images stacked": lambda: learner(vector(lambda: Sampled(IMAGE), STACKED), policy="Cnn"),
    "image and numbers": lambda: learner(Sampled(spaces.Dict({"i/m": IMAGE, "n": VECTOR})), policy="MultiInput"),
    "number": lambda: learner(Sampled(spaces.Discrete(7))),
    "GoalDifference": lambda: learner(vector(lambda: Sampled(GOALS), NORMALIZED), "SAC", "MultiInput", **goals()),
    "PixelPolicy": lambda: learner(Sampled(IMAGE_AND_GOAL), "SAC", **pixels()),
    "gSDE": lambda: learner(Sampled(), "SAC", use_sde=True),
    "gSDE squashed": lambda: learner(Sampled(), "PPO", use_sde=True, policy_kwargs={"squash_output": True}),
}


@pytest.mark.nightly
@pytest.mark.parametrize("name", MODELS)
def test_wrappers_become_part_of_the_network(name, tmp_path):
    model = MODELS[name]()
    model.learn(128)
    # Compares 64 actions behind the training's own wrappers.
    policy = saved(model, model.get_env(), tmp_path / "a.policy")
    assert policy.spec.trained["steps"] == model.num_timesteps
    if name == "RescaleAction":
        np.testing.assert_array_equal(policy.spec.action.high, FORCE.high)
    if name.startswith("frames"):  # an episode does not see the one before it
        first = [policy.act(np.ones(5)), policy.reset(), policy.act(np.ones(5))]
        np.testing.assert_array_equal(first[0], first[2])


@pytest.mark.nightly
def test_recurrent_policies_with_goals_remember_an_episode(tmp_path):
    env = vector(lambda: Sampled(GOALS), ("VecNormalize", {}))
    model = learner(env, "RecurrentPPO", "MultiInputLstm")
    policy = saved(model, env, tmp_path / "a.policy")
    seen: Any = [GOALS.sample() for _ in range(200)]
    state, largest = None, 0.0
    for observation in seen:
        wanted, state = model.predict(env.normalize_obs(observation), state, deterministic=True)
        largest = max(largest, action_difference(policy.spec.action, policy.act(observation), wanted))
    assert largest < 1e-5
    again = [policy.act(seen[0]), policy.reset(), policy.act(seen[0])]
    assert not np.array_equal(again[0], again[2])


class Counting(gym.ObservationWrapper[Any, Any, Any]):
    """Keep a running mean."""

    def __init__(self, env: Any) -> None:
        super().__init__(env)
        self.running_mean = np.zeros(5)

    def observation(self, observation: Any) -> Any:
        return observation - self.running_mean


class Noisy(gym.ActionWrapper[Any, Any, Any]):
    """Change actions."""

    def action(self, action: Any) -> Any:
        return action


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Counting(Sampled()), r"statistics that the wrapper Counting keeps in 'running_mean'"),
        (lambda: Counting(W.NormalizeObservation(Sampled())), "Counting keeps in 'running_mean'"),
        (lambda: W.DtypeObservation(W.NormalizeObservation(Sampled()), np.float64), "keeps in 'obs_rms'"),
        (lambda: Noisy(Sampled()), "a policy cannot hold what Noisy changes"),
        (lambda: vector(Sampled, ("VecExtractDictObs", {"key": "observation"})), "VecExtractDictObs changes"),
        (lambda: vector(lambda: W.NormalizeObservation(Sampled()), count=2), "each of several environments has"),
    ],
)  # fmt: skip
def test_what_a_policy_cannot_hold_is_refused_by_name(make, message, tmp_path, monkeypatch):
    from stable_baselines3.common import vec_env

    monkeypatch.setattr(vec_env.VecExtractDictObs, "__init__", lambda self, venv, key: setattr(self, "venv", venv))
    with pytest.raises(PolicyError, match=message):
        save_policy(learner(Sampled()), make(), tmp_path / "a.policy")
    assert list(tmp_path.iterdir()) == []


def test_a_policy_that_computes_something_else_is_found_out(tmp_path):
    model = learner(Sampled())
    own = model.policy.predict
    model.policy.predict = lambda *args, **options: (own(*args, **options)[0] + 0.5, None)
    with pytest.raises(PolicyError, match=r"the network does not compute what the learner did: action .* of 64"):
        save_policy(model, Sampled(), tmp_path / "a.policy")
    model.policy = SimpleNamespace(action_space=FORCE)  # of another library
    with pytest.raises(PolicyError, match=r"the policy SimpleNamespace of PPO cannot be .* use save_policy_onnx"):
        save_policy(model, Sampled(), tmp_path / "a.policy")


def test_networks_of_other_learners(tmp_path):
    import torch

    network = torch.nn.Sequential(torch.nn.Linear(5, 8), torch.nn.Tanh(), torch.nn.Linear(8, 2), torch.nn.Tanh())
    seen = [VECTOR.sample().astype(np.float32) for _ in range(40)]
    wanted = [network(torch.from_numpy(one)).detach().numpy() for one in seen]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            network, (torch.zeros(1, 5),), tmp_path / "own.onnx", dynamo=True, external_data=False, verbose=False
        )
    env = Sampled()  # whose observations are float64
    save_policy_onnx(tmp_path / "a.policy", tmp_path / "own.onnx", env, seen, wanted, summary={"learner": "own"})
    policy = load_policy(tmp_path / "a.policy")
    np.testing.assert_allclose(policy.act(seen[3]), wanted[3], atol=1e-6)
    assert policy.spec.trained["learner"] == "own"
    for changed, message in (
        ((seen[:9], wanted[:9]), "expected 32 to 1024 steps of observation/input, action, start"),
        ((seen, wanted[::-1]), "does not compute what the learner did"),
    ):
        with pytest.raises(PolicyError, match=message):
            save_policy_onnx(tmp_path / "b.policy", tmp_path / "own.onnx", env, *changed)
    assert not (tmp_path / "b.policy").exists()


@pytest.mark.parametrize("verb", ["save", "load"])
def test_the_names_of_before_say_what_to_call(verb):
    with pytest.raises(ImportError, match=f"was removed: call shape_obs.{verb}_policy"):
        getattr(shape_obs, f"{verb}_bundle")


#: Save a small policy, and stop as if the process were killed when the second file is written.
KILLED = """
import os, sys, zipfile
import numpy as np
from policies import Sampled
from test_hostile import network
from gymnasium.spaces import Box
from shape_obs.policy import save_policy_onnx
written = []
def write(*args):
    written.append(args)
    if len(written) == 2:
        os._exit(9)
zipfile.ZipFile.writestr = write
seen = np.zeros((32, 4), np.float32)
save_policy_onnx(sys.argv[1], network(), Sampled(Box(-1, 1, (4,)), Box(-1, 1, (2,))), list(seen), np.zeros((32, 2)))
"""


@pytest.mark.parametrize("before", [None, b"another policy"])
def test_a_process_that_is_killed_while_saving_leaves_what_was_there(before, tmp_path):
    path, tests = tmp_path / "a.policy", Path(__file__).parents[1]
    if before is not None:
        path.write_bytes(before)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (tests / "support", tests / "policy")))}
    done = subprocess.run([sys.executable, "-c", KILLED, str(path)], env=environment, capture_output=True, check=False)
    assert done.returncode == 9, done.stderr
    assert (path.read_bytes() if path.exists() else None) == before
    assert len(list(tmp_path.glob(".a.policy.*"))) == 1  # the temporary file, which was being written
