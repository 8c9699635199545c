"""Recordings of environments and robots: actions, rewards, ends of episodes and states."""

from __future__ import annotations

import json

import gymnasium as gym
import numpy as np
import pytest
from rope_env import RopeEnv

from shape_obs import ShapeDetector
from shape_obs.recording import Recording, ShapeLog, Transition, record, replay
from shape_obs_envs.sources import EnvSource, FolderSource

BLUE = {"kind": "hsv", "low": [100, 120, 60], "high": [125, 255, 255]}


class PayingRope(RopeEnv):
    """A rope environment whose rewards count the steps, and that is terminated after the third step."""

    def step(self, action):
        observation, _, _, _, info = super().step(action)
        return observation, float(self.steps), self.steps == 3, False, info


def policy(observation):
    return np.array([observation["hand"][0]], np.float32)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Return a recording of nine frames, in three episodes, and what the environment did."""
    folder, done = tmp_path_factory.mktemp("steps") / "recording", []

    class Noted(gym.Wrapper):
        def reset(self, **given):
            found = self.env.reset(**given)
            done.append((found[0], None, None, False))
            return found

        def step(self, action):
            found = self.env.step(action)
            done.append((found[0], action, *found[1:3]))
            return found

    with EnvSource(Noted(PayingRope()), actions=policy, seed=3) as source:
        summary = record(source, folder, frames=9)
    assert (summary.frames, summary.actions) == (9, 6)
    return folder, done


def table_of(folder):
    detector = ShapeDetector(["centerline"], BLUE)
    with FolderSource(folder) as source:
        log = ShapeLog(detector, source=source)
        for moment, detection in replay(source, detector):
            log.add(moment, detection)
    return log.table()


def test_a_recording_has_what_the_environment_returned(recorded):
    folder, done = recorded
    recording = Recording(folder)
    assert recording.robot is not None
    assert recording.robot.action == ("action",)
    assert recording.robot.state == ("hand/0", "hand/1", "hand/2"), "vectors, not images, numbers or nested entries"
    for i, (observation, action, reward, terminated) in enumerate(done):
        moment = recording[i]
        assert moment.state == tuple(map(float, observation["hand"]))
        assert moment.transition == Transition(
            i % 4 if i < 8 else 0, None if action is None else tuple(action), reward, terminated
        )
    assert recording.episodes == [0, 0, 0, 0, 1, 1, 1, 1, 2]


def test_a_row_of_a_table_holds_the_action_chosen_for_its_frame(recorded):
    folder, done = recorded
    table = table_of(folder)
    for i, (observation, *_) in enumerate(done):
        assert np.array_equal(table["state"][i], observation["hand"])
        if i in (3, 7, 8):  # no step followed
            assert np.isnan(table["action"][i]).all()
            assert np.isnan(table["reward"][i])
            assert not table["terminated"][i]
        else:
            assert table["action"][i] == policy(observation)
            assert table["reward"][i] == i % 4 + 1
            assert table["terminated"][i] == (i % 4 == 2)
    assert not table["truncated"].any()
    assert table["step"].tolist() == [0, 1, 2, 3, 0, 1, 2, 3, 0]
    assert table.metadata["robot"]["state"] == ["hand/0", "hand/1", "hand/2"]


def test_a_recording_of_a_recording_keeps_all(recorded, tmp_path):
    with FolderSource(recorded[0]) as source:
        record(source, tmp_path / "again")
    first, again = Recording(recorded[0]), Recording(tmp_path / "again")
    assert again.robot == first.robot
    for i in range(9):
        assert (again[i].transition, again[i].state) == (first[i].transition, first[i].state)


def test_recordings_of_earlier_versions_have_no_steps(recorded, tmp_path):
    """They lack the entries in both files, and open as before."""
    with FolderSource(recorded[0]) as source:
        record(source, tmp_path / "old")
    camera = json.loads((tmp_path / "old" / "camera.json").read_text())
    del camera["robot"]
    (tmp_path / "old" / "camera.json").write_text(json.dumps(camera))
    lines = [json.loads(line) for line in (tmp_path / "old" / "frames.jsonl").read_text().splitlines()]
    for line in lines:
        for name in ("transition", "state"):
            line.pop(name, None)
    (tmp_path / "old" / "frames.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    old = Recording(tmp_path / "old")
    assert (old.robot, old[2].transition, old[2].state) == (None, None, None)
    table = table_of(tmp_path / "old")
    assert "action" not in table.columns
    assert np.array_equal(table["centerline/points2d"], table_of(recorded[0])["centerline/points2d"])
    with pytest.raises(KeyError, match="Only recordings of a robot or an environment have it"):
        table["action"]


@pytest.mark.parametrize(
    ("space", "action", "values", "names"),
    [
        (gym.spaces.Discrete(5, start=2), np.int64(4), (4.0,), ("action",)),
        (gym.spaces.Box(-1, 1, (2, 2)), [[1, 0], [0, 1]], (1.0, 0.0, 0.0, 1.0), tuple(f"action/{i}" for i in range(4))),
        (
            gym.spaces.Dict({"x": gym.spaces.Box(-1, 1, (2,)), "grip": gym.spaces.MultiBinary(1)}),
            {"x": np.array([0.5, -0.5], np.float32), "grip": np.array([1], np.int8)},
            (1.0, 0.5, -0.5),
            ("action/0", "action/1", "action/2"),
        ),
    ],
    ids=["discrete", "matrix", "dict"],
)
def test_actions_of_any_space_become_numbers(space, action, values, names):
    env = RopeEnv()
    env.action_space = space
    env.step = lambda given: RopeEnv.step(env, np.zeros(1))  # type: ignore[method-assign]
    with EnvSource(env, actions=lambda _: action) as source:
        assert (source.read().number, source.read().number) == (0, 1)
        assert source.robot_info.action == names
        assert source.transition is not None
        assert source.transition.action == values
