"""Bundles: what was trained is what acts, in another process too; what does not fit is refused, and by its name."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from cell_parts import RopeSource
from known_ropes import fit, ropes
from rope_env import wrapped

pytest.importorskip("mujoco")
pytest.importorskip("stable_baselines3")

import shape_obs_envs  # noqa: F401
from shape_obs import ShapeGoal, ShapeObservation, load_bundle, save_bundle, schema_hash
from shape_obs.bundle import BundleError
from shape_obs.bundle.archive import read_archive, write_archive
from shape_obs.training import Curriculum, PointReward, TrueState
from shape_obs_envs.robots import NullRobot

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


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> Any:
    """(model, vector env, path): hindsight replay, normalised, in a monitor and a curriculum, as trainings are."""
    import stable_baselines3 as sb3
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    env = VecNormalize(DummyVecEnv([lambda: Monitor(Curriculum(cable(), ["near"]))]), norm_reward=False, epsilon=1e-4)
    model = learner(env, replay_buffer_class=sb3.HerReplayBuffer, learning_starts=100)
    model.learn(12)
    path = tmp_path_factory.mktemp("bundle") / "cable.policy"
    save_bundle(model, env, path, summary={"note": "quick"})
    return model, env, path


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


def test_it_tells_what_it_was_trained_in(trained, bundle):
    record = bundle.record
    assert record.summary == {"algorithm": "SAC", "steps": 12, "seed": 0, "note": "quick"}
    assert (record.dt, record.image, record.success_threshold) == (0.05, (84, 84), 0.01)
    assert record.versions["stable-baselines3"]
    assert record.schema == schema_hash(record.config)
    assert bundle.action_spec == cable().get_wrapper_attr("action_spec")
    assert bundle.needs_goal
    camera = cable().get_wrapper_attr("camera_model")
    np.testing.assert_allclose(record.camera["transform_camera_to_base"], camera.transform_camera_to_base)
    assert set(read_archive(trained[2])) == {
        "model.zip",
        "statistics.npz",
        "env.json",
        "config.yaml",
        "policy.json",
    }


PLAY = """
import sys, numpy as np, torch
torch.set_num_threads(1)
from shape_obs import load_bundle
bundle = load_bundle(sys.argv[1])
env = bundle.make_env()
observation, _ = env.reset(seed=4)
for _ in range(3):
    action = bundle.act(observation)
    print(action.tobytes().hex())
    observation, *_ = env.step(action)
