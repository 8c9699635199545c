"""Recordings of deployments: the frames that the controller saw, its actions, and the robot's state."""

from __future__ import annotations

import json
import time

import numpy as np
import pytest
from cell_parts import ListRobot
from deploy_parts import PATIENT, Always, cell

from shape_obs import ShapeDetector
from shape_obs.cli import main
from shape_obs.deploy import RunLog, RunRecorder, Step, Sway, deploy
from shape_obs.recording import Recording, ShapeLog, replay
from shape_obs_envs.sources import FolderSource


class ArmWithSensors(ListRobot):
    """A robot that also publishes what it measures."""

    name = "arm"

    @property
    def measured(self):
        return {"joint0": 2.0 * self.command[0], "force": 5.0}


def test_a_recording_of_a_run_has_what_the_policy_saw_and_did(tmp_path):
    env, robot, _ = cell(ArmWithSensors())
    log = RunLog(tmp_path / "log", {})
    with RunRecorder(tmp_path / "run") as recorder:
        report = deploy(env, Sway(share=0.5, period=20), PATIENT, steps=6, log=log, record=recorder)
    rows = [json.loads(line) for line in (tmp_path / "log" / "steps.jsonl").read_text().splitlines()]
    recording = Recording(tmp_path / "run")
    assert (report.acted, len(recording), recorder.close().dropped) == (6, 7, 0)
    assert recording.ended["frames"] == 7
    assert recording.robot is not None
    assert (recording.robot.name, recording.robot.action) == ("arm", ("x0", "x1"))
    assert recording.robot.state == ("x0", "x1", "joint0", "force")
    assert recording.robot.action_spec == robot.action_spec
    for i, row in enumerate(rows):
        moment, after = recording[i], recording[i + 1]
        assert moment.frame.number == row["frame"]
        assert moment.state is not None
        assert moment.state[:2] == tuple(row["state"])
        assert moment.state[2:] == (2 * row["state"][0], 5.0)
        assert after.transition is not None
        assert (after.transition.step, after.transition.action) == (i + 1, tuple(row["action"]))
        assert (after.transition.reward, after.transition.terminated) == (0.0, False)


def test_a_replay_of_a_run_gives_its_shapes_and_actions(tmp_path):
    env, *_ = cell()
    steps: list[Step] = []
    with RunRecorder(tmp_path / "run") as recorder:
        deploy(env, Sway(share=0.5, period=20), PATIENT, steps=6, record=recorder, on_step=steps.append)
    detector = ShapeDetector(**env.get_wrapper_attr("detector").config.to_dict())
    with FolderSource(tmp_path / "run") as source:
        collected = ShapeLog(detector, source=source)
        for moment, detection in replay(source, detector):
            collected.add(moment, detection)
    table = collected.table()
    for i, step in enumerate(steps):
        assert np.array_equal(table["centerline/points3d"][i], np.asarray(step.detection.shapes[0].points3d))
        assert np.array_equal(table["action"][i], step.action)
    assert np.isnan(table["action"][-1]).all()
    assert table["step"].tolist() == list(range(7))
    assert table["state"].shape == (7, 2)


def test_a_frame_on_which_nothing_was_sent_has_no_action(tmp_path):
    env, _, source = cell()

    def darken():
        source.dark = True
        return np.array([1.0, 0.0])

    with RunRecorder(tmp_path / "run") as recorder:
        report = deploy(env, Always({2: darken}), PATIENT, steps=6, record=recorder)
    assert report.held > 0
    recording = Recording(tmp_path / "run")
    actions = [moment.transition and moment.transition.action for moment in (recording[i] for i in range(7))]
    assert actions[0] is None, "no step led to the first frame"
    assert actions[1:4] == [(1.0, 0.0)] * 3
    assert recorder.close().actions == report.acted == 6 - actions[1:].count(None)


def test_runs_are_episodes_of_one_recording(tmp_path):
    env, *_ = cell()
    with RunRecorder(tmp_path / "run") as recorder:
        for _ in range(2):
            deploy(env, Always(), PATIENT, steps=3, record=recorder, park=False, close=False)
    env.close()
    assert Recording(tmp_path / "run").episodes == 4 * [0] + 4 * [1]


def test_a_disk_that_stalls_drops_frames_and_delays_no_step(tmp_path, monkeypatch):
    from shape_obs.recording import writer

    whole = writer.store

    def stalling(*given):
        time.sleep(0.05)
        return whole(*given)

    monkeypatch.setattr(writer, "store", stalling)
    env, *_ = cell()
    moments: list[float] = []
    with RunRecorder(tmp_path / "run", workers=1, pending=1) as recorder:
        report = deploy(
            env, Always(), PATIENT, steps=30, record=recorder, on_step=lambda _: moments.append(time.monotonic())
        )
    assert np.diff(moments).max() < 0.25, "a frame takes 0.1 s to store"
    recorded, recording = recorder.close(), Recording(tmp_path / "run")
    assert report.acted == 30
    assert recorded.dropped > 0
    assert recorded.frames + recorded.dropped == 31
    assert recording.ended["dropped"] == recorded.dropped
    steps = [recording[i].transition for i in range(len(recording))]
    assert [step.step for step in steps if step] != list(range(len(steps))), "gaps are visible"
    assert recorded.frames > 2


def test_a_disk_that_is_full_ends_the_run_and_stops_the_robot(tmp_path, monkeypatch):
    from shape_obs.recording import writer

    def full(*_):
        raise OSError("no space left on device")

    monkeypatch.setattr(writer, "store", full)
    env, robot, _ = cell()
    with pytest.raises(OSError, match="no space left"), RunRecorder(tmp_path / "run") as recorder:
        deploy(env, Always(), PATIENT, steps=1000, record=recorder)
    assert robot.calls[-1] == "disconnect"


def test_a_folder_that_is_not_empty_is_refused_before_the_robot_moves(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(FileExistsError, match="needs an empty folder"):
        RunRecorder(tmp_path)


def test_the_command_records(tmp_path, capsys):
    pytest.importorskip("mujoco")
    config = tmp_path / "c.yaml"
    config.write_text("version: 1\nscene: {segmentation: {kind: hsv, low: [100, 120, 40], high: [125, 255, 255]}}\n")
    source = ["--source", "ShapeObs/Cable-v0", "--set", "camera=[160,120]", "renderer=rays", "--size", "160", "120"]
    robot = [
        "--robot",
        "shape_obs_envs.robots:NullRobot",
        "--robot-set",
        "size=2",
        "--controller",
        "shape_obs.deploy:Sway",
    ]
    with pytest.raises(SystemExit) as stop:
        main(
            ["deploy", *source, *robot, "--config", str(config), "--episodes", "2", "--steps", "3", "--json"]
            + ["--max-age", "5", "--hold", "9", "--record", str(tmp_path / "run")]
        )
    assert stop.value.code == 0
    report = json.loads(capsys.readouterr().out)
    assert report["recording"]["frames"] == len(Recording(tmp_path / "run")) == 8
    assert report["recording"]["actions"] == 6
