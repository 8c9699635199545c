"""``ShapeObs/D455-v0``: steps, deadlines, failures and the limits on actions."""

from __future__ import annotations

import time
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from cell_parts import HEIGHT, INTRINSICS, ROPE, WIDTH, ListRobot, RopeSource
from gymnasium.utils.env_checker import check_env
from hypothesis import given
from hypothesis import strategies as st
from stable_baselines3.common.env_checker import check_env as check_sb3

from shape_obs import ShapeObservation
from shape_obs.robot import ActionSpec, Robot
from shape_obs.servo.action_limiter import Guard
from shape_obs.source import FrameTimeout, NotConnected, RGBDSource
from shape_obs.utils.timing import Rate


def make(source=None, robot=None, **options) -> Any:
    given = {"rate": 50.0, "size": [WIDTH, HEIGHT], "timeout": 0.2, "disable_env_checker": True, **options}
    return gym.make("shape_obs_envs:ShapeObs/D455-v0", source=source or RopeSource(robot), robot=robot, **given)


def test_the_parts_of_these_tests_keep_the_protocols():
    with RopeSource() as source:
        assert isinstance(source, RGBDSource)
    assert isinstance(ListRobot(), Robot)


@pytest.mark.parametrize("robot", [None, ListRobot(3)])
def test_both_checkers_pass_bare_and_wrapped(robot):
    env = make(robot=robot)
    check_env(env.unwrapped, skip_render_check=True)
    check_sb3(env.unwrapped)
    wrapped = ShapeObservation(env, **ROPE)
    check_sb3(wrapped)
    env.close()


def test_a_step_shows_what_was_done_and_never_an_older_image():
    robot = ListRobot()
    env = make(robot=robot)
    env.reset()
    number, observation = -1, {}
    for _ in range(5):
        observation, reward, terminated, truncated, info = env.step(np.array([1.0, 0.0]))
        assert (reward, terminated, truncated) == (0.0, False, False)
        assert info["frame"] > number
        number = info["frame"]
        assert env.unwrapped.frame.received >= env.unwrapped.sent_at
    assert observation["robot"] == pytest.approx([0.05, 0.0])
    blue = np.flatnonzero((observation["rgb"][..., 0] < 100).any(axis=0))
    assert blue.min() == pytest.approx(40 - 3 + 100 * 0.05 / 0.7, abs=2)
    env.close()


def test_steps_keep_the_rate_for_any_duration_of_the_policy():
    env = make(robot=ListRobot(), rate=25.0)
    env.reset()
    begin = time.monotonic()
    for i in range(10):
        time.sleep(0.02 if i % 2 else 0.0)
        env.step(None)
    assert time.monotonic() - begin == pytest.approx(0.4, abs=0.08)
    time.sleep(0.1)
    *_, info = env.step(None)
    assert info["overrun"]
    assert env.unwrapped.rate.overruns >= 1
    env.close()


def test_none_stands_still():
    robot = ListRobot()
    env = make(robot=robot)
    env.reset()
    env.step(None)
    assert robot.calls[-1] == "stop"
    assert "send" not in robot.calls
    env.close()


def test_a_failing_camera_ends_the_episode_in_black_and_the_next_reset_reconnects():
    robot = ListRobot()
    source = RopeSource(robot)
    env = ShapeObservation(make(source, robot), **ROPE)
    env.reset()
    source.gone = True
    _, _, terminated, truncated, info = env.step(np.zeros(2))
    assert (terminated, truncated) == (False, True)
    assert info["camera_error"].startswith("no frame in")
    assert robot.calls[-1] == "stop"
    assert info["shape/age"] > 0
    with pytest.raises(NotConnected):
        env.step(np.zeros(2))
    with pytest.raises(FrameTimeout):
        env.reset()
    source.gone = False
    _, info = env.reset()
    assert info["shape/ok"]
    assert info["shape/age"] == 0
    assert source.connects == 2
    env.close()


def test_the_images_of_a_failed_camera_are_black():
    robot = ListRobot()
    source = RopeSource(robot)
    env = make(source, robot)
    env.reset()
    source.gone = True
    observation, *_ = env.step(np.zeros(2))
    assert not observation["rgb"].any()
    assert not observation["depth"].any()
    assert env.observation_space.contains(observation)


def test_a_failing_robot_ends_the_episode():
    robot = ListRobot()
    env = make(robot=robot)
    env.reset()
    robot.fails = True
    *_, truncated, info = env.step(np.zeros(2))
    assert truncated
    assert info["robot_error"] == "the robot is in an emergency stop"


def test_images_of_another_size_raise_an_error():
    env = make(RopeSource(), size=[640, 480])
    with pytest.raises(ValueError, match=r"160 x 120 pixels, the env expects 640 x 480: make it with size="):
        env.reset()


