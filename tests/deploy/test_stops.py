"""Signals, failures and kills of real processes, in real time: an arm with its own clock, a job in the background."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
#: Seconds. 50 ms are asked for and about one is seen; a busy machine gets more, a robot that is not stopped takes 10 s.
IN_TIME = 0.5


@pytest.fixture(scope="module")
def stops():
    from tests.benchmarks import deployment

    return deployment


@pytest.mark.parametrize(
    ("name", "state", "code"),
    [
        ("SIGINT", "C", 130),
        ("SIGTERM", "send", 143),
        ("closed stdout", "moving", 1),
        pytest.param("SIGTERM", "log", 143, marks=pytest.mark.nightly),
        pytest.param("SIGHUP", "idle", 129, marks=pytest.mark.nightly),
        pytest.param("SIGQUIT", "read", 131, marks=pytest.mark.nightly),
        pytest.param("exception", "moving", 1, marks=pytest.mark.nightly),
    ],
)
def test_the_arm_stands_still_at_once_and_the_run_ends_in_order(stops, name, state, code):
    found = stops.stop(name, state)
    assert found.seconds < IN_TIME
    assert (found.moved_again, found.code, found.report) == (False, code, True)


def test_a_killed_process_leaves_an_arm_that_stops_by_itself(stops):
    found = stops.stop("SIGKILL", "moving", max_age=stops.MAX_AGE)
    assert 0 < found.seconds < stops.MAX_AGE + 0.1
    assert (found.moved_again, found.code) == (False, -9)


@pytest.mark.nightly
def test_c_code_that_holds_the_lock_of_python_moves_no_arm_for_longer_than_its_image_allows(stops):
    found = stops.stop("SIGTERM", "C with the lock", max_age=stops.MAX_AGE)
    assert found.seconds < stops.MAX_AGE + 0.1
    assert found.code == 143


BACKGROUND = """
import json, sys
from fake_cell import Always, FakeRobot, PATIENT, cell
from shape_obs.deploy import Interrupted, deploy
from shape_obs.utils.timing import CLOCK
env, robot, _ = cell(FakeRobot(clock=CLOCK))
try:
    deploy(env, Always(), PATIENT, steps=1500, on_step=lambda step: print(step.step, flush=True))
except Interrupted as interrupted:
    print(json.dumps(robot.calls))
    sys.exit(128 + interrupted.signum)
"""


def test_a_job_in_the_background_that_ignores_signals_is_stopped_by_all_but_a_hangup():
    def ignore():
        for number in (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)

    with subprocess.Popen(
        [sys.executable, "-c", BACKGROUND],
        cwd=Path(__file__).parents[1] / "support",
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=ignore,
    ) as child:
        assert child.stdout is not None
        for number, steps in ((signal.SIGHUP, 5), (signal.SIGINT, 10)):
            for _ in range(steps):
                assert child.stdout.readline().strip().isdecimal()
            child.send_signal(number)
        rest = child.stdout.read().splitlines()
        assert child.wait(60) == 130
    calls = json.loads(rest[-1])
    assert calls[-4:] == ["stop", "park", "stop", "disconnect"]
    assert "send" not in calls[calls.index("stop") :]
    assert len(rest) < 200, "it did not run to its end"
