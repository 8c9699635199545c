"""Signals during a deployment: the robot stops, parks and is disconnected, and the report is there."""

from __future__ import annotations

import json
import re
import signal
import sys
import threading
from functools import partial

import pytest
from fake_camera import FakeCamera
from fake_cell import PATIENT, ROPE, Always, FakeRobot, cell, rope

from shape_obs import save_config
from shape_obs.deploy import Interrupted, RunLog, deploy, supervised

pytestmark = [
    pytest.mark.usefixtures("default_signals"),
    pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals"),
]
terminate = partial(signal.raise_signal, signal.SIGTERM)


@pytest.mark.parametrize("ignored", [False, True])
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT"])
def test_a_signal_stops_parks_reports_and_is_raised(name, ignored, tmp_path):
    """Also if the process inherited that it is ignored, as a job in the background does; but ``nohup`` is respected."""
    number = getattr(signal, name)
    if ignored:
        signal.signal(number, signal.SIG_IGN)
    handler = signal.getsignal(number)
    env, robot, _ = cell()
    controller, log = Always({3: partial(signal.raise_signal, number)}), RunLog(tmp_path / "run", {})
    if ignored and name == "SIGHUP":
        try:
            assert deploy(env, controller, PATIENT, steps=10, log=log).acted == 10
        except Interrupted:  # which would end the tests
            pytest.fail("an ignored hangup ended the run")
    else:
        with pytest.raises(Interrupted, match=f"interrupted by {name}") as caught:
            deploy(env, controller, PATIENT, steps=10, log=log)
        assert caught.value.signum == number
        assert (caught.value.report.steps, caught.value.report.failed) == (3, False)
        assert json.loads((tmp_path / "run" / "report.json").read_text())["ended"] == f"interrupted by {name}"
    assert robot.calls.index("park") > robot.calls.index("stop")
    assert robot.calls[-1] == "disconnect"
    assert signal.getsignal(number) == handler
    assert signal.set_wakeup_fd(-1) == -1
    assert "signals" not in [thread.name for thread in threading.enumerate()]


@pytest.mark.parametrize("signalled", [True, False])
def test_a_system_error_is_a_signal_only_if_one_came(signalled):
    def act():
        try:
            if signalled:
                terminate()
        except Interrupted as interrupted:  # as the interpreter does where C code goes on after an exception
            raise SystemError("<function> returned a result with an exception set") from interrupted
        raise SystemError("no signal")

    env, robot, _ = cell()
    with pytest.raises(Interrupted if signalled else SystemError) as caught:
        deploy(env, Always({2: act}), steps=9)
    if isinstance(caught.value, Interrupted):
        assert (caught.value.report.ended, caught.value.report.failed) == ("interrupted by SIGTERM", False)
    assert robot.calls[-1] == "disconnect"


def test_a_signal_while_it_parks_ends_the_parking():
    env, robot, _ = cell()
    park = robot.park

    def parking():
        park()
        terminate()
        robot.connect()  # never

    robot.park = parking
    with pytest.raises(Interrupted) as caught:
        deploy(env, Always(), steps=3)
    assert caught.value.report.ended == "time limit reached"
    assert robot.calls.count("connect") == 1
    assert robot.calls[robot.calls.index("park") + 1] == "stop"  # from the thread that waits for signals
    assert robot.calls[-1] == "disconnect"


def test_a_second_signal_leaves_parking_out():
    env, robot, _ = cell()
    stop = robot.stop

    def impatient():
        stop()
        if robot.calls.count("stop") == 2:  # the loop's own, after the first signal
            terminate()

    robot.stop = impatient
    with pytest.raises(Interrupted):
        deploy(env, Always({2: terminate}), steps=9)
    assert "park" not in robot.calls
    assert robot.calls[-1] == "disconnect"


