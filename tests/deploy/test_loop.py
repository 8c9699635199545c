"""The deployment loop: what is acted on, what is withheld, and how a run ends."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fake_cell import PATIENT, ROPE, Always, FakeRobot, cell, make_env

from shape_obs import ShapeGoal, ShapeObservation
from shape_obs.deploy import DryRobot, Gate, Limits, Script, Still, Sway, deploy
from shape_obs.robot import ActionSpec
from shape_obs.utils.timing import CLOCK


def test_a_run_moves_the_robot_and_ends_by_stopping_parking_and_disconnecting():
    env, robot, _ = cell()
    report = deploy(env, Always(), PATIENT, steps=5)
    assert (report.steps, report.acted, report.held, report.failed) == (5, 5, 0, False)
    assert report.ended == "time limit reached"
    assert robot.command == pytest.approx([0.05, 0.0])
    assert robot.calls.count("send") == 5
    assert robot.calls[-4:] == ["stop", "park", "stop", "disconnect"]
    assert np.diff(robot.when("send")) == pytest.approx(0.02), "50 steps per second"
    assert deploy(cell()[0], Always(), PATIENT, seconds=0.19).steps == 10


def test_the_real_clock_gives_the_rate_and_the_sections_of_a_step():
    env, *_ = cell(FakeRobot(clock=CLOCK))
    report = deploy(env, Always(), PATIENT, steps=10)
    assert 0.19 <= report.seconds < 5
    sections = report.sections
    assert set(sections) == {"source", "detect", "between", "act", "send", "own", "age"}
    assert sections["own"].most >= sections["detect"].median > 0
    assert all(section.median <= section.p95 <= section.most for section in sections.values())


@pytest.mark.parametrize(
    ("info", "cause"),
    [
        ({}, "shape lost"),  # nothing is known
        ({"shape/ok": True}, "shape lost"),  # found, but when?
        ({"shape/ok": True, "shape/age": 0.1}, "shape lost"),
        ({"shape/ok": False, "shape/age": 0.0}, "shape lost"),
        ({"shape/ok": True, "shape/age": 0.0, "shape/rope/valid_fraction": 0.4}, "points missing"),
        ({"shape/ok": True, "shape/age": 0.0, "exposed": 9.7}, "image old"),
        ({"shape/ok": True, "shape/age": 0.0, "exposed": np.nan}, "image old"),
        ({"shape/ok": True, "shape/age": 0.0, "exposed": 9.9, "shape/rope/valid_fraction": 0.6}, ""),
    ],
)
def test_the_gate_lets_only_through_what_is_known_to_be_good(info, cause):
    gate = Gate(Limits(hold=0.5, min_valid=0.5, max_age=0.2))
    judgement = gate.judge(info, 10.0)
    assert (judgement.move, judgement.cause) == ("hold" if cause else "act", cause)
    if cause:
        assert gate.judge(info, 10.4).move == "hold"
        assert gate.judge(info, 10.6).move == "stop"
        gate.judge({"shape/ok": True, "shape/age": 0.0}, 10.7)
        assert gate.judge(info, 10.8).move == "hold"  # the next wait begins


@pytest.mark.parametrize("back", [False, True])
def test_nothing_is_done_on_a_lost_shape_and_the_run_ends_when_it_stays_lost(back):
    env, robot, camera = cell()
    moves = []

    def on_step(step):
        moves.append(step.judgement.move)
        camera.dark = 3 <= step.step < (8 if back else 99)

    report = deploy(env, Always(), replace(PATIENT, hold=0.15), steps=20, on_step=on_step)
    assert moves[:5] == ["act"] * 5  # step 4 decided on the last good image
    assert moves[5] == "hold"
    assert report.reasons == {"shape lost": report.held}
    assert robot.calls.count("send") == report.acted == moves.count("act")
    if back:
        assert (report.failed, moves[-1]) == (False, "act")
    else:
        assert report.failed
        assert "no shape in the present frame" in report.ended
        assert report.held == 8  # 0.15 s at 50 Hz


def test_images_that_come_late_are_not_acted_on():
    env, _, camera = cell()
    report = deploy(env, Always({3: lambda: setattr(camera, "delay", 0.3)}), Limits(hold=0.1, max_age=0.1), steps=100)
    assert report.failed
    assert "ms old" in report.ended
    assert report.acted == 4


@pytest.mark.parametrize("slow", ["controller", "robot"])
def test_an_action_that_took_too_long_is_not_sent_counts_as_held_and_the_controller_is_informed(slow):
    env, robot, _ = cell()
    withheld = []

    def ponder():
        if slow == "controller":
            robot.clock.sleep(0.7)
        else:
            robot.slow["state"] = 0.7

    controller: Any = Always({2: ponder})
    controller.withheld = lambda: withheld.append(controller._step)
    report = deploy(env, controller, Limits(max_age=0.5), steps=6)
    assert (report.acted, report.held, report.reasons) == (5, 1, {"image old": 1})
    assert robot.calls.count("send") == 5
    assert withheld == [2]


@pytest.mark.parametrize("fault", ["stalls", "is unplugged", "robot", "driver"])
def test_a_camera_or_a_robot_that_fails_ends_the_run_and_the_robot_is_stopped_and_parked(fault):
    env, robot, camera = cell(FakeRobot(foreign=fault == "driver"))
    act, ended = {
        "stalls": (camera.stall, "no frame in"),
        "is unplugged": (camera.unplug, "it was unplugged"),
        "robot": (lambda: robot.broken.add("send"), "the robot is in an emergency stop"),
        "driver": (lambda: robot.broken.add("send"), "robot.send: RuntimeError: send: the robot is in an emergency"),
    }[fault]
    report = deploy(env, Always({2: act}), steps=100)
    assert report.failed
    assert ended in report.ended
    assert robot.calls[-4:] == ["stop", "park", "stop", "disconnect"]


def test_a_controller_that_raises_leaves_the_robot_stopped_and_parked():
    env, robot, _ = cell()
    with pytest.raises(ZeroDivisionError):
        deploy(env, Always({2: lambda: 1 / 0}), steps=100)
    assert robot.calls.index("park") > robot.calls.index("stop")
    assert robot.calls[-1] == "disconnect"


@pytest.mark.parametrize("action", [[np.nan, 0.0], [1.0], [[1.0, 0.0]]])
def test_an_action_that_is_none_is_refused(action):
    env, robot, _ = cell()
    with pytest.raises(ValueError, match=r"controller Always: expected 2 finite numbers for \['x0', 'x1'\]"):
        deploy(env, Always({0: lambda: action}), steps=3)
    assert robot.calls.count("send") == 0


@pytest.mark.parametrize("where", ["controller", "robot"])
def test_the_watchdog_stops_the_robot_while_the_loop_hangs_and_nothing_is_sent_afterwards(where):
    env, robot, _ = cell()
    before = []

    def hang():
        before.append(robot.clock.now())
        if where == "controller":
            robot.clock.sleep(0.6)
        else:
            robot.slow["state"] = 0.6

    report = deploy(env, Always({2: hang}), Limits(watchdog=0.2, max_age=9), steps=100)
    assert robot.calls.count("send") == 2
    assert robot.when("stop")[0] == pytest.approx(before[0] + 0.2)
    assert max(robot.when("send")) < robot.when("stop")[0]
    assert report.failed
    assert "watchdog" in report.ended


def test_the_watchdog_leaves_a_loop_alone_that_goes_round():
    env, *_ = cell()
    report = deploy(env, Always(), Limits(watchdog=0.1, max_age=9.0), steps=40)
    assert (report.ended, report.acted) == ("time limit reached", 40)


@pytest.mark.parametrize("mode", ["velocity", "displacement"])
def test_a_stalled_camera_means_no_motion_after_max_age(mode):
    """The limit of the run replaces that of the environment."""
    env, robot, camera = cell(FakeRobot(mode=mode, low=[-9, -9], high=[9, 9]), timeout=1.0, max_age=5.0)
    exposed = []

    def stall():
        exposed.append(env.unwrapped.frame.received)
        camera.stall()

    report = deploy(env, Always({5: stall}), Limits(max_age=0.2), steps=50)
    assert "no frame in" in report.ended
    assert robot.when("stop")[0] == pytest.approx(exposed[0] + 0.2)
    assert report.expired == 1


def test_steps_that_are_longer_than_a_motion_may_be_are_warned_of():
    env, *_ = cell(rate=4.0)
    with pytest.warns(UserWarning, match=r"a step takes 0.25 s and a motion ends 0.2 s after the exposure"):
        report = deploy(env, Always(), steps=2)
    assert report.expired == 2


def test_what_cannot_be_deployed_is_refused_before_anything_moves():
    env, robot, _ = cell()

    class Joints(Always):
        action_spec = ActionSpec(("x0", "x1"), ("rad", "rad"), (0.01, 0.01), (-1, -1), (1, 1), "velocity", "joint")

    with pytest.raises(ValueError, match=r"controller Joints acts in other coordinates.*units.*mode.*frame"):
        deploy(env, Joints(), steps=3)
    with pytest.raises(TypeError, match="act"):
        deploy(env, object(), steps=3)
    assert "send" not in robot.calls
    with pytest.raises(ValueError, match="wrap it in ShapeObservation"):
        deploy(env.env, Still(), steps=1)
    with pytest.raises(ValueError, match="needs an environment with a robot"):
        deploy(ShapeObservation(make_env(), **ROPE), Still(), steps=1)


def test_a_dry_run_moves_nothing():
    robot = FakeRobot()
    dry: Any = DryRobot(robot)
    camera = cell(robot)[2]
    report = deploy(cell(dry, camera)[0], Always(), PATIENT, steps=4)
    assert report.acted == dry.sent == 4
    assert robot.command == pytest.approx([0, 0])
    assert not {"send", "reset", "park"} & set(robot.calls)


def test_a_goal_is_reached_and_ends_the_run():
    env, robot, _ = cell()
    env.reset()
    goal = env.detection["centerline"].points3d.astype(float)
    env = ShapeGoal(env, goal=env.get_wrapper_attr("camera_model").to_base(goal) + (0.05, 0, 0))

    class Push:
        def act(self, observation):
            away = (observation["desired_goal"] - observation["achieved_goal"]).reshape(-1, 3).mean(axis=0)
            return np.clip([away[0] / 0.01, 0.0], -1, 1)

    report = deploy(env, Push(), steps=40, until_reached=3)
    assert report.success
    assert "reached in 3 consecutive frames" in report.ended
    assert robot.command[0] == pytest.approx(0.05, abs=0.01)


def test_sway_comes_back_and_scripts_are_checked(tmp_path):
    spec = FakeRobot(4).action_spec
    sway = Sway(share=0.5, period=30)
    sway.bind(spec)
    moves = np.array([sway.act(None) for _ in range(30)])
    assert np.abs(moves.sum(axis=0)).max() < 1e-5
    assert 0.4 < np.abs(moves).max() <= 0.5
    np.savetxt(tmp_path / "a.csv", np.full((3, 4), 0.25), delimiter=",")
    script = Script(tmp_path / "a.csv")
    script.bind(spec)
    assert [script.act(None)[0] for _ in range(4)] == [0.25, 0.25, 0.25, 0.0]
    with pytest.raises(ValueError, match="its rows have 4 numbers, the robot takes 2"):
        script.bind(FakeRobot(2).action_spec)
    with pytest.raises(FileNotFoundError, match="no such file of actions"):
        Script(tmp_path / "b.csv")
