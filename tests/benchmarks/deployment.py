"""The deployment loop without hardware: its points and times, and how soon the robot stops when its process ends.

The arm of the second part takes velocities with a time to live and ends each motion by itself, as the controller of a
real robot does. Its motions are written down outside of the process that is ended.
"""

from __future__ import annotations

import hashlib
import math
import multiprocessing
import os
import random
import signal
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from itertools import count, pairwise, product, repeat
from multiprocessing.connection import Connection
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

import numpy as np
from scipy.interpolate import CubicSpline

from shape_obs.deploy import Interrupted, Limits, RunLog, Sway, deploy
from shape_obs.geometry.polyline import arc_length
from shape_obs.robot import ActionSpec
from shape_obs.utils.timing import CLOCK
from shape_obs.wrappers import ShapeObservation
from shape_obs_envs.robots import NullRobot
from tests.benchmarks.claim import Claim, Effort, Limit
from tests.benchmarks.scores import SLIP, simulator_score
from tests.benchmarks.tables import Row, mean, of, percent, total, worst

FAULTS: Final = {"drop": 0.05, "delay": 0.05, "freeze": 0.05, "black": 0.05, "occluder": 0.15}
SIGNALS: Final = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")
STATES: Final = ("idle", "moving", "send", "read", "log", "C")
FAILURES: Final = ("exception", "closed stdout")  # faults that end a run without a signal
MAX_AGE: Final = 0.2  # seconds, of an image in a deployment that is killed
_RATE: Final = 30.0  # hertz, of the loop and the camera
_WRONG: Final = 15.0  # millimetres
_BLOCKED: Final = 3.0  # duration of a blocked call in seconds, much longer than any limit
_LONG: Final = 10.0  # seconds, longer than any measurement, so that the arm's own limit has no effect
_START: Final = 60.0  # seconds


def run(
    seconds: float, faults: Mapping[str, float] | None = None, *, seed: int = 0, renderer: str = "auto"
) -> tuple[Any, list[Row], Any]:
    """Run the loop with a simulated robot in front of a software D455, in real time.

    Args:
        seconds: Duration.
        faults: Arguments of ``SimulatedRobot.disturb``; None for a clean run.
        seed: Seed of the scene and of the faults.
        renderer: The simulator's renderer.

    Returns:
        The loop's report; a row for each action; and the robot. ``stale``: whether the action is on a frame that was
        used before, frozen or black, or on a shape that was not found. Otherwise ``mm``: the mean error of the measured
        points, ``slipped``: whether one of them is more than half a gap from its position, and ``wrong``: whether one
        slipped or ``mm`` is above 15.
    """
    import gymnasium as gym

    from shape_obs_envs.robots import SimulatedRobot

    robot, rows, used = SimulatedRobot(seed=seed, renderer=renderer, fps=_RATE), list[Row](), set[int]()

    def step(moment: Any) -> None:
        if moment.step == 0 and faults is not None:
            robot.disturb(**faults, seed=seed)
        if moment.judgement.move != "act":
            return
        frame, shape, affected = moment.frame, moment.detection.shapes[0], robot.affected
        spoilt = used.union(*(affected.get(kind, ()) for kind in ("drop", "freeze", "black")))
        if frame is None or frame.number in spoilt or shape.age > 0 or not shape.ok:
            rows.append(Row(stale=True, mm=np.nan, slipped=False, wrong=False))
            return
        used.add(frame.number)
        along = arc_length(points := np.ascontiguousarray(robot.truth(frame.number), np.float64))
        curve = CubicSpline(along, points)
        truth = SimpleNamespace(truth=lambda n: np.asarray(curve(np.linspace(0, along[-1], n))))
        found = simulator_score(frame.camera.to_base(shape.points3d), shape.valid, shape.layout, truth)
        mm, slipped = 1e3 * float(found.errors[shape.valid].mean()), found.slip > SLIP or found.flipped
        rows.append(Row(stale=False, mm=mm, slipped=slipped, wrong=slipped or mm > _WRONG))

    env = gym.make("shape_obs_envs:ShapeObs/D455-v0", source="robot", robot=robot, rate=_RATE, disable_env_checker=True)
    # A hand may stay for a second, after which the run has to continue.
    report = deploy(ShapeObservation(env), Sway(share=0.25), Limits(hold=5.0), seconds=seconds, on_step=step)
    return report, rows, robot