"""


def test_a_fresh_process_acts_alike_bit_for_bit(trained, bundle, tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", PLAY, trained[2]], cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    env = bundle.make_env()
    observation, _ = env.reset(seed=4)
    here = []
    for _ in range(3):
        action = bundle.act(observation)
        here.append(action.tobytes().hex())
        observation, *_ = env.step(action)
    assert done.stdout.split() == here


def test_without_normalisation_and_goals_from_a_plain_env(tmp_path):
    env = _rope(n=10)
    model = learner(env, "PPO", n_steps=4, batch_size=4)
    with pytest.raises(BundleError, match=r"another environment: observation space shape: \[30\] then, \[60\]"):
        save_bundle(model, _rope(n=20), tmp_path / "a")
    save_bundle(model, env, tmp_path / "rope.policy")
    bundle = load_bundle(tmp_path / "rope.policy")
    observation, _ = bundle.make_env().reset(seed=0)
    np.testing.assert_array_equal(bundle.act(observation), model.predict(observation, deterministic=True)[0])
    assert not bundle.needs_goal
    with pytest.raises(BundleError, match="nobody told what its actions mean: save it with action_spec="):
        bundle.controller()
    save_bundle(model, env, tmp_path / "rope.policy", action_spec=NullRobot(1).action_spec)
    assert load_bundle(tmp_path / "rope.policy").controller().action_spec == NullRobot(1).action_spec


def test_fitted_features_travel_along(tmp_path):
    fitted = tmp_path / "ropes.npz"
    fit(ropes(50)).save(fitted)
    feature = {"kind": "pca", "file": str(fitted)}
    env = wrapped(gym.make(_registered(), disable_env_checker=True), features=[feature])
    model = learner(env, "PPO", n_steps=4, batch_size=4)
    save_bundle(model, env, tmp_path / "rope.policy")
    before, _ = env.reset(seed=0)
    fitted.unlink()
    bundle = load_bundle(tmp_path / "rope.policy")
    after, _ = bundle.make_env().reset(seed=0)
    np.testing.assert_array_equal(after, before)
    assert bundle.record.config is not None
    folder = Path(bundle.record.config["features"][0]["file"]).parent
    assert folder.is_dir()
    del bundle
    assert not folder.exists()


WORKSPACE = ((-1.0, -1.0, -1.0), (1.0, 1.0, 2.0))


def _rope(n: int) -> Any:
    shapes = [{"kind": "centerline", "n": n}]
    env = gym.make(_registered(), disable_env_checker=True)
    return wrapped(env, shapes=shapes, features=[POINTS], workspace=WORKSPACE)


def _registered() -> str:
    if "BundleRope-v0" not in gym.registry:
        gym.register("BundleRope-v0", "rope_env:RopeEnv")
    return "BundleRope-v0"


class TestMismatch:
    """Each difference is told by its name, with both values."""

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"shapes": [{"kind": "centerline", "n": 10, "anchor": "gripper0"}]}, r"shapes\[0\].n: 20 in training, 10"),
            (
                {"shapes": [{"kind": "centerline", "anchor": "gripper0"}]},
                r"shapes\[0\].ends: 'tips' in training, 'cent",
            ),
            ({"features": [POINTS, "ok"]}, r"features\[1\]: None in training, {'kind': 'ok'} here"),
            (
                {"features": [{**POINTS, "origin": "centroid"}]},
                r"features\[0\].origin: None in training, 'centroid'",
            ),
            ({"features": [{"kind": "points3d"}]}, r"features\[0\].frame: 'base' in training, 'camera' here"),
            ({"keep": ["gripper"]}, r"observation 'observation' shape: \[60\] in training, \[70\] here"),
            ({"clustering": "kmeans", "shapes": ["centerline"]}, "clustering kind: 'som' in training, 'kmeans' here"),
        ],
    )
    def test_of_what_is_seen(self, bundle, options, message):
        with pytest.raises(BundleError, match=f"does not fit this environment: .*{message}"):
            bundle.check_env(cable(**options))

    @pytest.mark.parametrize(
        ("changes", "rate", "message"),
        [
            ({"scale": [0.02] * 6}, 20, r"action scale: \[0.015, .* in training, \[0.02, "),
            ({"units": ["m"] * 6}, 20, "action units: .*'rad'.* in training, .* here"),
            ({"mode": "velocity"}, 20, "action mode: 'displacement' in training, 'velocity' here"),
            ({"frame": "gripper"}, 20, "action frame: 'base' in training, 'gripper' here"),
            ({}, 30, r"dt \[s\]: 0.05 in training, 0.033333 here"),
        ],
    )
    def test_of_what_is_done(self, bundle, changes, rate, message):
        env = bundle.wrap(self.cell(bundle, changes, rate), scene=BLUE)
        with pytest.raises(BundleError, match=message):
            bundle.check_env(env)

    def test_what_may_differ(self, bundle):
        assert bundle.differences(cable(workspace=WORKSPACE, segmentation=BLUE["segmentation"])) == []
        slow = bundle.wrap(self.cell(bundle, {"low": [-0.3] * 6}, 30), scene=BLUE)
        assert bundle.differences(slow, same_rate=False) == []
        assert isinstance(slow, ShapeGoal)

    def test_a_camera_that_stands_nobody_knows_where(self, bundle):
        env = self.cell(bundle, {}, 20)
        env.unwrapped.source.extrinsics = None  # as of a camera without --extrinsics
        with pytest.raises(BundleError, match=r"'points3d' in the base frame, .* give --extrinsics"):
            bundle.wrap(env, scene=BLUE)

    def cell(self, bundle, changes, rate) -> Any:
        spec = {**bundle.action_spec.to_dict(), **changes}
        return gym.make(
            "shape_obs_envs:ShapeObs/D455-v0",
            source=RopeSource(),
            robot=NullRobot(spec=spec),
            rate=rate,
            size=[160, 120],
            disable_env_checker=True,
        )


def rescaled() -> Any:
    bounds: Any = -2.0, 2.0
    return gym.wrappers.RescaleAction(cable(), *bounds)


BLUE = {"segmentation": {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]}}


class TestDeployable:
    @pytest.mark.parametrize(
        ("make", "reason"),
        [
            (lambda: TrueState(gym.make("ShapeObs/Cable-v0", render_observation=False)), "simulator's state"),
            (lambda: cable(keep=["gripper"]), "it reads gripper beside the shape, which only its simulator gives"),
            (rescaled, "the wrapper RescaleAction does on a robot"),
        ],
    )
    def test_what_only_a_simulator_has_is_kept_and_rebuilt_but_not_deployed(self, tmp_path, make, reason):
        env = make()
        save_bundle(learner(env), env, tmp_path / "a.policy")
        bundle = load_bundle(tmp_path / "a.policy")
        again = bundle.make_env()
        assert again.action_space.contains(bundle.act(again.reset(seed=0)[0]))
        with pytest.raises(BundleError, match=f"the policy cannot be deployed: .*{reason}"):
            bundle.controller()

    def test_wrappers_that_belong_to_the_policy_come_along(self, tmp_path):
        features = ["centroid", POINTS]
        env = PointReward(ShapeGoal(cable(features=features), features=features, threshold=1.0), threshold=0.02)
        save_bundle(learner(env), env, tmp_path / "a.policy")
        bundle = load_bundle(tmp_path / "a.policy")
        cell = bundle.wrap(TestMismatch().cell(bundle, {}, 20), scene=BLUE)
        assert isinstance(cell, PointReward)
        assert cell.threshold == 0.02
        bundle.check_env(cell)


class TestFile:
    @pytest.fixture
    def members(self, trained) -> dict[str, bytes]:
        return read_archive(trained[2])

    @pytest.mark.parametrize("share", [0.02, 0.5, 0.99])
    def test_truncated(self, trained, tmp_path, share):
        data = trained[2].read_bytes()
        (tmp_path / "a").write_bytes(data[: int(share * len(data))])
        with pytest.raises(BundleError, match="truncated or damaged"):
            load_bundle(tmp_path / "a")

    def test_no_file_no_zip_and_another_zip(self, tmp_path):
        with pytest.raises(FileNotFoundError, match="no such bundle"):
            load_bundle(tmp_path / "none")
        np.savez(tmp_path / "other.npz", a=1)
        with pytest.raises(BundleError, match="a zip file of something else"):
            load_bundle(tmp_path / "other.npz")

    @pytest.mark.parametrize("name", ["model.zip", "statistics.npz", "policy.json"])
    def test_a_member_that_was_changed_or_is_missing(self, trained, tmp_path, name):
        import zipfile

        with zipfile.ZipFile(trained[2]) as old:
            whole = {item: old.read(item) for item in old.namelist()}
        for change, message in (({name: whole[name][:-1] + b"!"}, f"'{name}' was changed"), ({}, f"misses.*{name}")):
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
            ({"algorithm": "stable_baselines3:QRDQN"}, "has no 'QRDQN'; did you mean 'DQN'"),
            ({"algorithm": "gymnasium:make"}, "expected a class of Stable-Baselines3"),
            ({"action_space": {"kind": "discrete", "n": 2}}, "another action space than was recorded"),
            ({"dt": "fast"}, "Record.dt: expected float"),
        ],
    )
    def test_a_record_that_does_not_fit(self, members, tmp_path, change, message):
        record = {**json.loads(members["policy.json"]), **change}
        write_archive(tmp_path / "a", {**members, "policy.json": json.dumps(record).encode()})
        with pytest.raises(BundleError, match=message):
            load_bundle(tmp_path / "a")

    def test_another_minor_version_is_told(self, members, tmp_path):
        record = {**json.loads(members["policy.json"]), "versions": {"numpy": "1.0.1"}}
        write_archive(tmp_path / "a", {**members, "policy.json": json.dumps(record).encode()})
        with pytest.warns(UserWarning, match=r"saved with other versions: numpy 1.0.1 then"):
            load_bundle(tmp_path / "a")

    def test_nothing_is_half_written(self, trained, tmp_path):
        class Secret(gym.Wrapper):
            """Records nothing."""

        model, _, good = trained
        path = tmp_path / "a.policy"
        path.write_bytes(good.read_bytes())
        for env, summary, message in (
            (Secret(cable()), None, "Secret does not record its arguments"),
            (cable(keep=["gripper"]), None, "the model was trained in another environment"),
            (cable(), {"note": object()}, "summary: expected JSON values"),
        ):
            with pytest.raises(BundleError, match=message):
                save_bundle(model, env, path, summary=summary)
        assert [file.name for file in tmp_path.iterdir()] == ["a.policy"]
        assert path.read_bytes() == good.read_bytes()
        with pytest.raises(OSError, match="cannot write"):
            save_bundle(model, cable(), tmp_path / "none" / "a.policy")

    def test_equal_policies_give_equal_files(self, trained, tmp_path):
        members = read_archive(trained[2])
        write_archive(tmp_path / "a", members)
        write_archive(tmp_path / "b", members)
        assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
