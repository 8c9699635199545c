"""Saved and loaded bundles act as trained; what does not fit is refused by name."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import warnings
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import yaml
from bundles import Twice, cable, learner, rope, train
from gymnasium import wrappers
from gymnasium.utils import RecordConstructorArgs
from gymnasium.wrappers import RepeatAction
from installed import needs

import shape_obs_envs  # noqa: F401
from shape_obs import load_bundle, save_bundle, schema_hash
from shape_obs.config.detector_config import ALGORITHM
from shape_obs.deploy.policy_bundle import BundleError
from shape_obs.deploy.policy_bundle.archive import read_archive, write_archive
from shape_obs.training import Shuffled
from shape_obs_envs.robots import NullRobot

pytestmark = needs("mujoco", "stable_baselines3")


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> Any:
    """Return (model, vector env, path)."""
    path = tmp_path_factory.mktemp("bundle") / "cable.policy"
    return *train(path), path


@pytest.fixture(scope="module")
def bundle(trained) -> Any:
    return load_bundle(trained[2])


def test_it_acts_as_the_model_did_with_the_statistics_that_it_had(trained, bundle):
    model, vector, _ = trained
    env = bundle.make_env()
    observation, _ = env.reset(seed=1)
    for _ in range(3):
        batch = vector.normalize_obs({key: value[None] for key, value in observation.items()})
        expected = model.predict(batch, deterministic=True)[0][0]
        np.testing.assert_array_equal(bundle.act(observation), expected)
        observation, *_ = env.step(expected)
    assert "Monitor" not in str(env)
    assert "Curriculum" in str(env)
    assert bundle.make_env(max_episode_steps=7).spec.max_episode_steps == 7


def test_it_stores_what_it_was_trained_in(trained, bundle):
    record = bundle.record
    assert record.summary == {"algorithm": "SAC", "steps": 12, "seed": 0, "note": "quick"}
    assert (record.dt, record.image, record.success_threshold) == (0.05, (84, 84), 0.01)
    assert record.versions["stable-baselines3"]
    assert record.schema == schema_hash(record.config)
    assert record.detector_version == ALGORITHM
    assert bundle.action_spec == cable().get_wrapper_attr("action_spec")
    assert bundle.needs_goal
    camera = cable().get_wrapper_attr("camera_model")
    np.testing.assert_allclose(record.camera["transform_camera_to_base"], camera.transform_camera_to_base)


def test_without_normalisation_and_goals_from_a_plain_env(tmp_path):
    env = rope(n=10)
    model = learner(env, "PPO", n_steps=4, batch_size=4)
    with pytest.raises(BundleError, match=r"another environment: observation space shape: \[30\] then, \[60\]"):
        save_bundle(model, rope(n=20), tmp_path / "a")
    save_bundle(model, env, tmp_path / "rope.policy")
    bundle = load_bundle(tmp_path / "rope.policy")
    observation, _ = bundle.make_env().reset(seed=0)
    np.testing.assert_array_equal(bundle.act(observation), model.predict(observation, deterministic=True)[0])
    assert not bundle.needs_goal
    with pytest.raises(BundleError, match=r"saved without action_spec, .*: save it with action_spec="):
        bundle.controller()
    save_bundle(model, env, tmp_path / "rope.policy", action_spec=NullRobot(1).action_spec)
    assert load_bundle(tmp_path / "rope.policy").controller().action_spec == NullRobot(1).action_spec


@pytest.mark.parametrize(("around", "dt"), [(Twice, 0.2), (lambda env: RepeatAction(env, 3), 0.3)])
@pytest.mark.filterwarnings("ignore:parts of the bundle are read only with trust")
def test_the_duration_of_a_step_counts_what_wrappers_repeat(tmp_path, around, dt):
    env = rope(10, around)
    model = learner(env, "PPO", n_steps=4, batch_size=4)
    env.reset(seed=0)
    env.step(env.action_space.sample())
    for each in (env, model.get_env()):
        save_bundle(model, each, tmp_path / "a.policy")
        assert load_bundle(tmp_path / "a.policy").dt == pytest.approx(dt)


def vector(env: Any, *around: Any) -> Any:
    """Return an environment as a vector environment of Stable-Baselines3, in wrappers of it."""
    from stable_baselines3.common import vec_env

    vector = vec_env.DummyVecEnv([lambda: env])
    for name, *arguments in around:
        vector = getattr(vec_env, name)(vector, *arguments)
    return vector


class Mine(wrappers.NormalizeObservation):
    """A normalisation of the user."""


class Welford(gym.ObservationWrapper, RecordConstructorArgs):
    """A running mean of the user, whose attributes are numbers."""

    def __init__(self, env: Any) -> None:
        RecordConstructorArgs.__init__(self)
        gym.ObservationWrapper.__init__(self, env)
        self.running_mean, self.count = np.zeros(env.observation_space.shape), 0

    def observation(self, observation: Any) -> Any:
        self.count += 1
        self.running_mean = self.running_mean + (observation - self.running_mean) / self.count
        return (observation - self.running_mean).astype(np.float32)


BOUNDS: Any = (-2.0, 2.0)


class Standard(gym.ObservationWrapper, RecordConstructorArgs):
    """A mean and a deviation that are arguments."""

    def __init__(self, env: Any, mean: float, std: float) -> None:
        RecordConstructorArgs.__init__(self, mean=mean, std=std)
        gym.ObservationWrapper.__init__(self, env)
        self.mean, self.std = mean, std

    def observation(self, observation: Any) -> Any:
        return ((observation - self.mean) / self.std).astype(np.float32)


@pytest.mark.parametrize(
    ("wrap", "refused", "warned"),
    [
        (wrappers.NormalizeObservation, "statistics that the wrapper NormalizeObservation", ""),
        (Mine, "statistics that the wrapper Mine", ""),
        (Welford, "statistics that the wrapper Welford", ""),
        (lambda env: vector(Welford(env)), "statistics that the wrapper Welford", ""),
        (lambda env: vector(env, ("VecFrameStack", 2)), "VecFrameStack", ""),
        (lambda env: vector(env, ("VecNormalize",), ("VecNormalize",)), "VecNormalize", ""),
        (lambda env: wrappers.TransformObservation(env, np.negative, None), "wrapper TransformObservation", ""),
        (lambda env: Standard(env, 0.2, 2.0), "", "in a simulator only.*Standard"),
        (wrappers.TimeAwareObservation, "", "in a simulator only.*TimeAwareObservation"),
        (lambda env: wrappers.RescaleObservation(env, *BOUNDS), "", "simulator only.*RescaleObservation"),
        (wrappers.NormalizeReward, "", ""),
    ],
)
def test_a_policy_reads_the_same_when_rebuilt_or_the_wrapper_is_named_at_saving(tmp_path, wrap, refused, warned):
    env = wrap(gym.wrappers.TimeLimit(rope(n=10), 50))
    model = learner(env, "PPO", n_steps=4, batch_size=4)
    model.learn(4)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        if refused:
            for given in (env, model.get_env()):
                with pytest.raises(BundleError, match=refused):
                    save_bundle(model, given, tmp_path / "a.policy")
            return
        save_bundle(model, env, tmp_path / "a.policy")
    assert bool(re.search(warned or "simulator only", " ".join(str(each.message) for each in caught))) == bool(warned)
    bundle = load_bundle(tmp_path / "a.policy", trust=True)
    observation, _ = bundle.make_env().reset(seed=1)
    np.testing.assert_array_equal(observation, env.reset(seed=1)[0])
    np.testing.assert_array_equal(bundle.act(observation), model.predict(observation, deterministic=True)[0])


@pytest.mark.parametrize("trust", [False, True])
def test_wrappers_that_have_moved_since_are_found_and_a_backend_is_no_error(tmp_path, trust):
    """The record has entry points and a configuration of earlier releases."""
    env = Shuffled(cable())
    save_bundle(learner(env), env, tmp_path / "a.policy")
    members = read_archive(tmp_path / "a.policy").members
    described, config = json.loads(members["env.json"]), yaml.safe_load(members["config.yaml"])
    described["wrappers"][-1]["entry_point"] = "shape_obs.training.shuffled:Shuffled"
    config["runtime"]["backend"] = "numpy"
    old = {"env.json": json.dumps(described).encode(), "config.yaml": yaml.safe_dump(config).encode()}
    write_archive(tmp_path / "old.policy", {**members, **old})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the backend
        bundle = load_bundle(tmp_path / "old.policy", trust=trust)
    again = bundle.make_env()
    assert again.action_space.contains(bundle.act(again.reset(seed=0)[0]))


KILLED = """
import os, signal, sys, zipfile
from shape_obs.deploy.policy_bundle.archive import read_archive, write_archive

