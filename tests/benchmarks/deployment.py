"""The deployment loop without hardware: its points and times, and how soon the robot stops when its process ends."""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import random
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import product, repeat
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Final, Literal

import cv2
import numpy as np
from scipy.interpolate import CubicSpline

from shape_obs.camera import CameraModel, Intrinsics
from shape_obs.deploy import Interrupted, Limits, RunLog, Sway, deploy
from shape_obs.frame import Frame
from shape_obs.geometry.polyline import arc_length
from shape_obs.source import FrameTimeout, Source, StaleFrame
from tests.benchmarks.claim import Claim, Effort, Limit
from tests.benchmarks.remote_arm import Arm, ArmProcess
from tests.benchmarks.scores import SLIP, simulator_score
from tests.benchmarks.tables import Row, mean, of, percent, total, worst

State = Literal["idle", "moving", "send", "read", "log", "C", "C with the lock"]
FAULTS: Final = {"drop": 0.05, "delay": 0.05, "freeze": 0.05, "black": 0.05, "occluder": 0.15}
SIGNALS: Final = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")
STATES: Final[tuple[State, ...]] = ("idle", "moving", "send", "read", "log", "C")
FAILURES: Final = ("exception", "closed stdout")  # faults that end a run without a signal
MAX_AGE: Final = 0.2  # seconds, of an image in a deployment that is killed
_RATE: Final = 30.0  # hertz, of the loop and the camera
_WRONG: Final = 15.0  # millimetres
_BLOCKED: Final = 3.0  # duration of a blocked call in seconds, much longer than any limit
_LONG: Final = 10.0  # seconds, longer than any measurement, so that the arm's own limit has no effect
_START: Final = 60.0  # seconds
_LENS: Final = Intrinsics(160, 120, 100.0, 100.0, 79.5, 59.5)


class Seen:
    """Compare every frame on which the loop acts with the truth.

    Args:
        robot: The simulated robot, which has the truth.

    Attributes:
        mm: Mean error of the measured points of each frame that led to an action.
        slips: Frames that led to an action with a valid point more than half a gap from its position.
        wrong: Frames that led to an action with a slip, or a mean error of the measured points above 15 mm.
        hidden: Errors of single points that were reported hidden.
        stale: Actions on a frame that was used before, on a frozen one, or on a black one.
    """

    def __init__(self, robot: Any) -> None:
        self.robot, self._numbers = robot, set[int]()
        self.mm, self.hidden = list[float](), list[float]()
        self.slips = self.wrong = self.stale = 0

    def step(self, moment: Any) -> None:
        """Record one step of the loop."""
        frame, affected = moment.frame, self.robot.affected
        if moment.judgement.move != "act":
            return
        shape = moment.detection.shapes[0]
        if frame is None or frame.number in self._numbers or shape.age > 0 or not shape.ok:
            self.stale += 1
            return
        self.stale += any(frame.number in affected.get(kind, ()) for kind in ("drop", "freeze", "black"))
        self._numbers.add(frame.number)
        points, truth = frame.camera.to_base(shape.points3d), _At(self.robot.truth(frame.number))
        found = simulator_score(points, shape.valid, shape.layout, truth)
        mm = 1e3 * float(found.errors[shape.valid].mean())
        self.mm.append(mm)
        self.hidden.extend(1e3 * found.errors[~shape.valid])
        slipped = found.slip > SLIP or found.flipped
        self.slips += slipped
        self.wrong += slipped or mm > _WRONG


class _At:
    """The truth at the time of a frame, with the method ``truth`` of a simulator."""

    def __init__(self, points: Any) -> None:
        along = arc_length(np.ascontiguousarray(points, np.float64))
        self._curve, self._length = CubicSpline(along, points), along[-1]

    def truth(self, n: int) -> Any:
        """Return (n, 3) equidistant points in metres, base frame."""
        return np.asarray(self._curve(np.linspace(0, self._length, n)))


def run(
    seconds: float, faults: Mapping[str, float] | None = None, *, seed: int = 0, renderer: str = "auto"
) -> tuple[Any, Seen]:
    """Run the loop with a simulated robot in front of a software D455, in real time.

    Args:
        seconds: Duration.
        faults: Arguments of ``SimulatedRobot.disturb``; None for a clean run.
        seed: Seed of the scene and of the faults.
        renderer: The simulator's renderer.

    Returns:
        The loop's report and the comparison with the truth.
    """
    import gymnasium as gym

    import shape_obs_envs  # noqa: F401 - registers the ids
    from shape_obs.wrappers import ShapeObservation
    from shape_obs_envs.robots import SimulatedRobot

    robot = SimulatedRobot(seed=seed, renderer=renderer, fps=_RATE)
    seen = Seen(robot)

    def step(moment: Any) -> None:
        if moment.step == 0 and faults is not None:
            robot.disturb(**faults, seed=seed)
        seen.step(moment)

    env = gym.make("ShapeObs/D455-v0", source="robot", robot=robot, rate=_RATE, disable_env_checker=True)
    # A hand may stay for a second, after which the run has to continue.
    report = deploy(ShapeObservation(env), Sway(share=0.25), Limits(hold=5.0), seconds=seconds, on_step=step)
    return report, seen