def test_a_signal_between_the_episodes_of_one_supervision_parks_once():
    env, robot, _ = cell()
    once = {"park": False, "close": False, "steps": 3}
    with pytest.raises(Interrupted), supervised(env):
        assert deploy(env, Always(), **once).acted + deploy(env, Always({1: terminate}), **once).acted == 0
    assert robot.calls.count("reset") == 2
    assert robot.calls.count("park") == robot.calls.count("disconnect") == 1


def test_outside_the_main_thread_it_runs_without_signals():
    reports = []
    thread = threading.Thread(target=lambda: reports.append(deploy(cell()[0], Always(), PATIENT, steps=3)))
    thread.start()
    thread.join()
    assert reports[0].acted == 3


@pytest.mark.parametrize(
    ("camera", "robot", "code", "message"),
    [
        ("rope", "broken=[connect,stop,park]", 1, "connect: the robot [^;]*$"),
        ("rope", "broken=[reset] foreign=true", 1, "deploy: robot.reset: RuntimeError: reset: the robot [^;]*$"),
        ("rope", "broken=[__init__] foreign=true", 2, "fake_cell:Robot cannot be made: RuntimeError: __init__"),
        ("unplugged", "broken=[stop,park,disconnect]", 1, "not plugged in; then: stop: the .*; then: disconnect: the"),
        ("unplugged", "size=2 --goal robot --episodes 2", 1, "deploy: fake camera: it is not plugged in$"),
        ("rope", "broken=[reset,park]", 1, "deploy: reset: the robot .*; then: park: the robot"),
        ("rope", "size=2 --controller types:SimpleNamespace", 1, "deploy: controller: expected an object with act"),
        ("rope", "signals={connect:\u00a0SIGINT}", 130, "deploy: interrupted by SIGINT$"),
        (
            "rope",
            "signals={connect:\u00a0SIGTERM} broken=[connect,stop]",
            143,
            "SIGTERM; then: connect: [^;]*$",
        ),
        ("rope", "signals={reset:\u00a0SIGTERM} broken=[park]", 143, "deploy: interrupted by SIGTERM; then: park: the"),
        ("rope", "signals={__init__:\u00a0SIGTERM} broken=[__init__]", 143, "deploy: interrupted by SIGTERM$"),
        ("rope", "signals={park:\u00a0SIGINT} broken=[reset]", 130, "SIGINT; then: reset: the robot"),
    ],
)
def test_a_start_that_fails_moves_nothing_and_shows_the_first_error_first(
    run, monkeypatch, tmp_path, camera, robot, code, message
):
    robots = []
    monkeypatch.setattr(
        "fake_cell.Robot", lambda **options: robots.append(FakeRobot(**options)) or robots[-1], raising=False
    )
    config = tmp_path / "shape.yaml"
    save_config(config, ROPE)
    options = [part.replace("\u00a0", " ") for part in robot.split(" ")]
    named = ["--source", f"fake_cell:{camera}_camera", "--config", config, "--size", 160, 120]
    ended, _, err = run(
        "deploy", *named, "--log", tmp_path / "run", "--robot", "fake_cell:Robot", "--robot-set", *options
    )
    assert (ended, err.count("\n")) == (code, 1), err
    assert re.search(message, err.strip()), err
    for made in robots:
        assert "reset" in made.attempts or not {"park", "send"} & set(made.attempts)
        stops = made.attempts.count("stop") - made.attempts.count("park")  # a motion of its own
        assert stops <= ("connect" in made.calls) + bool(re.search("signals={(reset|park)", robot))  # stops at once


def test_sigterm_ends_a_recording_as_ctrl_c_does(run, monkeypatch, tmp_path):
    camera = FakeCamera(lambda number: terminate() if number == 3 else rope())
    monkeypatch.setattr("fake_cell.camera", lambda: camera, raising=False)
    code, out, err = run("record", "--source", "fake_cell:camera", "-o", tmp_path / "run", "--json")
    assert (code, json.loads(out)["frames"], json.loads(out)["stopped"]) == (0, 3, "interrupted"), err