whole, members = zipfile.ZipFile.writestr, read_archive(sys.argv[1]).members

def dying(archive, info, data, method):
    if info.filename == "policy.json":
        os.kill(os.getpid(), signal.SIGKILL)
    whole(archive, info, data, method)

zipfile.ZipFile.writestr = dying
write_archive(sys.argv[1], members)
"""


class TestFile:
    @pytest.fixture
    def members(self, trained) -> dict[str, bytes]:
        return read_archive(trained[2]).members

    @pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.99])
    def test_what_was_cut_or_changed_on_the_way(self, trained, tmp_path, share):
        whole = trained[2].read_bytes()
        at = int(share * len(whole))
        changed = whole[:at] + bytes(byte ^ 0xFF for byte in whole[at : at + 40]) + whole[at + 40 :]
        for data, message in ((whole[:at], "truncated or damaged"), (changed, "Copy it again")):
            (tmp_path / "a").write_bytes(data)
            with pytest.raises(BundleError, match=message):
                load_bundle(tmp_path / "a")

    def test_no_file_no_zip_and_another_zip(self, tmp_path):
        with pytest.raises(FileNotFoundError, match="no such bundle"):
            load_bundle(tmp_path / "none")
        np.savez(tmp_path / "other.npz", a=1)
        with pytest.raises(BundleError, match="a zip file of something else"):
            load_bundle(tmp_path / "other.npz")

    @pytest.mark.parametrize("name", ["weights.safetensors", "statistics.safetensors", "policy.json"])
    def test_a_member_that_was_changed_or_is_missing(self, trained, tmp_path, name):
        import zipfile

        with zipfile.ZipFile(trained[2]) as old:
            whole = {item: old.read(item) for item in old.namelist()}
        for change, message in (
            ({name: whole[name][:-1] + b"!"}, f"'{name}' was changed"),
            ({}, f"lacks.*{name}"),
        ):
            with zipfile.ZipFile(tmp_path / "a", "w") as new:
                for item, data in {**{key: value for key, value in whole.items() if key != name}, **change}.items():
                    new.writestr(item, data)
            with pytest.raises(BundleError, match=message):
                load_bundle(tmp_path / "a")

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"schema": "0" * 64}, "features mean something else here"),
            ({"versions": {"stable-baselines3": "1.8.0"}}, "other major versions: stable-baselines3 1.8.0 then"),
            ({"action_space": {"kind": "discrete", "n": 2, "start": 0}}, "another action space than was recorded"),
            ({"dt": "fast"}, "Record.dt: expected float"),
        ],
    )
    def test_a_record_that_does_not_fit(self, members, tmp_path, change, message):
        record = {**json.loads(members["policy.json"]), **change}
        write_archive(tmp_path / "a", {**members, "policy.json": json.dumps(record).encode()})
        with pytest.raises(BundleError, match=message):
            load_bundle(tmp_path / "a")

    def test_another_minor_version_is_reported(self, members, tmp_path):
        record = {**json.loads(members["policy.json"]), "versions": {"numpy": "1.0.1"}}
        write_archive(tmp_path / "a", {**members, "policy.json": json.dumps(record).encode()})
        with pytest.warns(UserWarning, match=r"saved with other versions: numpy 1.0.1 then"):
            load_bundle(tmp_path / "a")

    def test_another_algorithm_of_the_detector_is_reported(self, members, tmp_path):
        """Equal schemas do not give equal points then. Bundles that record no version have the first."""
        record = json.loads(members["policy.json"])
        for change, version in (({**record, "detector_version": 999}, 999), (record, 1)):
            if version == 1:
                del change["detector_version"]
            write_archive(tmp_path / "a", {**members, "policy.json": json.dumps(change).encode()})
            message = rf"points of version {version} of the detector's algorithm, this is version {ALGORITHM}"
            with pytest.warns(UserWarning, match=message):
                assert load_bundle(tmp_path / "a").record.detector_version == version

    def test_nothing_is_half_written(self, trained, tmp_path):
        class Secret(gym.Wrapper):
            """Records nothing."""

        model, _, good = trained
        path = tmp_path / "a.policy"
        path.write_bytes(good.read_bytes())
        bounds = np.full((2, 6), [[-2], [2]], np.float32)
        for env, summary, message in (
            (Secret(cable()), None, "Secret does not record its arguments"),
            (wrappers.RescaleAction(cable(), *bounds), None, "RescaleAction: its arguments .*: give plain numbers"),
            (cable(keep=["gripper"]), None, "the model was trained in another environment"),
            (cable(), {"note": object()}, "summary: expected JSON values"),
        ):
            with pytest.raises(BundleError, match=message):
                save_bundle(model, env, path, summary=summary)
        assert [file.name for file in tmp_path.iterdir()] == ["a.policy"]
        assert path.read_bytes() == good.read_bytes()
        with pytest.raises(OSError, match="cannot write"):
            save_bundle(model, cable(), tmp_path / "none" / "a.policy")

    def test_a_kill_while_it_is_written_loses_nothing(self, trained, tmp_path):
        path = tmp_path / "a.policy"
        path.write_bytes(trained[2].read_bytes())
        killed = subprocess.run([sys.executable, "-c", KILLED, str(path)], check=False)
        assert killed.returncode == -signal.SIGKILL
        assert len(list(tmp_path.iterdir())) == 2, "it came while a temporary file was half written"
        assert path.read_bytes() == trained[2].read_bytes()

    def test_equal_policies_give_equal_files(self, trained, tmp_path):
        members = read_archive(trained[2]).members
        write_archive(tmp_path / "a", members)
        write_archive(tmp_path / "b", members)
        assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
