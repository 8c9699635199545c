"""The interlock: motions end in time, and none is sent on an old image."""

from __future__ import annotations

import logging
import time
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from cell_parts import HEIGHT, ROPE, WIDTH, ListRobot, RopeSource

from shape_obs import ShapeObservation
from shape_obs.deploy import Limits, deploy
from shape_obs.robot import RobotError
from shape_obs_envs.real.interlock import Interlock


class TimedRobot(ListRobot):
    """A robot that records its commands with their times, and ignores `until` as a careless driver would."""

    def __init__(self, **spec: Any) -> None:
        super().__init__(**spec)
        self.notes: list[tuple[str, float]] = []
        self.slow_send = self.slow_state = 0.0
        self.deaf = False

    def send(self, action: Any, until: float) -> None:
        time.sleep(self.slow_send)
        super().send(action, until)
        self.notes.append(("send", time.monotonic()))

    def state(self) -> Any:
        slow, self.slow_state = self.slow_state, 0.0  # once
        time.sleep(slow)
        return super().state()

    def stop(self) -> None:
        super().stop()
        self.notes.append(("stop", time.monotonic()))
        if self.deaf:
            raise RobotError("the robot does not answer")

    def times(self, what: str) -> list[float]:
        return [moment for name, moment in self.notes if name == what]


def make(robot, source=None, **options) -> Any:
    options = {"rate": 50.0, "timeout": 1.0, "size": [WIDTH, HEIGHT], "disable_env_checker": True, **options}
    env = gym.make(
        "shape_obs_envs:ShapeObs/D455-v0",
        source=RopeSource(robot) if source is None else source,
        robot=robot,
        **options,
    )
    return ShapeObservation(env, **ROPE)


def test_a_motion_that_nothing_replaces_ends_on_time_even_if_the_robot_is_busy():
    robot = TimedRobot()
    interlock = Interlock(robot)
    until = time.monotonic() + 0.1
    assert interlock.send(np.ones(2), until) == ""
    time.sleep(0.25)
    assert robot.calls == ["send", "stop"]
    assert 0 <= robot.times("stop")[0] - until < 0.1
    assert interlock.expired == 1
    interlock.close()


def test_a_motion_that_is_replaced_in_time_goes_on_and_one_that_was_stopped_does_not_expire():
    robot = TimedRobot()
    interlock = Interlock(robot)
    for _ in range(6):
        interlock.send(np.ones(2), time.monotonic() + 0.15)
        time.sleep(0.05)
    assert "stop" not in robot.calls
    interlock.stop()
    time.sleep(0.2)
    assert (robot.calls.count("stop"), interlock.expired) == (1, 0)
    interlock.close()


def test_nothing_is_sent_after_its_time_or_after_a_trip_until_it_is_armed():
    robot = TimedRobot()
    interlock = Interlock(robot)
    assert interlock.send(np.ones(2), time.monotonic() - 0.01) == "image old"
    assert robot.calls == ["stop"]
    interlock.trip("a person")
    assert robot.calls == ["stop", "stop"]
    assert interlock.send(np.ones(2), time.monotonic() + 9) == "a person"
    assert "send" not in robot.calls
    interlock.arm()
    assert interlock.send(np.ones(2), time.monotonic() + 9) == ""
    interlock.close()


def test_a_send_that_was_blocked_too_long_is_stopped_at_its_time_and_again_when_it_returns():
    robot = TimedRobot()
    robot.slow_send = 0.3
    interlock = Interlock(robot)
    until = time.monotonic() + 0.1
    assert interlock.send(np.ones(2), until) == "image old"
    first, last = robot.times("stop")
    assert first - until < 0.1
    assert 0 <= last - robot.times("send")[0] < 0.05
    interlock.close()


def test_a_robot_that_cannot_be_stopped_is_an_error_of_the_next_call(caplog):
    robot = TimedRobot()
    interlock = Interlock(robot)
    interlock.send(np.ones(2), time.monotonic() + 0.05)
    robot.deaf = True
    with caplog.at_level(logging.CRITICAL):
        time.sleep(0.15)
    with pytest.raises(RobotError, match="does not answer"):
        interlock.send(np.ones(2), time.monotonic() + 9)
    interlock.close()