def loop(scene: tuple[str, float, int, str]) -> Row:
    """Run the loop clean or with faults, and return its counts, errors, and 95th percentiles of its sections."""
    name, seconds, seed, renderer = scene
    report, rows, _ = run(seconds, FAULTS if name == "faulty" else None, seed=seed, renderer=renderer)
    found = {"steps": report.steps, "held": report.held, "overruns [%]": 100 * report.overruns / report.steps}
    found |= {field: sum(row[field] for row in rows) for field in ("slipped", "wrong", "stale")}
    times = {f"{section}, p95 [ms]": time.p95 for section, time in report.sections.items()}
    return Row(found, run=name, **{"mean [mm]": mean(row.mm for row in rows)}, **times)


class Arm(NullRobot):
    """Write down each motion of one coordinate, its time and its end; a stop is a motion that has ended.

    Args:
        motions: The file; a line reaches it at once, also if the process is killed.

    Attributes:
        acknowledge: Seconds for which ``send`` waits, blocked in C, for an answer that never comes.
    """

    def __init__(self, motions: Path) -> None:
        super().__init__(spec=ActionSpec(("x",), ("m",), (0.05,), (-10.0,), (10.0,), mode="velocity"))
        self._motions = os.open(motions, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
        self.acknowledge = 0.0

    def send(self, action: Any, until: float) -> None:
        """Start a motion that the arm ends by itself."""
        self._write(until)
        time.sleep(self.acknowledge)

    def stop(self) -> None:
        """Stop at once."""
        self._write(0.0)

    def _write(self, until: float) -> None:
        os.write(self._motions, f"{time.monotonic()} {until}\n".encode())


class SlowLog(RunLog):
    """A log on a disk that stalls with every step."""

    def _write_step(self, record: Mapping[str, Any]) -> None:
        time.sleep(0.2)
        super()._write_step(record)


def run_cell(state: str, max_age: float, folder: Path, parent: Connection, output: Connection) -> None:
    """Deploy in a child process, from a state on which ``parent`` receives ``"ready"``, until something ends it.

    Any answer of ``parent`` makes the controller raise. ``output`` replaces stdout, where each step prints a line.
    ``parent`` also receives the time at which the process itself fails.
    """
    sys.path.append(str(Path(__file__).parents[1] / "support"))
    from fake_cell import ROPE, make_env, rope_camera

    for name in SIGNALS:  # a job in the background inherits that they are ignored
        signal.signal(getattr(signal, name), signal.SIG_DFL)
    os.dup2(output.fileno(), 1)
    output.close()
    arm, camera, steps = Arm(folder / "motions"), rope_camera(hertz=60.0, clock=CLOCK), count(1)

    def act(observation: Any) -> Any:
        """Return full speed, and bring the deployment into the state at the fifth step."""
        step = next(steps)
        if step == 5:
            camera.dark = state == "idle"
            if state == "read":
                camera.stall()
            arm.acknowledge = _BLOCKED if state == "send" else 0.0
            parent.send("ready")
        if step == 6 and state == "C":  # C code that lets other threads run, and no signal ends it
            hashlib.pbkdf2_hmac("sha256", b"", b"", 10_000_000)
        if step == 6 and state == "C with the lock":  # no other thread runs, and no signal handler
            sum(repeat(1, 500_000_000))
        if parent.poll():
            parent.send(time.monotonic())
            raise ZeroDivisionError("a controller's mistake")
        return np.ones(1)

    def on_step(moment: Any) -> None:
        try:
            print(moment.judgement, flush=True)
        except BrokenPipeError:
            parent.send(time.monotonic())
            raise

    env = ShapeObservation(make_env(camera, arm, rate=30.0, timeout=_BLOCKED), **ROPE)
    limits = Limits(hold=60.0, max_age=max_age, watchdog=30.0)
    log = (SlowLog if state == "log" else RunLog)(folder / "run", {})
    try:
        deploy(env, SimpleNamespace(act=act), limits, log=log, on_step=on_step)
    except Interrupted as interrupted:
        sys.exit(128 + interrupted.signum)
    except (ZeroDivisionError, BrokenPipeError):
        sys.exit(1)


def stop(fault: str, state: str, *, wait: float = 0.15, max_age: float = _LONG) -> Row:
    """Run a deployment, cause a fault ``wait`` seconds after a state is reached, and measure when the arm stands still.

    The fault is the name of a signal, or one of ``FAILURES``. The arm stops by itself ``max_age`` seconds after the
    exposure of the last image.

    Returns:
        ``seconds`` until the arm stood still; whether it ``moved_again``; the exit ``code``; whether there is a
        ``report``.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__, "shape_obs.wrappers", "shape_obs_envs", "gymnasium"])
    here, there = context.Pipe()
    reading, writing = context.Pipe(duplex=False)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        child = context.Process(target=run_cell, args=(state, max_age, folder, there, writing))
        child.start()
        there.close()
        writing.close()
        try:
            if not here.poll(_START):
                raise TimeoutError(f"the deployment did not come into the state {state!r} within {_START:g} s")
            here.recv()
            time.sleep(wait)
            begin = time.monotonic()
            if fault == "exception":
                here.send("fail")
            elif fault == "closed stdout":
                reading.close()
            else:
                assert child.pid is not None
                os.kill(child.pid, getattr(signal, fault))
            child.join(_START)
            if fault in FAILURES and here.poll():
                begin = here.recv()
            report = (folder / "run" / "report.json").exists()
            lines = (folder / "motions").read_text().splitlines()
        finally:
            child.kill()
            child.join()
            here.close()
            reading.close()
    seconds, moved_again = _after([(float(at), float(until)) for at, until in map(str.split, lines)], begin)
    return Row(fault=fault, seconds=seconds, report=report, code=child.exitcode, moved_again=moved_again)


def _after(motions: list[tuple[float, float]], begin: float) -> tuple[float, bool]:
    """Return the seconds from a moment until the arm stood still for good, and whether it moved again in between."""
    still, moved_again = begin, False
    for (at, until), (following, _) in pairwise([*motions, (math.inf, 0.0)]):
        end = min(until, following)
        if end > max(at, begin):
            moved_again |= at > still
            still = end
    return still - begin, moved_again


def faults(effort: Effort) -> Iterator[dict[str, Any]]:
    """Return every signal in every state, every failure where it can happen, kills, and a lock that C code holds."""
    chance = random.Random(effort.seed)
    pairs = [*product(SIGNALS, STATES), *product(FAILURES, ("moving", "log"))]
    for (fault, state), _ in product(pairs, range(effort.count(3))):
        yield {"fault": fault, "state": state, "wait": chance.uniform(0.1, 0.2)}
    for _ in range(effort.count(100)):
        yield {"fault": "SIGKILL", "state": "moving", "wait": chance.uniform(0.0, 0.5), "max_age": MAX_AGE}
    for _ in range(effort.count(5)):
        yield {"fault": "SIGTERM", "state": "C with the lock", "max_age": MAX_AGE}


def stopped(scene: dict[str, Any]) -> Row:
    """Stop a deployment; ``in_order``: a signal ends it with a report and exit code 128 + n."""
    row = stop(**scene)
    in_order = row.fault not in SIGNALS or (row.report and row.code == 128 + getattr(signal, row.fault))
    locked = scene["state"] == "C with the lock"
    return Row(row, fault="SIGTERM, lock held" if locked else row.fault, ms=1e3 * row.seconds, disorder=not in_order)


_ALIVE: Final = {"fault": (*SIGNALS, *FAILURES)}
CLAIMS: Final = (
    Claim(
        "deployment.loop", "A minute of the loop at 30 Hz, clean, and with bad frames and a hand.",
        lambda effort: ((name, 60 * effort.share, effort.seed, effort.renderer) for name in ("clean", "faulty")), loop,
        limits=(
            Limit("overruns [%]", at_most=1, unit="%", where={"run": "clean"}, sampled=10),
            Limit("own, p95 [ms]", at_most=25, unit="ms", where={"run": "clean"}),
            Limit("held", at_most=0, where={"run": "clean"}), Limit("mean [mm]", at_most=5, unit="mm"),
            *(Limit(column, at_most=0) for column in ("slipped", "wrong", "stale")),
        ),
        alone=True, needs=("mujoco", "pyrealsense2"),
    ),
    Claim(
        "deployment.stops", "Time until the robot stands still when its process is ended, fails or is killed.",
        faults, stopped, ("fault",),
        {"runs": len, "longest [ms]": of(worst, "ms"), "moved again": total("moved_again"),
         "without report or code": total("disorder"), "moved again [%]": percent("moved_again")},
        limits=(
            Limit("longest [ms]", at_most=50, unit="ms", where=_ALIVE),
            Limit("longest [ms]", at_most=1e3 * MAX_AGE, unit="ms", where={"fault": ("SIGKILL", "SIGTERM, lock held")}),
            Limit("moved again", at_most=0), Limit("without report or code", at_most=0, where={"fault": SIGNALS}),
        ),
        alone=True,
    ),
)  # fmt: skip
