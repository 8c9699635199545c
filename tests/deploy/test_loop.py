"""The deployment loop: actions, withheld actions, and the end of a run."""

from __future__ import annotations

import time
from dataclasses import replace
from urllib.request import urlopen

import gymnasium as gym
import numpy as np
import pytest
from cell_parts import HEIGHT, ROPE, WIDTH, ListRobot, RopeSource
from deploy_parts import PATIENT, Always, cell

from shape_obs import ShapeGoal, ShapeObservation
from shape_obs.deploy import DryRobot, Gate, Limits, Script, Still, Sway, deploy
from shape_obs.robot import ActionSpec


def test_a_run_moves_the_robot_and_ends_by_stopping_parking_and_disconnecting():
    env, robot, _ = cell()
    report = deploy(env, Always(), PATIENT, steps=5)
    assert report.steps == report.acted == 5
    assert report.held == 0
    assert not report.failed
    assert report.ended == "time limit reached"
    assert robot.command == pytest.approx([0.05, 0.0])
    assert robot.calls.count("send") == 5
    assert robot.calls[-4:] == ["stop", "park", "stop", "disconnect"]


def test_sections_add_up_to_what_lies_between_image_and_action():
    env, *_ = cell()
    sections = deploy(env, Always(), steps=10).sections
    assert set(sections) == {"source", "detect", "between", "act", "send", "own", "age"}
    assert sections["own"].most >= sections["detect"].median
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


def test_nothing_is_done_on_a_lost_shape_and_the_run_ends_when_it_stays_lost():
    env, robot, source = cell()
    begun: list[float] = []

    def darken():
        source.dark = True
        return np.array([1.0, 0.0])

    report = deploy(
        env,
        Always({3: darken}),
        replace(PATIENT, hold=0.15),
        steps=100,
        on_step=lambda step: begun.append(time.monotonic()),
    )
    assert report.failed
    assert "no shape in the present frame" in report.ended
    assert report.acted == 4  # the action of step 3 was decided on a good image
    assert report.reasons == {"shape lost": report.held}
    assert begun[-1] - begun[3] >= 0.15 - env.unwrapped.rate.dt
    assert report.held <= 9  # 0.15 s at 50 Hz, and the steps around them
    assert robot.calls.count("send") == 4


def test_it_goes_on_when_the_shape_comes_back_in_time():
    env, _, source = cell()

    def darken():
        source.dark = True
        return np.zeros(2)

    shown = []

    def on_step(moment):
        shown.append(moment.judgement.move)
        if moment.step == 8:
            source.dark = False

    report = deploy(env, Always({3: darken}), replace(PATIENT, hold=9.0), steps=20, on_step=on_step)
    assert not report.failed
    assert "hold" in shown
    assert shown[-1] == "act"
    assert shown.count("hold") == report.held


def test_images_that_come_late_are_not_acted_on():
    env, _, source = cell()

    def late():
        source.delay = 0.3
        return np.zeros(2)

    report = deploy(env, Always({3: late}), Limits(hold=0.1, max_age=0.1), steps=100)
    assert report.failed
    assert "ms old" in report.ended
    assert report.acted == 4


def test_an_action_that_took_too_long_is_not_sent():
    env, robot, _ = cell()

    def ponder():
        time.sleep(0.7)
        return np.array([1.0, 0.0])

    report = deploy(env, Always({2: ponder}), Limits(max_age=0.5), steps=6)
    assert (report.acted, report.reasons) == (5, {"image old": 1})
    assert robot.calls.count("send") == 5


def test_a_camera_that_fails_ends_the_run_and_stops_the_robot():
    env, robot, source = cell()

    def unplug():
        source.gone = True
        return np.zeros(2)

    report = deploy(env, Always({2: unplug}), steps=100)
    assert report.failed
    assert "no frame in" in report.ended
    assert robot.calls[-1] == "disconnect"
    assert "park" in robot.calls


def test_a_robot_that_fails_ends_the_run():
    env, robot, _ = cell()

    def fail():
        robot.fails = True
        return np.zeros(2)

    report = deploy(env, Always({2: fail}), steps=100)
    assert report.failed
    assert report.ended == "the robot is in an emergency stop"


def test_a_controller_that_raises_leaves_the_robot_stopped_and_parked():
    env, robot, _ = cell()

    def fail():
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        deploy(env, Always({2: fail}), steps=100)
    assert robot.calls.index("park") > robot.calls.index("stop")
    assert robot.calls[-1] == "disconnect"


