"""The log of a deployment, written by a thread, and its report, in constant memory."""

from __future__ import annotations

import json
import pickle
import threading
from typing import Any

import numpy as np
import pytest
from fake_cell import PATIENT, Always, cell
from hypothesis import given
from hypothesis import strategies as st

from shape_obs.config.detector_config import ALGORITHM
from shape_obs.deploy import RunLog, Sway, deploy
from shape_obs.deploy.run_log import Tally


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
    with pytest.raises(FileExistsError, match="holds a run already"):
        RunLog(run, {})


@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError("a mistake")])
def test_a_run_that_dies_leaves_its_steps_and_the_reason_on_disk(error, tmp_path):
    def die():
        raise error

    with pytest.raises((KeyboardInterrupt, ZeroDivisionError)):
        deploy(cell()[0], Always({4: die}), PATIENT, steps=10, log=RunLog(tmp_path / "run", {}))
    assert len((tmp_path / "run" / "steps.jsonl").read_text().splitlines()) == 4
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    ended = "KeyboardInterrupt: " if error is KeyboardInterrupt else "ZeroDivisionError: a mistake"
    assert (report["ended"], report["failed"], report["steps"]) == (ended, True, 4)


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
