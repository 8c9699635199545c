"""The log of a deployment, written by a thread, and its report, in constant memory."""

from __future__ import annotations

import json
import pickle
import time
from typing import Any

import numpy as np
import pytest
from deploy_parts import PATIENT, Always, cell
from hypothesis import given
from hypothesis import strategies as st

from shape_obs.config.detector_config import ALGORITHM
from shape_obs.deploy import RunLog, Sway, deploy
from shape_obs.deploy.run_log import Tally


def test_the_log_has_every_step_and_names_what_ran(tmp_path):
    env, *_ = cell()
    report = deploy(env, Sway(period=20), PATIENT, steps=6, log=RunLog(tmp_path / "run", {"controller": "Sway"}))
    rows = [json.loads(line) for line in (tmp_path / "run" / "steps.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows] == list(range(6))
    assert all(len(row["shapes"][0]["points3d"]) == 10 for row in rows)
    assert all(len(row["shapes"][0]["sigma"]) == 10 and row["shapes"][0]["track_id"] == 1 for row in rows)
    assert {row["warning"] for row in rows} == {""}
    assert json.loads((tmp_path / "run" / "run.json").read_text())["algorithm"] == ALGORITHM
    assert all(row["move"] == "act" and len(row["action"]) == 2 for row in rows)
    assert json.loads((tmp_path / "run" / "run.json").read_text())["controller"] == "Sway"
    assert json.loads((tmp_path / "run" / "report.json").read_text())["steps"] == report.steps
    with pytest.raises(FileExistsError, match="holds a run already"):
        RunLog(tmp_path / "run", {})


def test_steps_of_a_run_that_dies_are_on_disk(tmp_path):
    env, *_ = cell()

    def die():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        deploy(env, Always({4: die}), PATIENT, steps=10, log=RunLog(tmp_path / "run", {}))
    assert len((tmp_path / "run" / "steps.jsonl").read_text().splitlines()) == 4


class StallingLog(RunLog):
    """A log on a disk that stalls."""

    def __init__(self, *args: Any, seconds: float) -> None:
        self.seconds, self.done = seconds, []
        super().__init__(*args)

    def _write(self, name, content):
        time.sleep(self.seconds)
        super()._write(name, content)
        self.done.append((name, time.monotonic()))

    def _write_step(self, record):
        time.sleep(self.seconds)
        super()._write_step(record)


def test_a_disk_that_stalls_delays_neither_the_steps_nor_the_stop(tmp_path):
    env, robot, _ = cell()
    stops: list[float] = []
    stop = robot.stop
    robot.stop = lambda: (stop(), stops.append(time.monotonic()))  # type: ignore[method-assign]
    log = StallingLog(tmp_path / "run", {}, seconds=0.5)
    moments = []
    report = deploy(env, Always(), steps=5, log=log, on_step=lambda moment: moments.append(time.monotonic()))
    assert np.diff(moments).max() < 0.4
    written = dict(log.done)["report.json"]
    assert stops[0] - moments[-1] < 0.4
    assert written - stops[0] > 1.0  # five steps and the report
    assert json.loads((tmp_path / "run" / "report.json").read_text())["steps"] == report.steps == 5
    assert len((tmp_path / "run" / "steps.jsonl").read_text().splitlines()) == 5


def test_a_log_that_cannot_be_written_ends_the_run_and_stops_the_robot(tmp_path):
    class FullDisk(RunLog):
        def _write_step(self, record):
            raise OSError("no space left on device")

    env, robot, _ = cell()
    with pytest.raises(OSError, match="no space left"):
        deploy(env, Always(), steps=1000, log=FullDisk(tmp_path / "run", {}))
    assert robot.calls[-1] == "disconnect"
    assert "no space left" in json.loads((tmp_path / "run" / "report.json").read_text())["ended"]


def test_a_disk_that_is_hopelessly_behind_ends_the_run(tmp_path, monkeypatch):
    monkeypatch.setattr("shape_obs.deploy.run_log._WAITING", 3)
    env, *_ = cell()
    with pytest.raises(OSError, match="the disk is 3 steps behind"):
        deploy(env, Always(), steps=100, log=StallingLog(tmp_path / "run", {}, seconds=0.2))


def test_an_exception_is_in_the_report_of_the_log(tmp_path):
    env, *_ = cell()

    def fail():
        raise ZeroDivisionError("a mistake")

    with pytest.raises(ZeroDivisionError):
        deploy(env, Always({2: fail}), PATIENT, steps=10, log=RunLog(tmp_path / "run", {}))
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert (report["ended"], report["failed"], report["steps"]) == ("ZeroDivisionError: a mistake", True, 2)


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