@pytest.mark.parametrize("action", [[np.nan, 0.0], [1.0], [[1.0, 0.0]]])
def test_an_action_that_is_none_is_refused(action):
    env, robot, _ = cell()
    with pytest.raises(ValueError, match=r"controller Always: expected 2 finite numbers for \['x0', 'x1'\]"):
        deploy(env, Always({0: lambda: action}), steps=3)
    assert robot.calls.count("send") == 0


def test_the_watchdog_stops_the_robot_while_the_controller_hangs():
    env, robot, _ = cell()
    seen = []

    def hang():
        time.sleep(0.6)
        seen.append(robot.calls.count("stop"))
        return np.zeros(2)

    report = deploy(env, Always({2: hang}), Limits(watchdog=0.2, max_age=9), steps=100)
    assert seen == [1]
    assert robot.calls.count("send") == 2  # what the controller said in the end was not sent
    assert report.failed
    assert "watchdog" in report.ended


def test_steps_that_are_longer_than_a_motion_may_be_are_warned_of():
    env, *_ = cell(rate=4.0)
    with pytest.warns(UserWarning, match=r"a step takes 0.25 s and a motion ends 0.2 s after the exposure"):
        report = deploy(env, Always(), steps=2)
    assert report.expired == 2


def test_the_watchdog_leaves_a_loop_alone_that_goes_round():
    env, *_ = cell()
    report = deploy(env, Always(), Limits(watchdog=0.5, max_age=9.0), steps=40)  # 0.8 s
    assert (report.ended, report.acted) == ("time limit reached", 40)


def test_other_coordinates_are_refused_before_anything_moves():
    env, robot, _ = cell()

    class Joints(Always):
        action_spec = ActionSpec(("x0", "x1"), ("rad", "rad"), (0.01, 0.01), (-1, -1), (1, 1), "velocity", "joint")

    with pytest.raises(ValueError, match=r"controller Joints acts in other coordinates.*units.*mode.*frame"):
        deploy(env, Joints(), steps=3)
    assert "send" not in robot.calls
    with pytest.raises(TypeError, match="act"):
        deploy(env, object(), steps=3)


def test_what_cannot_be_deployed_is_refused():
    env, *_ = cell()
    with pytest.raises(ValueError, match="wrap it in ShapeObservation"):
        deploy(env.env, Still(), steps=1)
    bare = gym.make("shape_obs_envs:ShapeObs/D455-v0", source=RopeSource(), size=[WIDTH, HEIGHT])
    with pytest.raises(ValueError, match="needs an environment with a robot"):
        deploy(ShapeObservation(bare, **ROPE), Still(), steps=1)


def test_a_dry_run_moves_nothing():
    robot = ListRobot()
    dry = DryRobot(robot)
    env, *_ = cell(dry, RopeSource(robot))
    report = deploy(env, Always(), PATIENT, steps=4)
    assert report.acted == dry.sent == 4
    assert robot.command == pytest.approx([0, 0])
    assert not {"send", "reset", "park"} & set(robot.calls)


def test_a_goal_is_reached_and_ends_the_run():
    env, robot, _ = cell()
    env.reset()
    goal = env.detection["centerline"].points3d.astype(float)
    goal = env.get_wrapper_attr("camera_model").to_base(goal) + (0.05, 0, 0)
    env = ShapeGoal(env, goal=goal)

    class Push(Always):
        def act(self, observation):
            away = (observation["desired_goal"] - observation["achieved_goal"]).reshape(-1, 3).mean(axis=0)
            return np.clip([away[0] / 0.01, 0.0], -1, 1)

    report = deploy(env, Push(), steps=40, until_reached=3)
    assert report.success
    assert "reached in 3 consecutive frames" in report.ended
    assert robot.command[0] == pytest.approx(0.05, abs=0.01)


def test_sway_comes_back_and_scripts_are_checked(tmp_path):
    spec = ListRobot(4).action_spec
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
        script.bind(ListRobot(2).action_spec)
    with pytest.raises(FileNotFoundError, match="no such file of actions"):
        Script(tmp_path / "b.csv")


def test_the_live_view_is_a_page_and_does_not_hold_the_loop_up(capsys):
    pytest.importorskip("viser")
    from shape_obs.deploy.view import LiveView

    env, *_ = cell()
    view = LiveView(0, env)
    try:
        with urlopen(view.url, timeout=10) as page:
            assert page.status == 200
        report = deploy(env, Still(), steps=10, on_step=view.show)
    finally:
        view.close()
    assert report.steps == 10
    assert capsys.readouterr().out == ""
