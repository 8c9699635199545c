"""Timing in turns: every method on every frame, now one first and now another, so that none has the quieter machine.

On what a measurement ran.

What of OpenGL the simulated environments find here.
"""

from __future__ import annotations

import importlib
import os
import platform
import time
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from itertools import count, islice
from pathlib import Path
from typing import Any, Final, Generic, Literal, NamedTuple, TypeVar

import numpy as np

S = TypeVar("S")

Clock = Literal["wall", "thread"]


# Processor time of this thread alone is blind to others on a busy machine, and to threads of its own.
CLOCKS: Final[dict[Clock, Callable[[], float]]] = {"wall": time.perf_counter, "thread": time.thread_time}


def _nothing() -> None:
    """What most entrants need done before."""


@dataclass(frozen=True)
class Entrant(Generic[S]):
    """One method.

    Args:
        name: As the tables call it.
        run: What is timed, on one frame.
        before: What it needs done before its clock starts.
        touch: Brings what it reads into the cache, as if it had just been made: who ran before must not matter.
        frames: In which it takes part; None is all.
    """

    name: str
    run: Callable[[S], Any]
    before: Callable[[], object] = _nothing
    touch: Callable[[S], object] = lambda frame: None
    frames: Container[int] | None = None


class Turn(NamedTuple):
    """One method on one frame.

    Args:
        frame: Its number.
        name: The entrant's.
        milliseconds: What it took.
        result: What came out.
    """

    frame: int
    name: str
    milliseconds: float
    result: Any


def turns(
    frames: Iterable[S],
    entrants: Sequence[Entrant[S]],
    clock: Clock = "wall",
    seed: int | None = None,
    burst: int = 1,
) -> Iterator[Turn]:
    """Let every entrant run on every frame in which it takes part.

    Args:
        frames: In order.
        entrants: Who runs.
        clock: Counts the time that passes, or the processor time of this thread.
        seed: Draws the order in each turn. Without one the order rotates: who begins changes, but all run after
            the same one, which counts between methods that are nearly equal.
        burst: Frames in a turn. With 1 every method finds the processor's caches full of another's work.
    """
    now = CLOCKS[clock]
    rng = None if seed is None else np.random.default_rng(seed)
    numbered = enumerate(frames)
    for turn in count():
        some = list(islice(numbered, burst))
        if not some:
            return
        order = np.roll(np.arange(len(entrants)), -turn) if rng is None else rng.permutation(len(entrants))
        for entrant in (entrants[place] for place in order.tolist()):
            for i, frame in some:
                if entrant.frames is not None and i not in entrant.frames:
                    continue
                entrant.before()
                entrant.touch(frame)
                begin = now()
                result = entrant.run(frame)
                yield Turn(i, entrant.name, 1e3 * (now() - begin), result)


_PACKAGES: Final = ("numpy", "scipy", "opencv-python-headless", "opencv-python", "scikit-learn", "numba")


def machine(*more: str) -> dict[str, str]:
    """What of hardware and software decides the speed: name -> what it is.

    Args:
        more: Packages that have a say, beside those that always have.
    """
    found = {
        "processor": _processor(),
        "cores": str(os.cpu_count()),
        "system": f"{platform.system()} {platform.machine()}",
    }
    found["python"] = platform.python_version()
    return found | {package: number for package in (*_PACKAGES, *more) if (number := _version(package))}


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def _processor() -> str:
    table = Path("/proc/cpuinfo")
    if table.is_file():
        for line in table.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or "unknown"


def no_opengl() -> str:
    """Why the environments cannot draw with OpenGL here; empty where they can."""
    return _asked()[1]


def opengl() -> str:
    """What draws: the driver's own name for it; empty without OpenGL."""
    return _asked()[0]


def _asked() -> tuple[str, str]:
    """What draws, and why nothing does: one of them is empty."""
    from shape_obs_envs.mujoco.cameras.gl_context import GLUnavailableError, open_context
    from shape_obs_envs.mujoco.engine import mujoco

    try:
        gl, context = open_context(mujoco.MjModel.from_xml_string("<mujoco/>"), 16, 16)
    except GLUnavailableError as error:
        return "", str(error)
    try:
        functions = importlib.import_module("OpenGL.GL")
        return functions.glGetString(functions.GL_RENDERER).decode(), ""
    finally:
        context.free()
        gl.free()
