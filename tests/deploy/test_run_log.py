"""The log of a deployment, its report in constant memory, and its recording."""

from __future__ import annotations

import json
import pickle
import threading
import time
from typing import Any

import numpy as np
import pytest
from fake_cell import PATIENT, Always, FakeRobot, cell
from hypothesis import given
from hypothesis import strategies as st

from shape_obs import ShapeDetector
from shape_obs.cli import main
from shape_obs.config.detector_config import ALGORITHM
from shape_obs.deploy import RunLog, RunRecorder, Step, Sway, deploy
from shape_obs.deploy.run_log import Tally
from shape_obs.recording import Recording, ShapeLog, replay, writer
from shape_obs_envs.sources import FolderSource


def test_the_log_has_every_step_and_names_what_ran(tmp_path):
    run = tmp_path / "run"
    report = deploy(cell()[0], Sway(period=20), PATIENT, steps=6, log=RunLog(run, {"controller": "Sway"}))
    rows = [json.loads(line) for line in (run / "steps.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows] == list(range(6))
    for row in rows:
        (shape,) = row["shapes"]
        assert (len(shape["points3d"]), len(shape["sigma"]), shape["track_id"]) == (10, 10, 1)
        assert (row["move"], len(row["action"]), row["warning"]) == ("act", 2, "")
    header = json.loads((run / "run.json").read_text())
    assert (header["algorithm"], header["controller"]) == (ALGORITHM, "Sway")
    assert json.loads((run / "report.json").read_text())["steps"] == report.steps
    (tmp_path / "run.json").write_text("{}")  # another program's
    for folder in (run, tmp_path):
        with pytest.raises(FileExistsError, match="holds a run already"):
            RunLog(folder, {})


@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError("a mistake")])
def test_a_run_that_dies_leaves_its_steps_and_the_reason_on_disk(error, tmp_path):
    def die():
        raise error

    with pytest.raises((KeyboardInterrupt, ZeroDivisionError)):
        deploy(cell()[0], Always({4: die}), PATIENT, steps=10, log=RunLog(tmp_path / "run", {}))
    assert len((tmp_path / "run" / "steps.jsonl").read_text().splitlines()) == 4
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    ended = "KeyboardInterrupt: " if error is KeyboardInterrupt else "ZeroDivisionError: a mistake"
    assert report["ended"].startswith(ended)
    assert (report["failed"], report["steps"]) == (True, 4)


class BlockedLog(RunLog):
    """A log on a disk that answers when the gate is opened."""

    def __init__(self, *args: Any) -> None:
        self.gate = threading.Event()
        super().__init__(*args)

    def _write_step(self, record):
        assert self.gate.wait(30)
        super()._write_step(record)


def test_a_disk_that_stalls_delays_neither_the_steps_nor_the_stop(tmp_path):
    """All steps are done and the robot is stopped, parked and disconnected before the disk answers."""
    env, robot, _ = cell()
    log, before = BlockedLog(tmp_path / "run", {}), []
    close = env.unwrapped.close

    def answer():
        close()
        before.append((robot.calls[-1], list(tmp_path.glob("run/report.json"))))
        log.gate.set()

    env.unwrapped.close = answer
    report = deploy(env, Always(), steps=5, log=log)
    assert before == [("disconnect", [])]
    assert json.loads((tmp_path / "run" / "report.json").read_text())["steps"] == report.steps == 5
    assert len((tmp_path / "run" / "steps.jsonl").read_text().splitlines()) == 5


