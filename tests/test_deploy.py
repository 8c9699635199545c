"""The deployment loop: what is acted on, what is not, and how it ends."""

from __future__ import annotations

import json
import pickle
import signal
import threading
import time
from typing import Any
from urllib.request import urlopen

import gymnasium as gym
import numpy as np
import pytest
from cell_parts import HEIGHT, ROPE, WIDTH, ListRobot, RopeSource
from hypothesis import given
from hypothesis import strategies as st

from shape_obs import ShapeGoal, ShapeObservation
from shape_obs.deploy import DryRobot, Gate, Interrupted, Limits, RunLog, Script, Still, Sway, deploy, supervised
from shape_obs.deploy.report import Tally
from shape_obs.robot import ActionSpec


def cell(robot=None, source=None, rate=50.0, **options) -> Any:
    robot = robot or ListRobot()
    source = source or RopeSource(robot)
    env = gym.make(
        "shape_obs_envs:ShapeObs/D455-v0",
        source=source,
        robot=robot,
        rate=rate,
        size=[WIDTH, HEIGHT],
        timeout=0.2,
        disable_env_checker=True,
        **options,
    )
    return ShapeObservation(env, **ROPE), robot, source


class Always:
    """Pushes on; `at` says what to do in a step."""

    def __init__(self, at=None):
        self._at, self._step = at or {}, -1

    def act(self, observation):
        self._step += 1
        if self._step in self._at:
            return self._at[self._step]()
        return np.array([1.0, 0.0])


def test_a_run_moves_the_robot_and_ends_by_stopping_parking_and_disconnecting():
    env, robot, _ = cell()
    report = deploy(env, Always(), steps=5)
    assert report.steps == report.acted == 5
    assert report.held == 0
    assert not report.failed
    assert report.ended == "time limit reached"
    assert robot.told == pytest.approx([0.05, 0.0])
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
    sent = []

    def darken():
        source.dark = True
        sent.append(robot.calls.count("send"))
        return np.array([1.0, 0.0])

    report = deploy(env, Always({3: darken}), Limits(hold=0.15), steps=100)
    assert report.failed
    assert "no shape in the present frame" in report.ended
    assert report.acted == 4  # the action of step 3 was decided on a good image
    assert report.reasons == {"shape lost": report.held}
    assert 5 <= report.held <= 9
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

    report = deploy(env, Always({3: darken}), Limits(hold=1.0), steps=20, on_step=on_step)
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
        time.sleep(0.15)
        return np.array([1.0, 0.0])

    report = deploy(env, Always({2: ponder}), Limits(max_age=0.1), steps=6)
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
    report = deploy(env, Always(), Limits(watchdog=0.5), steps=40)  # 0.8 s
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
    report = deploy(env, Always(), steps=4)
    assert report.acted == dry.sent == 4
    assert robot.told == pytest.approx([0, 0])
    assert not {"send", "reset", "park"} & set(robot.calls)