def loop(scene: tuple[str, float, int, str]) -> Row:
    """Run the loop clean or with faults, and return its counts, errors, and 95th percentiles of its sections."""
    name, seconds, seed, renderer = scene
    report, seen = run(seconds, FAULTS if name == "faulty" else None, seed=seed, renderer=renderer)
    counts = {"slips": seen.slips, "wrong, acted on": seen.wrong, "stale, acted on": seen.stale, "held": report.held}
    shares = {"overruns [%]": 100 * report.overruns / report.steps, "mean [mm]": mean(seen.mm)}
    times = {f"{section}, p95 [ms]": time.p95 for section, time in report.sections.items()}
    return Row(
        {"run": name, "steps": report.steps, **counts, **shares, "hidden, mean [mm]": mean(seen.hidden)}, **times
    )


class DrawnRope(Source):
    """A 60 Hz camera in front of a blue rope; images may be ``dark``, or ``frozen``: no frame arrives."""

    kind, name, live, has_depth = "drawn", "drawn rope", True, True

    def __init__(self) -> None:
        super().__init__()
        self.dark = self.frozen = False
        self._begin = time.monotonic()

    @property
    def intrinsics(self) -> Intrinsics:
        """The lens."""
        return _LENS

    def connect(self) -> None:
        """Do nothing; the camera is always connected."""

    def disconnect(self) -> None:
        """Do nothing."""

    def read(self, timeout: float = 1.0, fresh: bool = False) -> Frame:
        """Wait for the next frame."""
        if self.frozen:
            time.sleep(timeout)
            raise FrameTimeout(f"no frame in {timeout} s")
        number = self._newest() + 1
        time.sleep(max(0.0, self._begin + number / 60 - time.monotonic()))
        return self._frame(number)

    def read_latest(self, max_age: float = 0.1) -> Frame:
        """Return the newest frame."""
        if self.frozen or time.monotonic() - (self._begin + self._newest() / 60) > max_age:
            raise StaleFrame("too old")
        return self._frame(self._newest())

    def _newest(self) -> int:
        return int((time.monotonic() - self._begin) * 60)

    def _frame(self, number: int) -> Frame:
        rgb = np.full((120, 160, 3), 0 if self.dark else 200, np.uint8)
        if not self.dark:
            cv2.line(rgb, (40, 60), (110, 66), (20, 60, 200), 5)
        taken = self._begin + number / 60
        return Frame(rgb, np.full((120, 160), 700, np.uint16), CameraModel(_LENS), taken, taken, number, taken)


class SlowLog(RunLog):
    """A log on a disk that stalls with every step."""

    def _write_step(self, record: Mapping[str, Any]) -> None:
        time.sleep(0.2)
        super()._write_step(record)


class Push:
    """A controller that moves, and brings the deployment into a state at the fifth step."""

    def __init__(self, state: State, arm: Arm, camera: DrawnRope, ready: Any, fail: threading.Event) -> None:
        self._state, self._arm, self._camera, self._ready, self._fail = state, arm, camera, ready, fail
        self._step = 0

    def act(self, observation: Any) -> Any:
        """Return full speed."""
        self._step += 1
        if self._step == 5:
            self._camera.dark, self._camera.frozen = self._state == "idle", self._state == "read"
            if self._state == "send":
                self._arm.acknowledge = _BLOCKED
            self._ready()
        if self._step == 6 and self._state == "C":  # C code that lets other threads run, and no signal ends it
            hashlib.pbkdf2_hmac("sha256", b"", b"", 10_000_000)
        if self._step == 6 and self._state == "C with the lock":  # no other thread runs, and no signal handler
            sum(repeat(1, 500_000_000))
        if self._fail.is_set():
            self._arm.mark()
            raise ZeroDivisionError("a controller's mistake")
        return np.ones(1)


def run_cell(port: int, state: State, max_age: float, folder: str, parent: Connection, output: Connection) -> None:
    """Deploy in a child process, from a state on which ``parent`` receives ``"ready"``, until something ends it.

    Any answer of ``parent`` makes the controller raise. ``output`` replaces stdout, where each step prints a line.
    """
    import gymnasium as gym

    from shape_obs.wrappers import ShapeObservation

    for name in SIGNALS:  # a job in the background inherits that they are ignored
        signal.signal(getattr(signal, name), signal.SIG_DFL)
    os.dup2(output.fileno(), 1)
    output.close()
    arm, camera, fail = Arm(port), DrawnRope(), threading.Event()

    def listen() -> None:
        with suppress(EOFError):  # the measuring process has ended
            parent.recv()
            fail.set()

    def on_step(moment: Any) -> None:
        try:
            print(moment.judgement, flush=True)
        except BrokenPipeError:
            arm.mark()
            raise

    threading.Thread(target=listen, daemon=True).start()
    options: dict[str, Any] = {"size": [160, 120], "timeout": _BLOCKED, "disable_env_checker": True}
    env = gym.make("shape_obs_envs:ShapeObs/D455-v0", source=camera, robot=arm, rate=30.0, **options)
    hsv = {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]}
    env = ShapeObservation(env, shapes=[{"kind": "centerline", "n": 10}], segmentation=hsv)
    log = (SlowLog if state == "log" else RunLog)(Path(folder) / "run", {})
    controller = Push(state, arm, camera, lambda: parent.send("ready"), fail)
    try:
        deploy(env, controller, Limits(hold=60.0, max_age=max_age, watchdog=30.0), log=log, on_step=on_step)
    except Interrupted as interrupted:
        sys.exit(128 + interrupted.signum)
    except (ZeroDivisionError, BrokenPipeError):
        sys.exit(1)