def test_a_disk_that_is_full_or_hopelessly_behind_ends_the_run_and_stops_the_robot(tmp_path, monkeypatch):
    class FullDisk(RunLog):
        def _write_step(self, record):
            raise OSError("no space left on device")

    env, robot, _ = cell()
    with pytest.raises(OSError, match="no space left"):
        deploy(env, Always(), steps=1000, log=FullDisk(tmp_path / "full", {}))
    assert robot.calls[-1] == "disconnect"
    assert "no space left" in json.loads((tmp_path / "full" / "report.json").read_text())["ended"]

    monkeypatch.setattr("shape_obs.deploy.run_log._WAITING", 3)
    env, *_ = cell()
    log = BlockedLog(tmp_path / "slow", {})
    close = env.unwrapped.close
    env.unwrapped.close = lambda: (close(), log.gate.set())
    with pytest.raises(OSError, match="the disk is 3 steps behind"):
        deploy(env, Always(), steps=100, log=log)


def test_what_is_counted_takes_no_more_memory_after_more_steps():
    def tally(steps):
        counted = Tally()
        for step in range(steps):
            counted.reasons["image old"] += 1
            counted.time({"own": 5.0 + step % 7, "age": 0.1 * step})
        return counted

    assert len(pickle.dumps(tally(20_000))) <= len(pickle.dumps(tally(20))) + 100


@given(st.lists(st.floats(-1, 1e5), min_size=1, max_size=200))
def test_sections_are_quantiles(values):
    counted = Tally()
    for value in values:
        counted.time({"own": value})
    section = counted.report(steps=1, seconds=1, overruns=0, expired=0, ended="", failed=False, success=None).sections[
        "own"
    ]
    # One of the values next to the exact quantile, to within half a bin.
    for found, share in ((section.median, 0.5), (section.p95, 0.95)):
        exact = [max(0.0, np.quantile(values, share, method=method)) for method in ("lower", "higher")]
        assert 0.994 * exact[0] - 2e-3 <= found <= 1.006 * exact[1] + 2e-3
    assert section.most == pytest.approx(max(0.0, *values), abs=1e-3)


# ---- recordings: the frames that the controller saw, its actions, and the robot's state


