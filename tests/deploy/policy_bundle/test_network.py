"""Bundles of several algorithms act exactly as the models did, in another process."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from bundles import cable, learner, old_bundle, registered
from gymnasium import spaces
from installed import needs
from known_ropes import fit, ropes
from rope_env import wrapped

import shape_obs_envs  # noqa: F401
from shape_obs import load_bundle, save_bundle
from shape_obs.deploy.policy_bundle import BundleError
from shape_obs.deploy.policy_bundle.archive import read_archive, write_archive
from shape_obs.deploy.policy_bundle.spaces import space_from_dict, space_to_dict
from shape_obs.training import Pixels

pytestmark = needs("mujoco", "stable_baselines3")


def switches() -> Any:
    """Return an environment of Gymnasium with six numbers and three actions, under an id of its own."""
    if "Switches-v0" not in gym.registry:
        gym.register("Switches-v0", "gymnasium.envs.classic_control:AcrobotEnv")
    return gym.make("Switches-v0", disable_env_checker=True)


def pixels() -> Any:
    return Pixels(gym.make("ShapeObs/Cable-v0", camera=[84, 84], disable_env_checker=True))


def models() -> dict[str, tuple[Any, ...]]:
    """Return for each kind of model its env, algorithm, policy and arguments."""
    import torch

    from shape_obs.training import GoalDifference, ImageAndGoal, PixelPolicy

    difference = {"features_extractor_class": GoalDifference, "features_extractor_kwargs": {"visible": 60}}
    buffer, steps = {"buffer_size": 10}, {"n_steps": 4, "batch_size": 4}
    return {
        "SAC": (cable, "SAC", "MultiInputPolicy", difference, buffer),
        "SAC from images": (pixels, "SAC", PixelPolicy, {"features_extractor_class": ImageAndGoal}, buffer),
        "SAC, noise by state": (cable, "SAC", "MultiInputPolicy", {}, {**buffer, "use_sde": True}),
        "PPO": (cable, "PPO", "MultiInputPolicy", {**difference, "activation_fn": torch.nn.ELU}, steps),
        "TD3": (cable, "TD3", "MultiInputPolicy", difference, buffer),
        "DQN": (switches, "DQN", "MlpPolicy", {}, buffer),
    }


def made(name: str) -> tuple[Any, Any]:
    """Return a model with untrained weights, and a vector env whose statistics have seen some steps."""
    import stable_baselines3 as sb3
    import torch
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    make, algorithm, policy, arguments, options = models()[name]
    torch.set_num_threads(1)
    keys = ["achieved_goal", "desired_goal"] if make is pixels else None
    env = VecNormalize(DummyVecEnv([make]), norm_reward=False, norm_obs_keys=keys)
    kwargs = {"net_arch": [16], **arguments}
    model = getattr(sb3, algorithm)(policy, env, policy_kwargs=kwargs, seed=1, device="cpu", **options)
    env.reset()
    for _ in range(3):
        env.step(np.array([env.action_space.sample()]))
    return model, env


ACT = """
import pickle, sys, torch
torch.set_num_threads(1)
from shape_obs import load_bundle
for path, observations, plays in pickle.load(open(sys.argv[1], "rb")):
    bundle = load_bundle(path)
    actions = [bundle.act(observation) for observation in observations]
    if plays:
        env = bundle.make_env()
        observation, _ = env.reset(seed=4)
        for _ in range(3):
            actions.append(bundle.act(observation))
            observation, *_ = env.step(actions[-1])
    print(*(action.tobytes().hex() for action in actions))