def test_the_camera_model_is_nominal_before_and_the_cameras_own_after_the_reset():
    env = make()
    assert env.get_wrapper_attr("camera_model").intrinsics.fx == pytest.approx(386 / 4)
    assert env.get_wrapper_attr("camera_model").transform_camera_to_base[2, 3] == 0.7
    env.reset()
    assert env.get_wrapper_attr("camera_model").intrinsics == INTRINSICS
    env.close()


def test_robots_and_sources_by_name():
    env = make(RopeSource(), robot="cell_parts:ListRobot", robot_arguments={"size": 3})
    assert env.action_space.shape == (3,)
    with pytest.raises(ImportError, match="robot: cannot import 'no_lab'"):
        make(RopeSource(), robot="no_lab:Arm")
    with pytest.raises(ValueError, match="did you mean 'ListRobot'"):
        make(RopeSource(), robot="cell_parts:ListRobt")
    with pytest.raises(ValueError, match="has no camera"):
        make("robot", robot=ListRobot())


SPEC = ActionSpec(("x", "yaw"), ("m", "rad"), (0.02, 0.1), (-0.3, -1.0), (0.3, 1.0))
numbers = st.floats(-5, 5)


@given(st.tuples(numbers, numbers), st.tuples(st.floats(-0.4, 0.4), st.floats(-1.5, 1.5)))
def test_no_guarded_motion_is_too_long_or_leads_out(action, state):
    guard = Guard(SPEC, max_step=[0.01, 0.2], workspace=((-0.2, -9), (0.25, 9)))
    motion = guard.motion(action, state).motion
    assert np.all(np.abs(motion) <= np.array([0.01, 0.1]) + 1e-12)
    target = np.asarray(state) + motion
    outside = np.maximum(guard.low - target, 0) + np.maximum(target - guard.high, 0)
    before = np.maximum(guard.low - state, 0) + np.maximum(np.asarray(state) - guard.high, 0)
    assert np.all(outside <= before + 1e-12)


def test_the_guard_reports_what_it_did():
    guard = Guard(SPEC)
    assert guard.motion([0.5, -0.5], [0, 0])[1:] == (False, False, False)
    assert guard.motion([2.0, 0.0], [0, 0])[1:] == (True, False, False)
    assert Guard(SPEC, max_step=[0.01, 1]).motion([1.0, 0.0], [0, 0])[1:] == (False, True, False)
    assert guard.motion([1.0, 0.0], [0.295, 0]).boxed


@pytest.mark.parametrize(("mode", "sent"), [("displacement", 0.01), ("velocity", 0.01), ("position", 0.01)])
def test_the_guard_speaks_each_mode(mode, sent):
    spec = ActionSpec(("x",), ("m",), (0.01,), (-1,), (1,), mode)
    assert Guard(spec, max_step=[0.5], dt=0.1).motion([1.0], [0.0]).motion == pytest.approx([sent])
    if mode != "position":
        assert Guard(spec, dt=0.1).max_step == pytest.approx([0.001 if mode == "velocity" else 0.01])
    capped = Guard(spec, max_step=[0.0005], dt=0.1).motion([1.0], [0.0])
    assert capped.capped
    assert capped.motion == pytest.approx([0.005 if mode == "velocity" else 0.0005])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"max_step": [1.0]}, "max_step: expected 2 numbers"),
        ({"max_step": [0.0, 1.0]}, "max_step: expected positive"),
        (
            {"workspace": [[0.4, -1], [0.5, 1]]},
            "nothing is left of 'x', which the robot can move within -0.3 ... 0.3 m",
        ),
    ],
)
def test_bad_guards_raise_an_error(options, message):
    with pytest.raises(ValueError, match=message):
        Guard(SPEC, **options)
    with pytest.raises(ValueError, match="action: expected 2 finite numbers"):
        Guard(SPEC).motion([np.nan, 0], [0, 0])


def test_a_late_loop_does_not_hurry_to_catch_up():
    rate = Rate(100)
    time.sleep(0.055)
    assert rate.wait() == pytest.approx(-0.045, abs=0.01)
    begin = time.monotonic()
    rate.wait()
    rate.wait()
    assert 0.01 <= time.monotonic() - begin < 0.03
    assert rate.overruns == 1


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"units": ["m"]}, "ActionSpec.units: expected 2 values"),
        ({"units": ["m", "deg"]}, "expected 'm', 'rad', '1', got 'deg'"),
        ({"low": [1, -1], "high": [0, 1]}, "finite low < high"),
        ({"names": ["x", "x"]}, "different names"),
        ({"scale": [0, 1]}, "positive"),
    ],
)
def test_bad_action_specs_raise_an_error(fields, message):
    with pytest.raises(ValueError, match=message):
        ActionSpec.from_dict({**SPEC.to_dict(), **fields})
