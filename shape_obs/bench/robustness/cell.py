"""Deploy before a drawn camera, and come into the state in which a fault is to hit."""

from __future__ import annotations

import hashlib
import os
import sys
import threading
import time
from collections.abc import Mapping
from itertools import repeat
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final, Literal

import cv2
import numpy as np

from shape_obs.bench.robustness.arm import Arm
from shape_obs.camera import CameraModel, Intrinsics
from shape_obs.deploy import Interrupted, Limits, RunLog, deploy
from shape_obs.frame import Frame
from shape_obs.source import FrameTimeout, Source, StaleFrame

State = Literal["idle", "moving", "send", "read", "log", "C", "C with the lock"]
STATES: Final[tuple[State, ...]] = ("idle", "moving", "send", "read", "log", "C")
#: Seconds that a blocked call stays blocked: much longer than any limit.
_BLOCKED: Final = 3.0
_STALL: Final = 0.2
_WIDTH, _HEIGHT = 160, 120
_LENS: Final = Intrinsics(_WIDTH, _HEIGHT, 100.0, 100.0, 79.5, 59.5)


class DrawnRope(Source):
    """A camera at 60 Hz that sees a blue rope.

    Attributes:
        dark: Images are black.
        frozen: No frame comes any more.
    """

    kind, name, live, has_depth = "drawn", "drawn rope", True, True

    def __init__(self) -> None:
        super().__init__()
        self.dark = self.frozen = False
        self._begin, self._read = time.monotonic(), -1

    @property
    def intrinsics(self) -> Intrinsics:
        """The lens."""
        return _LENS

    def connect(self) -> None:
        """Do nothing: it is always there."""

    def disconnect(self) -> None:
        """Do nothing."""

    def read(self, timeout: float = 1.0, fresh: bool = False) -> Frame:
        """Wait for the next frame."""
        if self.frozen:
            time.sleep(timeout)
            raise FrameTimeout(f"no frame in {timeout} s")
        self._read = self._newest() + 1
        time.sleep(max(0.0, self._begin + self._read / 60 - time.monotonic()))
        return self._frame()

    def read_latest(self, max_age: float = 0.1) -> Frame:
        """Return the newest frame."""
        if self.frozen or time.monotonic() - (self._begin + self._newest() / 60) > max_age:
            raise StaleFrame("too old")
        self._read = self._newest()
        return self._frame()

    def _newest(self) -> int:
        return int((time.monotonic() - self._begin) * 60)

    def _frame(self) -> Frame:
        rgb = np.full((_HEIGHT, _WIDTH, 3), 0 if self.dark else 200, np.uint8)
        if not self.dark:
            cv2.line(rgb, (40, 60), (110, 66), (20, 60, 200), 5)
        taken = self._begin + self._read / 60
        depth = np.full((_HEIGHT, _WIDTH), 700, np.uint16)
        return Frame(rgb, depth, CameraModel(_LENS), taken, taken, self._read, taken)


class SlowLog(RunLog):
    """A log on a disk that stalls with every step."""

    def _write_step(self, record: Mapping[str, Any]) -> None:
        time.sleep(_STALL)
        super()._write_step(record)


class Push:
    """A controller that moves on, and comes into the state that is wanted at a step."""

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
    """Deploy until something ends it; the target of a child process.

    Args:
        port: Of the arm.
        state: Into which to come; ``parent`` is told when it is there.
        max_age: Of the limits, in seconds.
        folder: For the log.
        parent: Told ``"ready"``; any answer makes the controller raise.
        output: In place of stdout, where a line is printed at each step.
    """
    import gymnasium as gym

    from shape_obs.wrappers import ShapeObservation

    os.dup2(output.fileno(), 1)
    output.close()
    arm, camera, fail = Arm(port), DrawnRope(), threading.Event()

    def listen() -> None:
        try:
            parent.recv()
            fail.set()
        except EOFError:
            return  # the measuring process needs nothing more

    def on_step(moment: Any) -> None:
        try:
            print(moment.judgement, flush=True)
        except BrokenPipeError:
            arm.mark()
            raise

    threading.Thread(target=listen, daemon=True).start()
    env = gym.make(
        "shape_obs_envs:ShapeObs/D455-v0",
        source=camera,
        robot=arm,
        rate=30.0,
        size=[_WIDTH, _HEIGHT],
        timeout=_BLOCKED,
        disable_env_checker=True,
    )
    env = ShapeObservation(
        env,
        shapes=[{"kind": "centerline", "n": 10}],
        segmentation={"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]},
    )
    log = (SlowLog if state == "log" else RunLog)(Path(folder) / "run", {})
    controller = Push(state, arm, camera, lambda: parent.send("ready"), fail)
    try:
        deploy(env, controller, Limits(hold=60.0, max_age=max_age, watchdog=30.0), log=log, on_step=on_step)
    except Interrupted as interrupted:
        sys.exit(128 + interrupted.signum)
    except (ZeroDivisionError, BrokenPipeError):
        sys.exit(1)