raise KeyboardInterrupt
"""


def test_a_fresh_process_acts_bit_for_bit_and_leaves_nothing(tmp_path):
    """The last bundle has a fitted file, which travels along: it lies in a temporary folder until the process ends."""
    work, expected = [], []
    for name in models():
        model, env = made(name)
        path = tmp_path / f"{name}.policy"
        save_bundle(model, env, path)
        seen = [env.observation_space.sample() for _ in range(3)]
        actions = [acted(model, env, one) for one in seen]
        if name == "SAC":
            actions += played(model, env)
        work.append((str(path), seen, name == "SAC"))
        expected.append([action.tobytes().hex() for action in actions])
    path, seen, actions = fitted(tmp_path)
    work.append((str(path), seen, False))
    expected.append([action.tobytes().hex() for action in actions])
    (tmp_path / "work").write_bytes(pickle.dumps(work))
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    done = subprocess.run(
        [sys.executable, "-c", ACT, tmp_path / "work"],
        env={**os.environ, "TMPDIR": str(temporary)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.stderr.rstrip().endswith("KeyboardInterrupt"), done.stderr
    assert [line.split() for line in done.stdout.splitlines()] == expected
    assert list(temporary.iterdir()) == []


def acted(model: Any, env: Any, observation: Any) -> Any:
    """Return the actions of the model itself."""
    whole = not isinstance(observation, dict)
    batch = observation[None] if whole else {key: value[None] for key, value in observation.items()}
    return model.predict(env.normalize_obs(batch), deterministic=True)[0][0]


def played(model: Any, env: Any) -> list[Any]:
    """Return the actions of the model in its environment."""
    plain = cable()
    observation, _ = plain.reset(seed=4)
    actions = []
    for _ in range(3):
        actions.append(acted(model, env, observation))
        observation, *_ = plain.step(actions[-1])
    return actions


def fitted(folder: Path) -> tuple[Path, list[Any], list[Any]]:
    """Return a policy that reads fitted features: (bundle, observations, actions)."""
    file = folder / "ropes.npz"
    fit(ropes(50)).save(file)
    env = wrapped(gym.make(registered(), disable_env_checker=True), features=[{"kind": "pca", "file": str(file)}])
    model = learner(env, "PPO", n_steps=4, batch_size=4)
    save_bundle(model, env, folder / "fitted.policy")
    seen = [env.reset(seed=0)[0]]
    file.unlink()
    bundle = load_bundle(folder / "fitted.policy")
    np.testing.assert_array_equal(bundle.make_env().reset(seed=0)[0], seen[0])
    assert bundle.record.config is not None
    extracted = Path(bundle.record.config["features"][0]["file"]).parent
    assert extracted.is_dir()
    del bundle
    assert not extracted.exists()
    return folder / "fitted.policy", seen, [model.predict(seen[0], deterministic=True)[0]]


@pytest.fixture(scope="module")
def sac(tmp_path_factory) -> dict[str, bytes]:
    """Return the members of a bundle."""
    path = Path(tmp_path_factory.mktemp("sac")) / "sac.policy"
    save_bundle(*made("SAC"), path)
    return read_archive(path).members


class TestTrust:
    """Content that names or holds code is read only with ``trust``, and the message says so."""

    WORDS = r"trust=True \(--trust on the command line\) only if you trust who made the file"

    def test_a_class_of_ones_own(self, tmp_path):
        import stable_baselines3 as sb3
        from own_extractor import OwnExtractor

        env = switches()
        kwargs = {"features_extractor_class": OwnExtractor}
        model = sb3.PPO("MlpPolicy", env, n_steps=4, batch_size=4, policy_kwargs=kwargs, seed=0, device="cpu")
        with pytest.warns(
            UserWarning, match="features_extractor_class='own_extractor:OwnExtractor' is not in the list"
        ):
            save_bundle(model, env, tmp_path / "a.policy")
        with pytest.raises(BundleError, match=f"OwnExtractor' is not in the list .*{self.WORDS}"):
            load_bundle(tmp_path / "a.policy")
        bundle = load_bundle(tmp_path / "a.policy", trust=True)
        assert type(bundle.policy.features_extractor) is OwnExtractor
        observation = env.observation_space.sample()
        np.testing.assert_array_equal(bundle.act(observation), model.predict(observation, deterministic=True)[0])

        class Local(OwnExtractor):
            pass

        kwargs = {"features_extractor_class": Local}
        model = sb3.PPO("MlpPolicy", env, n_steps=4, batch_size=4, policy_kwargs=kwargs, seed=0, device="cpu")
        with pytest.raises(BundleError, match="Local cannot be imported; define it at the top of a module"):
            save_bundle(model, env, tmp_path / "a.policy")

    def test_version_1_is_a_pickle(self, tmp_path):
        model, env = made("SAC")
        old_bundle(model, env, tmp_path / "old.policy")
        with pytest.raises(BundleError, match=f"a bundle of version 1, which holds a pickled model.*{self.WORDS}"):
            load_bundle(tmp_path / "old.policy")
        bundle = load_bundle(tmp_path / "old.policy", trust=True)
        observation = env.observation_space.sample()
        batch = {key: value[None] for key, value in observation.items()}
        expected = model.predict(env.normalize_obs(batch), deterministic=True)[0][0]
        np.testing.assert_array_equal(bundle.act(observation), expected)
        assert bundle.make_env().reset(seed=0)[0].keys() == observation.keys()

    def test_an_environment_that_is_not_registered(self, tmp_path):
        import stable_baselines3 as sb3

        env = switches()
        save_bundle(sb3.PPO("MlpPolicy", env, n_steps=4, batch_size=4, device="cpu"), env, tmp_path / "a.policy")
        del gym.registry["Switches-v0"]
        bundle = load_bundle(tmp_path / "a.policy")  # it acts, wherever its training ran
        assert bundle.act(env.observation_space.sample()) in range(3)
        with pytest.raises(BundleError, match=f"Switches-v0 is not registered here. Import the package.*{self.WORDS}"):
            bundle.make_env()
        assert type(load_bundle(tmp_path / "a.policy", trust=True).make_env().unwrapped).__name__ == "AcrobotEnv"

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            (
                {"id": "ShapeObs/D455-v0", "kwargs": {"robot": "my_lab.arm:Arm"}},
                "robot='my_lab.arm:Arm', which may name",
            ),
            (
                {"id": "ShapeObs/D455-v0", "kwargs": {"source": "my_lab:Cell-v0"}},
                "source='my_lab:Cell-v0'; only a camera",
            ),
            ({"kwargs": {"camera": [4096, 4096]}}, "camera is .4096, 4096., expected sides of at most 640 pixels"),
            (
                {"wrappers": [{"name": "Own", "entry_point": "a:Own", "kwargs": {}}]},
                r"Own \(a:Own\) is not in the list",
            ),
        ],
    )
    def test_arguments_of_an_environment(self, sac, tmp_path, changes, message):
        env = json.dumps({**json.loads(sac["env.json"]), **changes}).encode()
        write_archive(tmp_path / "a", {**sac, "env.json": env})
        with pytest.raises(BundleError, match=f"{message}.*{self.WORDS}"):
            load_bundle(tmp_path / "a").make_env()

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({"net_arch": [10**9]}, r"net_arch=\[1000000000\] is not in the list"),
            ({"net_arch": [16_384] * 16}, r"the policy has F32 of shape \[16384, .*, the file has"),
            ({"activation_fn": "os:system"}, "activation_fn='os:system' is not in the list"),
            ({"n_critics": 10**6}, "n_critics=1000000 is not in the list"),
        ],
    )
    def test_arguments_of_a_network(self, sac, tmp_path, arguments, message):
        record = json.loads(sac["policy.json"])
        record["network"]["arguments"] |= arguments
        write_archive(tmp_path / "a", {**sac, "policy.json": json.dumps(record).encode()})
        with pytest.raises(BundleError, match=message):
            load_bundle(tmp_path / "a")


@pytest.mark.parametrize(
    "space",
    [
        spaces.Box(np.array([0.1, -0.3], np.float32), np.array([0.7, 1e9], np.float32)),
        spaces.Box(0, 255, (4, 5, 3), np.uint8),
        spaces.Discrete(3, start=-1),
        spaces.MultiDiscrete([2, 5]),
        spaces.MultiBinary(4),
        spaces.Dict([("z", spaces.Discrete(2)), ("a", spaces.Box(-1, 1, (2,)))]),
    ],
)
def test_a_space_comes_back_as_it_was(space):
    again = space_from_dict(json.loads(json.dumps(space_to_dict(space))), "space")
    assert again == space
    if isinstance(space, spaces.Dict):
        assert list(again.spaces) == ["z", "a"]  # type: ignore[attr-defined]
