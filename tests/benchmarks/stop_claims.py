"""Measure by the robot's clock how soon it stops when its process is asked to end, fails or is killed."""

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
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import product, repeat
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Final, Literal

import cv2
import numpy as np

from shape_obs.camera import CameraModel, Intrinsics
from shape_obs.deploy import Interrupted, Limits, RunLog, deploy
from shape_obs.frame import Frame
from shape_obs.source import FrameTimeout, Source, StaleFrame
from tests.benchmarks.remote_arm import Arm, ArmProcess
from tests.benchmarks.tables import Column, Row, at_most, summary

State = Literal["idle", "moving", "send", "read", "log", "C", "C with the lock"]
STATES: Final[tuple[State, ...]] = ("idle", "moving", "send", "read", "log", "C")
_BLOCKED: Final = 3.0  # duration of a blocked call in seconds, much longer than any limit
_STALL: Final = 0.2
_WIDTH, _HEIGHT = 160, 120
_LENS: Final = Intrinsics(_WIDTH, _HEIGHT, 100.0, 100.0, 79.5, 59.5)
SIGNALS: Final = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")
#: Faults that end a run without a signal.
FAILURES: Final = ("exception", "closed stdout")
_OF_FAILURES: Final[tuple[State, ...]] = ("moving", "log")  # states in which they can happen
_TARGET: Final = 0.05  # seconds
_LONG: Final = 10.0  # seconds, longer than any measurement, so that the arm's own limit has no effect
MAX_AGE: Final = 0.2  # seconds, of an image in a deployment that is killed
_START: Final = 60.0


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
        rgb = np.full((_HEIGHT, _WIDTH, 3), 0 if self.dark else 200, np.uint8)
        if not self.dark:
            cv2.line(rgb, (40, 60), (110, 66), (20, 60, 200), 5)
        taken = self._begin + number / 60
        depth = np.full((_HEIGHT, _WIDTH), 700, np.uint16)
        return Frame(rgb, depth, CameraModel(_LENS), taken, taken, number, taken)


class SlowLog(RunLog):
    """A log on a disk that stalls with every step."""

    def _write_step(self, record: Mapping[str, Any]) -> None:
        time.sleep(_STALL)
        super()._write_step(record)


class Push:
    """A controller that moves, and brings the deployment into a state at a given step."""

    def __init__(self, state: State, arm: Arm, camera: DrawnRope, ready: Any, fail: threading.Event) -> None:
        self._state, self._arm, self._camera, self._ready, self._fail = state, arm, camera, ready, fail
        self._step = 0

    def act(self, observation: Any) -> Any:
        """Return full speed."""
        self._step += 1
        if self._step == 5:
            if self._state == "idle":
                self._camera.dark = True
            elif self._state == "read":
                self._camera.frozen = True
            elif self._state == "send":
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

    os.dup2(output.fileno(), 1)
    output.close()
    for name in SIGNALS:  # a job in the background inherits that they are ignored
        signal.signal(getattr(signal, name), signal.SIG_DFL)
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
    options: dict[str, Any] = {"size": [_WIDTH, _HEIGHT], "timeout": _BLOCKED, "disable_env_checker": True}
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
        report, how = any(Path(folder).glob("*/report.json")), {"code": child.exitcode, "moved_again": moved_again}
        return Row(fault=fault, state=state, seconds=seconds, report=report, **how)


def stops(count: int, seed: int, progress: Callable[[str], object] = lambda text: None) -> list[Row]:
    """Send every signal in every state, and cause every failure in the states where it can happen."""
    chance = random.Random(seed)
    pairs = [*product(SIGNALS, STATES), *product(FAILURES, _OF_FAILURES)]
    return _stopped([(*pair, chance.uniform(0.1, 0.2), _LONG) for pair in pairs for _ in range(count)], progress)


def kills(count: int, seed: int, progress: Callable[[str], object] = lambda text: None) -> list[Row]:
    """Kill deployments with SIGKILL at random instants."""
    chance = random.Random(seed)
    return _stopped([("SIGKILL", "moving", chance.uniform(0.0, 0.5), MAX_AGE) for _ in range(count)], progress)


def locked(count: int, progress: Callable[[str], object] = lambda text: None) -> list[Row]:
    """Send SIGTERM to deployments whose main thread runs C code that holds Python's lock."""
    return _stopped([("SIGTERM", "C with the lock", 0.15, MAX_AGE) for _ in range(count)], progress)


def _stopped(runs: Sequence[tuple[str, State, float, float]], progress: Callable[[str], object]) -> list[Row]:
    """Stop a deployment for each fault, state, wait and age of an image."""
    found = []
    with ArmProcess() as arm:
        for fault, state, wait, max_age in runs:
            progress(f"robustness: {fault} {len(found) + 1} of {len(runs)}")
            found.append(stop(arm, fault, state, wait=wait, max_age=max_age))
    return found


def stop_table(found: Sequence[Row]) -> list[Row]:
    """Return a row for each fault with the longest time in each state, in milliseconds."""

    def longest(state: State) -> Column:
        def column(rows: list[Row]) -> float | None:
            times = [each.seconds for each in rows if each.state == state]
            return round(1e3 * max(times), 1) if times else None

        return column

    return summary(found, ("fault",), {"runs": len, **{f"{state} [ms]": longest(state) for state in STATES}})


def targets(stopped: Sequence[Row], killed: Sequence[Row], locked_: Sequence[Row]) -> list[Row]:
    """Compare the stops with their targets."""

    def longest(rows: Sequence[Row]) -> float:
        return 1e3 * max(each.seconds for each in rows)

    orderly = [
        each.report and each.code == 128 + getattr(signal, each.fault) for each in stopped if each.fault in SIGNALS
    ]
    return [
        at_most("longest time to stand still, process alive", 1e3 * _TARGET, longest(stopped), " ms"),
        at_most("motions begun after the stop", 0, sum(each.moved_again for each in stopped), ""),
        at_most("signals without report or exit code 128 + n", 0, orderly.count(False), ""),
        at_most(f"longest time to stand still, {len(killed)} kills", 1e3 * MAX_AGE, longest(killed), " ms"),
        at_most("the same, main thread in C code that holds Python's lock", 1e3 * MAX_AGE, longest(locked_), " ms"),
    ]


def _after(notes: Sequence[tuple[str, float]], begin: float) -> tuple[float, bool]:
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