def stop(arm: ArmProcess, fault: str, state: State, *, wait: float = 0.15, max_age: float = _LONG) -> Row:
    """Run a deployment, cause a fault ``wait`` seconds after a state is reached, and measure when the arm stands still.

    The fault is the name of a signal, or one of ``FAILURES``. The arm stops by itself ``max_age`` seconds after the
    exposure of the last image.

    Returns:
        ``seconds`` until the arm stood still; whether it ``moved_again``; the exit ``code``; whether there is a
        ``report``.
    """
    arm.send_message("clear")
    with tempfile.TemporaryDirectory() as folder, _running(arm, state, max_age, folder) as (child, fail, close):
        time.sleep(wait)
        # A failure is recorded by the process in which it happens, a signal here.
        begin = time.monotonic()
        if fault == "exception":
            fail()
        elif fault == "closed stdout":
            close()
        else:
            assert child.pid is not None
            os.kill(child.pid, getattr(signal, fault))
        child.join(_START)
        time.sleep(max_age + 0.1 if fault == "SIGKILL" else 0.0)
        notes = arm.notes()
        begin = next((moment for what, moment in notes if what == "mark"), begin)
        seconds, moved_again = _after(notes, begin)
        report = any(Path(folder).glob("*/report.json"))
        return Row(fault=fault, seconds=seconds, report=report, code=child.exitcode, moved_again=moved_again)


def _after(notes: list[tuple[str, float]], begin: float) -> tuple[float, bool]:
    """Return the seconds from a moment until the arm stood still for good, and whether it moved again in between."""
    motions = [(what, moment) for what, moment in notes if what in ("move", "still")]
    moving = [what for what, moment in motions if moment <= begin][-1:] == ["move"]
    stills = [moment for what, moment in motions if what == "still" and moment > begin]
    if not stills:
        return (_LONG if moving else 0.0), False
    first = stills[0] if moving else begin
    return stills[-1] - begin, any(what == "move" and moment > first for what, moment in motions)


@contextmanager
def _running(
    arm: ArmProcess, state: State, max_age: float, folder: str
) -> Iterator[tuple[BaseProcess, Callable[[], None], Callable[[], None]]]:
    """Run a deployment up to a state; yield its process, a call that makes it raise, and one that closes its stdout."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([run_cell.__module__, "shape_obs.wrappers", "shape_obs_envs", "gymnasium"])
    here, there = context.Pipe()
    reading, writing = context.Pipe(duplex=False)
    child = context.Process(target=run_cell, args=(arm.port, state, max_age, folder, there, writing))
    child.start()
    there.close()
    writing.close()
    try:
        if not here.poll(_START):
            raise TimeoutError(f"the deployment did not come into the state {state!r} within {_START:g} s")
        here.recv()
        yield child, lambda: here.send("fail"), reading.close
    finally:
        child.kill()
        child.join()
        for end in (here, reading):
            end.close()


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
    with ArmProcess() as arm:
        row = stop(arm, **scene)
    in_order = row.fault not in SIGNALS or (row.report and row.code == 128 + getattr(signal, row.fault))
    locked = scene["state"] == "C with the lock"
    return Row(row, fault="SIGTERM, lock held" if locked else row.fault, ms=1e3 * row.seconds, disorder=not in_order)


_ALIVE: Final = {"fault": (*SIGNALS, *FAILURES)}
CLAIMS: Final = (
    Claim(
        "deployment.loop", "A minute of the loop at 30 Hz, clean, and with bad frames and a hand.",
        lambda effort: ((name, 60 * effort.share, effort.seed, effort.renderer) for name in ("clean", "faulty")), loop,
        limits=(
            Limit("overruns [%]", at_most=1, unit="%", where={"run": "clean"}),
            Limit("own, p95 [ms]", at_most=25, unit="ms", where={"run": "clean"}),
            Limit("held", at_most=0, where={"run": "clean"}),
            Limit("mean [mm]", at_most=5, unit="mm"),
            *(Limit(column, at_most=0) for column in ("slips", "wrong, acted on", "stale, acted on")),
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
            Limit("moved again", at_most=0),
            Limit("without report or code", at_most=0, where={"fault": SIGNALS}),
        ),
        alone=True, needs=("gymnasium",),
    ),
)  # fmt: skip
