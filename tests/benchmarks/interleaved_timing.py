"""Time several methods in turns on the same frames, and describe the machine on which they ran."""

from __future__ import annotations

import importlib
import os
import platform
import time
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from itertools import count, islice, product
from pathlib import Path
from typing import Any, Final, Generic, NamedTuple, TypeVar

import numpy as np

from shape_obs.utils.threads import one_thread
from tests.benchmarks import Clock

S = TypeVar("S")
T = TypeVar("T")

# The processor time of this thread ignores other processes on a busy machine, and also other threads of this process.
CLOCKS: Final[dict[Clock, Callable[[], float]]] = {"wall": time.perf_counter, "thread": time.thread_time}
_PACKAGES: Final = ("numpy", "scipy", "opencv-python-headless", "opencv-python", "scikit-learn", "numba")


@dataclass(frozen=True)
class Method(Generic[S]):
    """One method to be timed.

    Args:
        name: Its name in the tables.
        run: The timed call, on one frame.
        before: Called before the clock starts.
        touch: Reads a frame's data into the cache, so that it does not matter which method ran before.
        frames: Numbers of the frames on which the method runs; None for all.
    """

    name: Any
    run: Callable[[S], Any]
    before: Callable[[], object] = lambda: None
    touch: Callable[[S], object] = lambda frame: None
    frames: Container[int] | None = None


def timed(call: Callable[[], T], now: Callable[[], float] = time.perf_counter) -> tuple[T, float]:
    """Return the result of a call and its milliseconds."""
    begin = now()
    result = call()
    return result, 1e3 * (now() - begin)


class Turn(NamedTuple):
    """The time and the result of one method on one frame."""

    frame: int
    name: Any
    milliseconds: float
    result: Any


class Timing(NamedTuple):
    """The options that every measurement of speed has.

    Args:
        seed: Seed of everything that is drawn at random.
        clock: ``"wall"`` counts elapsed time, ``"thread"`` the processor time of this thread.
        burst: Frames in a turn. With 1 every method runs with the caches that another method left behind.
        tick: Called after each frame.
    """

    seed: int = 0
    clock: Clock = "wall"
    burst: int = 1
    tick: Callable[[], Any] = lambda: None


def interleaved_timing(
    frames: Iterable[S],
    methods: Sequence[Method[S]],
    timing: Timing,
    *,
    warm_up: int = 0,
    shuffled: bool = False,
) -> Iterator[Turn]:
    """Run every method on every frame, on one thread, in an order that changes from turn to turn.

    Args:
        frames: The frames, in order.
        methods: The methods.
        timing: Clock, length of a turn, and the seed that draws the order.
        warm_up: Number of the first frames, on which the methods run but nothing is yielded.
        shuffled: Whether the order of each turn is drawn. Otherwise it rotates: the first method changes, but each one
            always runs after the same other one, which matters for methods that are nearly equal.
    """
    now = CLOCKS[timing.clock]
    rng = np.random.default_rng(timing.seed) if shuffled else None
    numbered = enumerate(frames)
    with one_thread():
        for turn in count():
            some = list(islice(numbered, timing.burst))
            if not some:
                return
            order = np.roll(np.arange(len(methods)), -turn) if rng is None else rng.permutation(len(methods))
            for method, (i, frame) in product([methods[index] for index in order.tolist()], some):
                if method.frames is not None and i not in method.frames:
                    continue
                method.before()
                method.touch(frame)
                begin = now()
                result = method.run(frame)
                milliseconds = 1e3 * (now() - begin)
                if i >= warm_up:
                    yield Turn(i, method.name, milliseconds, result)
            for _ in some:
                timing.tick()


def time_methods(
    frames: Iterable[S], methods: Sequence[Method[S]], timing: Timing, *, warm_up: int, shuffled: bool = False
) -> dict[Any, list[Turn]]:
    """Return the turns of ``interleaved_timing`` by the name of their method, in the order of the methods."""
    found: dict[Any, list[Turn]] = {method.name: [] for method in methods}
    for turn in interleaved_timing(frames, methods, timing, warm_up=warm_up, shuffled=shuffled):
        found[turn.name].append(turn)
    return found


def median_ms(turns: Iterable[Turn]) -> float:
    """Return the median time in milliseconds."""
    return float(np.median([turn.milliseconds for turn in turns]))


def machine(*more: str) -> dict[str, str]:
    """Return the hardware and software that determine the speed: name -> description or version.

    Args:
        more: Further packages whose versions are listed if they are installed.
    """
    found = {
        "processor": _processor(),
        "cores": str(os.cpu_count()),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
    }
    return found | {package: number for package in (*_PACKAGES, *more) if (number := package_version(package))}


def package_version(package: str) -> str:
    """Return the installed version of a package, or an empty string."""
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def opengl() -> tuple[str, str]:
    """Return the name of the OpenGL driver, and why there is none; one of the two is empty."""
    from shape_obs_envs.mujoco.cameras.gl_camera import GLUnavailableError, open_context
    from shape_obs_envs.mujoco.scene import mujoco

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


def _processor() -> str:
    table = Path("/proc/cpuinfo")
    if table.is_file():
        for line in table.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or "unknown"
