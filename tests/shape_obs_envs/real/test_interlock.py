"""The interlock: motions end in time, none is sent on an old image, and what must stop does so from any thread."""

from __future__ import annotations

import logging
import threading
import time
from typing import Any

import numpy as np
import pytest
from fake_cell import FakeRobot, cell, make_env

from shape_obs.robot import RobotError
from shape_obs.utils.timing import CLOCK
from shape_obs_envs.real.interlock import Interlock

MOTION = np.ones(2)


@pytest.fixture
def robot():
    return FakeRobot()


@pytest.fixture
def clock(robot):
    return robot.clock


@pytest.fixture
def interlock(robot, clock):
    interlock = Interlock(robot, clock)
    interlock.connect()
    robot.times.clear()
    return interlock


def test_in_real_time_a_thread_ends_a_motion_and_a_close_ends_the_thread():
    robot = FakeRobot(clock=CLOCK)
    interlock = Interlock(robot)
    interlock.connect()
    interlock.send(MOTION, time.monotonic() + 9)
    until = time.monotonic() + 0.1
    assert interlock.send(MOTION, until) == "", "a sooner end wakes the thread"
    while "stop" not in robot.calls and time.monotonic() < until + 5:  # the loop is blocked
        time.sleep(0.01)
    assert robot.calls == ["connect", "send", "send", "stop"]
    assert 0 <= robot.when("stop")[0] - until < 0.5
    interlock.send(MOTION, time.monotonic() + 9)
    interlock.close()
    assert "motion end" not in [thread.name for thread in threading.enumerate()]
    assert (robot.calls, interlock.expired) == (["connect", "send", "send", "stop", "send", "disconnect"], 1)


def test_a_motion_that_nothing_replaces_ends_on_time(interlock, robot, clock):
    assert interlock.send(MOTION, clock.now() + 0.1) == ""
    clock.sleep(1.0)
    assert robot.times == [("send", 1000.0), ("stop", 1000.1)]
    assert interlock.expired == 1


def test_a_motion_that_is_replaced_in_time_goes_on_and_one_that_was_stopped_does_not_expire(interlock, robot, clock):
    for _ in range(6):
        interlock.send(MOTION, clock.now() + 0.15)
        clock.sleep(0.1)
    assert "stop" not in robot.calls
    interlock.stop()
    clock.sleep(1.0)
    assert (robot.calls.count("stop"), interlock.expired) == (1, 0)


def test_nothing_is_sent_after_its_time_or_after_a_trip_until_it_is_armed(interlock, robot, clock):
    assert interlock.send(MOTION, clock.now() - 0.01) == interlock.send(MOTION, clock.now()) == "image old"
    assert robot.calls == ["stop", "stop"]
    interlock.trip("a person")
    assert robot.calls == ["stop", "stop", "stop"]
    assert interlock.send(MOTION, clock.now() + 9) == "a person"
    assert "send" not in robot.calls
    interlock.arm()
    assert interlock.send(MOTION, clock.now() + 9) == ""


def test_a_send_that_was_blocked_too_long_is_stopped_at_its_time_and_again_when_it_returns(interlock, robot, clock):
    robot.slow["send"] = 0.3
    assert interlock.send(MOTION, clock.now() + 0.1) == "image old"
    assert robot.times == [("stop", 1000.1), ("send", 1000.3), ("stop", 1000.3)]


@pytest.mark.parametrize("how", ["expires", "trips"])
def test_a_robot_that_cannot_be_stopped_is_an_error_of_the_next_call(how, interlock, robot, clock, caplog):
    interlock.send(MOTION, clock.now() + 0.05)
    robot.broken.add("stop")
    with caplog.at_level(logging.CRITICAL):
        if how == "expires":
            clock.sleep(0.1)
        else:
            interlock.trip("a person")
    with pytest.raises(RobotError, match="emergency stop"):
        interlock.send(MOTION, clock.now() + 9)


def test_a_robot_that_takes_no_end_of_its_motions_is_refused():
    class Endless(FakeRobot):
        def send(self, action: Any) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
            """Ignore the end of the motion."""

    with pytest.raises(TypeError, match=r"expected Endless.send\(action, until\), got Endless.send\(action\)"):
        make_env(robot=Endless())
    with pytest.raises(TypeError, match="object has no 'connect'"):
        make_env(make_env().unwrapped.source, object())


# ---- in the environment


def test_no_motion_is_sent_on_an_image_that_grew_old_while_the_robot_was_asked_where_it_is():
    env, robot, _ = cell(rate=20.0)
    env.reset()
    env.step(MOTION)
    robot.slow["state"] = 0.3
    *_, info = env.step(MOTION)
    assert info["withheld"] == "image old"
    assert robot.calls.count("send") == 1
    *_, info = env.step(MOTION)
    assert "withheld" not in info
    assert robot.calls.count("send") == 2


def test_the_age_of_an_image_counts_from_its_exposure():
    env, _, camera = cell()
    _, info = env.reset()
    assert info["exposed"] <= info["received"]
    camera.exposure = 0.05
    *_, info = env.step(None)
    assert info["received"] - info["exposed"] == pytest.approx(0.05)
    camera.delay = 0.15  # the next frames were taken that much earlier than they came
    *_, info = env.step(None)
    assert info["received"] - info["exposed"] == pytest.approx(0.15)
    env.step(MOTION)
    *_, info = env.step(MOTION)
    assert info.get("withheld", "") == ""  # 0.15 s and a step of 0.02 s are within 0.2 s
    camera.delay = 0.3
    env.step(None)
    *_, info = env.step(MOTION)
    assert info["withheld"] == "image old"
