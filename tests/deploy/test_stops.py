"""Signals, failures and kills of real processes that drive an arm with its own clock."""

from __future__ import annotations

import sys

import pytest

from tests.benchmarks import stop_claims as stops

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
#: Seconds. 50 ms are asked for and about one is seen; a busy machine gets more, a robot that is not stopped takes 10 s.
IN_TIME = 0.5


@pytest.fixture(scope="module")
def arm():
    with stops.ArmProcess() as arm:
        yield arm


@pytest.mark.parametrize(
    ("name", "state", "code"),
    [
        ("SIGINT", "C", 130),
        ("SIGTERM", "moving", 143),
        ("SIGTERM", "idle", 143),
        ("SIGHUP", "send", 129),
        ("SIGQUIT", "read", 131),
        ("SIGTERM", "log", 143),
        ("exception", "moving", 1),
        ("closed stdout", "moving", 1),
    ],
)
def test_the_arm_stands_still_at_once_and_the_run_ends_in_order(arm, name, state, code):
    found = stops.stop(arm, name, state)
    assert found.seconds < IN_TIME
    assert (found.moved_again, found.code, found.report) == (False, code, True)


def test_a_killed_process_leaves_an_arm_that_stops_by_itself(arm):
    for wait in (0.0, 0.3):
        found = stops.stop(arm, "SIGKILL", "moving", wait=wait, max_age=stops.MAX_AGE)
        assert 0 < found.seconds < stops.MAX_AGE + 0.1
        assert (found.moved_again, found.code) == (False, -9)


def test_c_code_that_holds_the_lock_of_python_moves_no_arm_for_longer_than_its_image_allows(arm):
    found = stops.stop(arm, "SIGTERM", "C with the lock", max_age=stops.MAX_AGE)
    assert found.seconds < stops.MAX_AGE + 0.1
    assert found.code == 143