def test_the_log_has_every_step_and_tells_what_ran(tmp_path):
    env, *_ = cell()
    report = deploy(env, Sway(period=20), steps=6, log=RunLog(tmp_path / "run", {"controller": "Sway"}))
    rows = [json.loads(line) for line in (tmp_path / "run" / "steps.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows] == list(range(6))
    assert all(len(row["shapes"][0]["points3d"]) == 10 for row in rows)
    assert all(row["move"] == "act" and len(row["action"]) == 2 for row in rows)
    assert json.loads((tmp_path / "run" / "run.json").read_text())["controller"] == "Sway"
    assert json.loads((tmp_path / "run" / "report.json").read_text())["steps"] == report.steps
    with pytest.raises(FileExistsError, match="holds a run already"):
        RunLog(tmp_path / "run", {})


def test_steps_of_a_run_that_dies_are_on_disk(tmp_path):
    env, *_ = cell()

    def die():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        deploy(env, Always({4: die}), steps=10, log=RunLog(tmp_path / "run", {}))
    assert len((tmp_path / "run" / "steps.jsonl").read_text().splitlines()) == 4


class StallingLog(RunLog):
    """A log on a disk that stalls."""

    def __init__(self, *args: Any, seconds: float) -> None:
        self.seconds, self.done = seconds, []
        super().__init__(*args)

    def _write(self, name, content):
        time.sleep(self.seconds)
        super()._write(name, content)
        self.done.append((name, time.monotonic()))

    def _write_step(self, record):
        time.sleep(self.seconds)
        super()._write_step(record)


def test_a_disk_that_stalls_delays_neither_the_steps_nor_the_stop(tmp_path):
    env, robot, _ = cell()
    stops: list[float] = []
    stop = robot.stop
    robot.stop = lambda: (stop(), stops.append(time.monotonic()))  # type: ignore[method-assign]
    log = StallingLog(tmp_path / "run", {}, seconds=0.2)
    moments = []
    report = deploy(env, Always(), steps=8, log=log, on_step=lambda moment: moments.append(time.monotonic()))
    assert np.diff(moments).max() < 0.15
    written = dict(log.done)["report.json"]
    assert stops[0] - moments[-1] < 0.15
    assert written - stops[0] > 1.0  # eight steps and the report
    assert json.loads((tmp_path / "run" / "report.json").read_text())["steps"] == report.steps == 8
    assert len((tmp_path / "run" / "steps.jsonl").read_text().splitlines()) == 8


def test_a_log_that_cannot_be_written_ends_the_run_and_stops_the_robot(tmp_path):
    class FullDisk(RunLog):
        def _write_step(self, record):
            raise OSError("no space left on device")

    env, robot, _ = cell()
    with pytest.raises(OSError, match="no space left"):
        deploy(env, Always(), steps=1000, log=FullDisk(tmp_path / "run", {}))
    assert robot.calls[-1] == "disconnect"
    assert "no space left" in json.loads((tmp_path / "run" / "report.json").read_text())["ended"]


def test_a_disk_that_is_hopelessly_behind_ends_the_run(tmp_path, monkeypatch):
    monkeypatch.setattr("shape_obs.deploy.log._WAITING", 3)
    env, *_ = cell()
    with pytest.raises(OSError, match="the disk is 3 steps behind"):
        deploy(env, Always(), steps=100, log=StallingLog(tmp_path / "run", {}, seconds=0.2))


def test_an_exception_is_in_the_report_of_the_log(tmp_path):
    env, *_ = cell()

    def fail():
        raise ZeroDivisionError("a mistake")

    with pytest.raises(ZeroDivisionError):
        deploy(env, Always({2: fail}), steps=10, log=RunLog(tmp_path / "run", {}))
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert (report["ended"], report["failed"], report["steps"]) == ("ZeroDivisionError: a mistake", True, 2)


def raising(name):
    """What a controller does while a signal comes."""

    def act():
        signal.raise_signal(getattr(signal, name))
        return np.zeros(2)

    return act


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT"])
def test_a_signal_stops_parks_reports_and_is_raised(name, tmp_path):
    handler = signal.getsignal(getattr(signal, name))
    env, robot, _ = cell()
    with pytest.raises(Interrupted, match=f"interrupted by {name}") as caught:
        deploy(env, Always({3: raising(name)}), steps=10, log=RunLog(tmp_path / "run", {}))
    assert caught.value.signum == getattr(signal, name)
    assert (caught.value.report.steps, caught.value.report.failed) == (3, False)
    assert json.loads((tmp_path / "run" / "report.json").read_text())["ended"] == f"interrupted by {name}"
    assert robot.calls.index("park") > robot.calls.index("stop")
    assert robot.calls[-1] == "disconnect"
    assert signal.getsignal(getattr(signal, name)) == handler
    assert signal.set_wakeup_fd(-1) == -1
    assert "signals" not in [thread.name for thread in threading.enumerate()]


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
        assert deploy(env, Always({1: raising("SIGHUP")}), steps=4).acted == 4
    except Interrupted:
        pytest.fail("an ignored signal ended the run")
    finally:
        signal.signal(signal.SIGHUP, previous)


def test_outside_the_main_thread_it_runs_without_signals():
    env, *_ = cell()
    reports = []
    thread = threading.Thread(target=lambda: reports.append(deploy(env, Always(), steps=3)))
    thread.start()
    thread.join()
    assert reports[0].acted == 3


def test_what_is_counted_takes_no_more_memory_after_more_steps():
    def tally(steps):
        counted = Tally()
        for step in range(steps):
            counted.reasons["image old"] += 1
            counted.time({"own": 5.0 + step % 7, "age": 0.1 * step})
        return counted

    assert len(pickle.dumps(tally(20_000))) <= len(pickle.dumps(tally(20))) + 100


@given(st.lists(st.floats(-1, 1e5), min_size=1, max_size=200))
def test_sections_are_quantiles(values):
    counted = Tally()
    for value in values:
        counted.time({"own": value})
    section = counted.report(steps=1, seconds=1, overruns=0, expired=0, ended="", failed=False, success=None).sections[
        "own"
    ]
    # One of the values next to the exact quantile, to within half a bin.
    for found, share in ((section.median, 0.5), (section.p95, 0.95)):
        exact = [max(0.0, np.quantile(values, share, method=method)) for method in ("lower", "higher")]
        assert 0.994 * exact[0] - 2e-3 <= found <= 1.006 * exact[1] + 2e-3
    assert section.most == pytest.approx(max(0.0, *values), abs=1e-3)


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
    assert "reached in 3 frames" in report.ended
    assert robot.told[0] == pytest.approx(0.05, abs=0.01)


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
