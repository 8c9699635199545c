"""Robots without hardware: one that does not move, and one simulated in real time in front of a software D455."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Iterator
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
import pytest

from shape_obs import ShapeDetector
from shape_obs.frame import Frame
from shape_obs.robot import ActionSpec, Robot, RobotError, robot_anchors
from shape_obs_envs.robots import NullRobot, SimulatedRobot

simulated = pytest.mark.skipif(
    not (find_spec("mujoco") and find_spec("pyrealsense2")),
    reason="the simulated robot needs MuJoCo and librealsense: extras sim, realsense",
)


def soon() -> float:
    return time.monotonic() + 5.0


# ---- what every robot promises


@pytest.mark.parametrize("name", ["null", pytest.param("simulated", marks=simulated)])
def test_every_robot_moves_only_when_connected_by_finite_motions_in_time_and_stops_from_any_thread(name, request):
    with pytest.raises(RobotError, match="not connected"):
        (NullRobot() if name == "null" else SimulatedRobot()).reset()
    robot: Any = NullRobot(size=6) if name == "null" else request.getfixturevalue("robot")
    assert isinstance(robot, Robot)
    robot.connect()
    robot.reset()
    start = robot.state()
    spec = robot.action_spec
    inwards = np.where(start > (np.asarray(spec.low) + spec.high) / 2, -1.0, 1.0)
    motion = 0.4 * inwards * spec.scale
    robot.send(motion, soon())
    assert robot.state() == pytest.approx(start + motion)
    for bad in (np.zeros(5), np.full(6, np.nan)):
        with pytest.raises(RobotError, match="6 finite numbers"):
            robot.send(bad, soon())
    thread = threading.Thread(target=robot.stop)
    thread.start()
    thread.join()
    stopped = robot.state()
    assert (np.abs(stopped - start) <= np.abs(motion) + 1e-9).all()
    robot.stop()
    robot.send(motion, time.monotonic() - 0.01)  # its time is over
    assert robot.state() == pytest.approx(stopped, abs=1e-9)
    robot.park()
    robot.reset()


# ---- NullRobot


def test_the_null_robot_records_its_commands_and_takes_any_spec() -> None:
    fields = {"names": ["lift"], "units": ["m"], "scale": [0.1], "low": [0.0], "high": [1.0], "mode": "velocity"}
    robot = NullRobot(spec=fields, period=0.5)
    robot.connect()
    robot.reset()
    robot.send(np.array([0.1]), soon())
    assert robot.action_spec == ActionSpec.from_dict(fields)
    assert robot.state() == pytest.approx([0.55])
    assert [motion.tolist() for _, motion in robot.sent] == [[0.1]]
    with pytest.raises(ValueError, match="size"):
        NullRobot(size=0)


# ---- SimulatedRobot


class FirstStart(NamedTuple):
    state: np.ndarray
    goal: np.ndarray


@simulated
@pytest.mark.parametrize(
    "name",
    ["Cable", *(pytest.param(name, marks=pytest.mark.nightly) for name in ("Cables", "Ring", "Cloth", "Hanging"))],
)
def test_the_object_ages_and_follows_by_the_clock_whatever_its_timestep(name) -> None:
    from shape_obs_envs.robots.simulation_loop import RealtimeSimulation

    simulation = RealtimeSimulation(f"ShapeObs/{name}-v0")
    poses = simulation.restart(0)
    start = simulation.state()[0]  # the time comes first
    held = simulation.anchors()
    shift = np.array([0.0, 0.004, 0.0])
    steps = round(0.5 / simulation.dt)
    for step in range(steps):
        simulation.advance(poses + shift * (step + 1) / steps)
    assert simulation.state()[0] - start == pytest.approx(0.5, abs=1e-6)
    simulation.env._body.refresh()
    moved = {anchor: place[1] - held[anchor][1] for anchor, place in simulation.anchors().items()}
    loose = moved.pop("socket2", 0.0)  # the end of a rope that no gripper holds
    np.testing.assert_allclose([*moved.values()], 0.004, atol=2e-3)
    assert loose == pytest.approx(0.0, abs=1e-3)


@pytest.fixture(scope="module")
def started() -> Iterator[tuple[SimulatedRobot, FirstStart]]:
    robot = SimulatedRobot(seed=1)
    robot.connect()
    robot.reset()
    yield robot, FirstStart(robot.state(), robot.goal)
    robot.disconnect()


@pytest.fixture
def robot(started: tuple[SimulatedRobot, FirstStart]) -> SimulatedRobot:
    return started[0]


def frames(robot: SimulatedRobot, count: int) -> list[Frame]:
    with robot.source() as source:
        return [source.read(timeout=10.0) for _ in range(count)]


@simulated
def test_it_is_a_robot_that_moves_as_commanded(robot: SimulatedRobot) -> None:
    assert robot.action_spec.names[:3] == ("gripper0/x", "gripper0/y", "gripper0/yaw")
    assert robot.action_spec.units == 2 * ("m", "m", "rad")
    robot.reset()
    start = robot.state()
    before = np.array(robot_anchors(robot)["gripper0"])
    motion = np.array([0.01, 0.012, 0.0, -0.01, 0.012, 0.0])
    robot.send(motion, soon())
    assert robot.state() == pytest.approx(start + motion)
    frames(robot, 30)
    assert np.array(robot.anchors["gripper0"]) - before == pytest.approx([0.01, 0.012, 0], abs=3e-3)

    robot.send(np.full(6, 5.0), soon())  # no further than the workspace lets both grippers go
    assert (robot.state() <= np.asarray(robot.action_spec.high) + 1e-9).all()
    robot.park()
    assert robot.state() == pytest.approx(start)


@simulated
def test_a_motion_ends_at_its_time_by_the_clock_of_the_simulation(robot: SimulatedRobot) -> None:
    robot.reset()
    frames(robot, 5)
    start, before = robot.state(), np.array(robot.anchors["gripper0"])
    motion = np.array([0.0, 0.02, 0.0, 0.0, 0.02, 0.0])
    robot.send(motion, time.monotonic() + 0.02)  # of the 0.05 s that it takes
    moved = robot.state() - start
    assert 0.2 * motion[1] < moved[1] < 0.41 * motion[1]
    frames(robot, 15)
    assert np.array(robot.anchors["gripper0"]) - before == pytest.approx(moved[:3], abs=3e-3)
    stopping = threading.Timer(0.2, robot.stop)
    stopping.start()
    with pytest.raises(RobotError, match="was stopped or moved on its way"):
        robot.park()


@simulated
def test_the_camera_sees_the_truth_and_reports_what_disturbs_it(robot: SimulatedRobot) -> None:
    robot.reset()
    defaults = robot.shape_obs_defaults
    detector = ShapeDetector(shapes=defaults["shapes"], segmentation=defaults["segmentation"])
    errors, numbers = [], []
    with robot.source() as source:
        for i in range(40):
            frame = source.read(timeout=10.0)
            assert frame.rgb is not None
            assert frame.number is not None
            assert frame.camera is not None
            shape = detector.detect(
                frame.rgb, frame.depth, frame.camera, stamp=frame.stamp, anchors=dict(robot.anchors)
            ).shapes[0]
            assert shape.ok
            assert shape.points3d is not None
            errors.append(np.linalg.norm(frame.camera.to_base(shape.points3d) - robot.truth(frame.number), axis=1))
            numbers.append(frame.number)
            robot.send(robot.action_spec.physical(0.5 * np.sin(i / 5) * np.array([1, 0.3, 0.5, -1, 0.3, -0.5])), soon())
    assert np.nanmean(errors) < 3e-3  # a flipped or late shape is off by centimetres
    assert np.nanmax(np.nanmean(errors, axis=1)) < 6e-3
    assert (np.diff(numbers) > 0).all()
    with pytest.raises(KeyError, match="no frame 123456789"):
        robot.truth(123456789)
    robot.disturb(black=1.0, seed=3)
    numbers = {frame.number for frame in frames(robot, 5) if not np.any(frame.rgb)}
    assert numbers
    robot.disturb()
    assert numbers <= set(robot.affected["black"])
    with pytest.raises(ValueError, match="shares from 0 to 1"):
        robot.disturb(drop=0.7, black=0.7)
    with pytest.raises(ValueError, match="occluder"):
        robot.disturb(occluder=2.0)


@simulated
def test_it_keeps_to_the_clock(robot: SimulatedRobot) -> None:
    got = frames(robot, 30)
    stamps = np.array([frame.stamp for frame in got])
    numbers = np.array([frame.number for frame in got])
    # Stamps are this machine's clock, and pictures lie whole periods apart, however busy the machine is.
    periods = np.diff(stamps) * 30
    assert periods == pytest.approx(np.maximum(1, np.rint(periods)), abs=0.5)
    assert numbers[-1] - numbers[0] <= 30 * (stamps[-1] - stamps[0]) + 2
    assert 0 < robot.pace < 33
    assert all(abs(frame.received - frame.stamp) < 5 for frame in got if frame.received and frame.stamp)


@simulated
def test_the_death_of_the_simulation_is_an_error_and_connect_restarts_the_same(
    started: tuple[SimulatedRobot, FirstStart],
) -> None:
    robot, first = started
    robot.reset()
    assert not np.allclose(robot.state(), first.state)
    (child,) = (process for process in multiprocessing.active_children() if process.name == "simulated robot")
    assert child.pid is not None
    os.kill(child.pid, signal.SIGTERM)
    child.join(20)
    with pytest.raises(RobotError, match=r"has ended \(exit code -15.*disconnect, and connect"):
        robot.send(np.zeros(6), soon())
    with pytest.raises(RobotError):
        robot.reset()
    robot.stop()
    assert robot.state().shape == (6,)
    robot.connect()
    robot.reset()
    assert robot.state() == pytest.approx(first.state)
    assert robot.goal == pytest.approx(first.goal)
    assert robot.goal.shape == (20, 3)
    assert robot.goal_layout == {"kind": "centerline"}


@simulated
def test_nothing_is_left_of_it_in_the_end(robot: SimulatedRobot) -> None:
    robot.disconnect()
    robot.disconnect()
    assert not [process for process in multiprocessing.active_children() if process.name == "simulated robot"]
    assert not [thread for thread in threading.enumerate() if thread.name == "simulated robot"]
    robot.stop()
    for call in (robot.reset, robot.park, lambda: robot.send(np.zeros(6), soon()), robot.disturb):
        with pytest.raises(RobotError, match="not connected"):
            call()


@simulated
def test_arguments_that_make_no_sense_are_refused() -> None:
    with pytest.raises(ValueError, match="fps"):
        SimulatedRobot(fps=0)
    with pytest.raises(ValueError, match="ramp"):
        SimulatedRobot(ramp=-1.0)
    with pytest.raises(ValueError, match="is not a simulated environment"):
        SimulatedRobot("CartPole-v1")