class ArmWithSensors(FakeRobot):
    """A robot that also publishes what it measures."""

    name = "arm"

    @property
    def measured(self):
        return {"joint0": 2.0 * self.command[0], "force": 5.0}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Return (folder with a log and a recording of six steps, environment, robot, report, steps)."""
    folder, steps = tmp_path_factory.mktemp("run"), list[Step]()
    env, robot, _ = cell(ArmWithSensors())
    with RunRecorder(folder / "run") as recorder:
        log = RunLog(folder / "log", {})
        sway = Sway(share=0.5, period=20)
        report = deploy(env, sway, PATIENT, steps=6, log=log, record=recorder, on_step=steps.append)
    assert recorder.close().dropped == 0
    return folder, env, robot, report, steps


def test_a_recording_of_a_run_has_what_the_policy_saw_and_did(run):
    folder, _, robot, report, _ = run
    rows = [json.loads(line) for line in (folder / "log" / "steps.jsonl").read_text().splitlines()]
    recording = Recording(folder / "run")
    assert (report.acted, len(recording), recording.ended["frames"]) == (6, 7, 7)
    assert recording.robot is not None
    assert (recording.robot.name, recording.robot.action) == ("arm", ("x0", "x1"))
    assert recording.robot.state == ("x0", "x1", "joint0", "force")
    assert recording.robot.action_spec == robot.action_spec
    for i, row in enumerate(rows):
        moment, after = recording[i], recording[i + 1]
        assert moment.frame.number == row["frame"]
        assert moment.state == (*row["state"], 2 * row["state"][0], 5.0)
        assert after.transition is not None
        assert (after.transition.step, after.transition.action) == (i + 1, tuple(row["action"]))
        assert (after.transition.reward, after.transition.terminated) == (0.0, False)


def test_a_replay_of_a_run_gives_its_shapes_and_actions(run):
    folder, env, _, _, steps = run
    detector = ShapeDetector(**env.get_wrapper_attr("detector").config.to_dict())
    with FolderSource(folder / "run") as source:
        collected = ShapeLog(detector, source=source)
        for moment, detection in replay(source, detector):
            collected.add(moment, detection)
    table = collected.table()
    for i, step in enumerate(steps):
        assert np.array_equal(table["centerline/points3d"][i], np.asarray(step.detection.shapes[0].points3d))
        assert np.array_equal(table["action"][i], step.action)
    assert np.isnan(table["action"][-1]).all()
    assert table["step"].tolist() == list(range(7))
    assert table["state"].shape == (7, 4)


def test_a_frame_on_which_nothing_was_sent_has_no_action_and_runs_are_episodes(tmp_path):
    env, _, camera = cell()
    with RunRecorder(tmp_path / "run") as recorder:
        dark = Always({2: lambda: setattr(camera, "dark", True)})
        report = deploy(env, dark, PATIENT, steps=6, record=recorder, park=False, close=False)
        camera.dark = False
        deploy(env, Always(), PATIENT, steps=3, record=recorder)
    assert report.held == 3
    recording = Recording(tmp_path / "run")
    assert recording.episodes == 7 * [0] + 4 * [1]
    actions = [moment.transition and moment.transition.action for moment in (recording[i] for i in range(7))]
    assert actions == [None, *3 * [(1.0, 0.0)], *3 * [None]], "no step led to the first frame"
    assert recorder.close().actions == 3 + 3


def test_a_disk_that_stalls_drops_frames_and_delays_no_step(tmp_path, monkeypatch):
    whole, gate, written = writer.store, threading.Event(), threading.Event()

    def stalling(*given):
        assert gate.wait(30)
        try:
            return whole(*given)
        finally:
            written.set()

    def recover():
        gate.set()
        assert written.wait(30)
        time.sleep(0.1)  # until the thread takes another frame

    monkeypatch.setattr(writer, "store", stalling)
    env, *_ = cell()
    with RunRecorder(tmp_path / "run", workers=1, pending=1) as recorder:
        at = Always({20: recover})  # a loop that waited for the disk would not get there
        report = deploy(env, at, PATIENT, steps=30, record=recorder)
    recorded, recording = recorder.close(), Recording(tmp_path / "run")
    assert report.acted == 30
    assert recorded.dropped > 10
    assert recorded.frames + recorded.dropped == 31
    assert recording.ended["dropped"] == recorded.dropped
    steps = [recording[i].transition for i in range(len(recording))]
    assert [step.step for step in steps if step] != list(range(len(steps))), "gaps are visible"


def test_a_disk_that_is_full_ends_the_run_and_stops_the_robot(tmp_path, monkeypatch):
    def full(*_):
        raise OSError("no space left on device")

    monkeypatch.setattr(writer, "store", full)
    env, robot, _ = cell()
    with pytest.raises(OSError, match="no space left"), RunRecorder(tmp_path / "run") as recorder:
        deploy(env, Always(), PATIENT, steps=1000, record=recorder)
    assert robot.calls[-1] == "disconnect"
    with pytest.raises(FileExistsError, match="needs an empty folder"):
        RunRecorder(tmp_path / "run")


def test_the_command_records(tmp_path, capsys):
    pytest.importorskip("mujoco")
    config = tmp_path / "c.yaml"
    config.write_text("version: 1\nscene: {segmentation: {kind: hsv, low: [100, 120, 40], high: [125, 255, 255]}}\n")
    source = ["--source", "ShapeObs/Cable-v0", "--set", "camera=[160,120]", "renderer=rays", "--size", "160", "120"]
    robot = ["--robot", "shape_obs_envs.robots:NullRobot", "--robot-set", "size=2"]
    with pytest.raises(SystemExit) as stop:
        main(
            ["deploy", *source, *robot, "--controller", "shape_obs.deploy:Sway", "--config", str(config), "--json"]
            + ["--episodes", "2", "--steps", "3", "--max-age", "5", "--hold", "9", "--record", str(tmp_path / "run")]
        )
    assert stop.value.code == 0
    report = json.loads(capsys.readouterr().out)
    assert report["recording"]["frames"] == len(Recording(tmp_path / "run")) == 8
    assert report["recording"]["actions"] == 6
