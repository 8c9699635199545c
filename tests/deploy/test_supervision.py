"""Signals during a deployment: the robot stops, parks and is disconnected, and the report is there."""

from __future__ import annotations

import json
import signal
import threading

import numpy as np
import pytest
from deploy_parts import PATIENT, Always, cell

from shape_obs.deploy import Interrupted, RunLog, deploy, supervised


def raising(name):
    """Return a controller that receives a signal while it acts."""

    def act():
        signal.raise_signal(getattr(signal, name))
        return np.zeros(2)

    return act


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT"])
def test_a_signal_stops_parks_reports_and_is_raised(name, tmp_path):
    handler = signal.getsignal(getattr(signal, name))
    env, robot, _ = cell()
    with pytest.raises(Interrupted, match=f"interrupted by {name}") as caught:
        deploy(env, Always({3: raising(name)}), PATIENT, steps=10, log=RunLog(tmp_path / "run", {}))
    assert caught.value.signum == getattr(signal, name)
    assert (caught.value.report.steps, caught.value.report.failed) == (3, False)
    assert json.loads((tmp_path / "run" / "report.json").read_text())["ended"] == f"interrupted by {name}"
    assert robot.calls.index("park") > robot.calls.index("stop")
    assert robot.calls[-1] == "disconnect"
    assert signal.getsignal(getattr(signal, name)) == handler
    assert signal.set_wakeup_fd(-1) == -1
    assert "signals" not in [thread.name for thread in threading.enumerate()]


def test_a_signal_within_a_compiled_function_is_a_signal(tmp_path):
    def act():
        try:
            signal.raise_signal(signal.SIGTERM)
        except Interrupted as interrupted:  # as the interpreter does where C code goes on after an exception
            raise SystemError("<function> returned a result with an exception set") from interrupted

    env, robot, _ = cell()
    with pytest.raises(Interrupted) as caught:
        deploy(env, Always({2: act}), steps=9)
    assert (caught.value.report.ended, caught.value.report.failed) == ("interrupted by SIGTERM", False)
    assert robot.calls[-1] == "disconnect"


def test_a_system_error_without_a_signal_stays_what_it_is():
    def act():
        raise SystemError("no signal")

    with pytest.raises(SystemError, match="no signal"):
        deploy(cell()[0], Always({2: act}), steps=9)


def test_a_signal_while_it_parks_ends_the_parking():
    env, robot, _ = cell()

    def park():
        robot.calls.append("park")
        signal.raise_signal(signal.SIGTERM)
        robot.calls.append("parked")

    robot.park = park  # type: ignore[method-assign]
    with pytest.raises(Interrupted) as caught:
        deploy(env, Always(), steps=3)
    assert caught.value.report.ended == "time limit reached"
    assert "parked" not in robot.calls
    assert robot.calls[robot.calls.index("park") + 1] == "stop"  # from the thread that waits for signals
    assert robot.calls[-1] == "disconnect"


def test_a_second_signal_leaves_parking_out():
    env, robot, _ = cell()
    stop = robot.stop

    def impatient():
        stop()
        if robot.calls.count("stop") == 2:  # the loop's own, after the first signal
            signal.raise_signal(signal.SIGTERM)

    robot.stop = impatient  # type: ignore[method-assign]
    with pytest.raises(Interrupted):
        deploy(env, Always({2: raising("SIGTERM")}), steps=9)
    assert "park" not in robot.calls
    assert robot.calls[-1] == "disconnect"


def test_a_signal_between_the_episodes_of_one_supervision_parks_once():
    env, robot, _ = cell()

    def play():
        with supervised(env):
            for number in range(3):
                at = {1: raising("SIGTERM")} if number == 1 else {}
                deploy(env, Always(at), steps=3, park=False, close=False)

    with pytest.raises(Interrupted):
        play()
    assert robot.calls.count("reset") == 2
    assert robot.calls.count("park") == robot.calls.count("disconnect") == 1


def test_signals_that_are_ignored_stay_ignored():
    previous = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as nohup does
    try:
        env, *_ = cell()
        assert deploy(env, Always({1: raising("SIGHUP")}), PATIENT, steps=4).acted == 4
    except Interrupted:
        pytest.fail("an ignored signal ended the run")
    finally:
        signal.signal(signal.SIGHUP, previous)


def test_outside_the_main_thread_it_runs_without_signals():
    env, *_ = cell()
    reports = []
    thread = threading.Thread(target=lambda: reports.append(deploy(env, Always(), PATIENT, steps=3)))
    thread.start()
    thread.join()
    assert reports[0].acted == 3