def test_a_robot_that_takes_no_end_of_its_motions_is_refused():
    class Endless(ListRobot):
        def send(self, action: Any) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
            """Ignore the end of the motion."""

    with pytest.raises(TypeError, match=r"expected Endless.send\(action, until\), got Endless.send\(action\)"):
        make(Endless())
    with pytest.raises(TypeError, match="object has no 'connect'"):
        make(object(), RopeSource())


@pytest.mark.parametrize("mode", ["velocity", "displacement"])
def test_a_frozen_camera_means_no_motion_after_max_age(mode):
    robot = TimedRobot(mode=mode, low=[-9, -9], high=[9, 9])
    source = RopeSource()
    env = make(robot, source)
    exposed = []

    class Freeze:
        def act(self, observation):
            exposed.append(env.unwrapped.frame.received)
            source.gone = len(exposed) == 5
            return np.ones(2)

    report = deploy(env, Freeze(), Limits(max_age=0.2), steps=50)
    assert "no frame in" in report.ended
    stopped = min(moment for moment in robot.times("stop") if moment > exposed[-1])
    assert stopped - exposed[-1] == pytest.approx(0.2, abs=0.1)
    assert report.expired == 1


def test_no_motion_is_sent_on_an_image_that_grew_old_while_the_robot_was_asked_where_it_is():
    robot = TimedRobot()
    env = make(robot, rate=20.0)
    env.reset()
    env.step(np.ones(2))
    robot.slow_state = 0.3
    *_, info = env.step(np.ones(2))
    assert info["withheld"] == "image old"
    assert robot.calls.count("send") == 1
    *_, info = env.step(np.ones(2))
    assert "withheld" not in info
    assert robot.calls.count("send") == 2
    env.close()


def test_a_motion_that_the_loop_withheld_counts_as_held_and_the_controller_hears_of_it():
    robot = TimedRobot()
    env = make(robot, rate=20.0)
    withheld = []

    class Slow:
        step = 0

        def act(self, observation):
            self.step += 1
            robot.slow_state = 0.7 * (self.step == 3)
            return np.ones(2)

        def withheld(self):
            withheld.append(self.step)

    report = deploy(env, Slow(), Limits(max_age=0.5), steps=6)
    assert withheld == [3]
    assert (report.acted, report.held, report.reasons) == (5, 1, {"image old": 1})


def test_after_the_watchdog_nothing_is_sent_that_was_blocked_before():
    robot = TimedRobot()
    env = make(robot)

    class Block:
        step = 0

        def act(self, observation):
            self.step += 1
            robot.slow_state = 0.6 * (self.step == 3)
            return np.ones(2)

    report = deploy(env, Block(), Limits(watchdog=0.2, max_age=9.0), steps=50)
    assert "watchdog" in report.ended
    assert robot.calls.count("send") == 2
    assert max(robot.times("send")) < min(robot.times("stop"))


def test_the_age_of_an_image_counts_from_its_exposure():
    robot = ListRobot()
    source = RopeSource(robot)
    env = make(robot, source)
    _, info = env.reset()
    assert info["exposed"] <= info["received"]
    source.exposure = 0.05
    *_, info = env.step(None)
    assert info["received"] - info["exposed"] == pytest.approx(0.05)
    source.delay = 0.15  # the next frames were taken that much earlier than they came
    *_, info = env.step(None)
    assert info["received"] - info["exposed"] == pytest.approx(0.15, abs=0.03)
    *_, info = env.step(np.ones(2))
    *_, info = env.step(np.ones(2))
    assert info.get("withheld", "") == ""  # 0.15 s and a step of 0.02 s are within 0.2 s
    source.delay = 0.3
    env.step(None)
    *_, info = env.step(np.ones(2))
    assert info["withheld"] == "image old"
    env.close()
