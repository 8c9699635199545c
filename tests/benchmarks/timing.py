"""Time several methods in turns on the same frames, and describe the machine on which they ran."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Container, Iterable, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from itertools import count, islice, product
from pathlib import Path
from typing import Any, Final, Generic, NamedTuple, TypeVar

import numpy as np

from shape_obs.utils.threads import one_thread

S = TypeVar("S")
T = TypeVar("T")
_PACKAGES: Final = ("numpy", "scipy", "opencv-python-headless", "scikit-learn", "numba")


@dataclass(frozen=True)
class Method(Generic[S]):
    """A method to be timed.

    Args:
        name: Its name in the tables.
        run: The timed call, on one frame.
        before: Called before the clock starts.
        touch: Reads a frame's data into the cache, so that it does not matter which method ran before.
        frames: Numbers of the frames on which the method runs; None for all.
    """

    name: str
    run: Callable[[S], Any]
    before: Callable[[], object] = lambda: None
    touch: Callable[[S], object] = lambda frame: None
    frames: Container[int] | None = None


class Turn(NamedTuple):
    """The time and the result of one method on one frame."""

    frame: int
    milliseconds: float
    result: Any


def time_methods(
    frames: Iterable[S], methods: Sequence[Method[S]], *, warm_up: int, burst: int = 1
) -> dict[str, list[Turn]]:
    """Run every method on every frame, on one thread, and return the turns of each method.

    Args:
        frames: The frames, in order.
        methods: The methods; another one begins in each turn, so that load on the machine slows all of them.
        warm_up: Number of the first frames, which do not count.
        burst: Frames in a turn. With 1 every method runs with the caches that another method left behind.
    """
    found: dict[str, list[Turn]] = {method.name: [] for method in methods}
    numbered = enumerate(frames)
    with one_thread():
        for turn in count():
            some = list(islice(numbered, burst))
            if not some:
                return found
            order = np.roll(np.arange(len(methods)), -turn).tolist()
            for method, (i, frame) in product([methods[index] for index in order], some):
                if method.frames is not None and i not in method.frames:
                    continue
                method.before()
                method.touch(frame)
                result, milliseconds = timed(lambda method=method, frame=frame: method.run(frame))
                if i >= warm_up:
                    found[method.name].append(Turn(i, milliseconds, result))
    return found


def timed(call: Callable[[], T], now: Callable[[], float] = time.perf_counter) -> tuple[T, float]:
    """Return the result of a call and its milliseconds."""
    begin = now()
    result = call()
    return result, 1e3 * (now() - begin)


def median_ms(turns: Iterable[Turn]) -> float:
    """Return the median time in milliseconds."""
    return float(np.median([turn.milliseconds for turn in turns]))


def times_slower(turns: Sequence[Turn], others: Sequence[Turn]) -> float:
    """Return how many times slower one method is than another: the ratio of medians over their common frames."""
    both = {turn.frame for turn in turns} & {turn.frame for turn in others}
    one, other = (median_ms(turn for turn in some if turn.frame in both) for some in (turns, others))
    return one / other


def machine(*more: str) -> dict[str, str]:
    """Return the hardware and software that determine the speed: name -> description or version.

    Args:
        more: Further packages whose versions are listed if they are installed.
    """
    table = Path("/proc/cpuinfo")
    lines = table.read_text(encoding="utf-8").splitlines() if table.is_file() else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    found = {
        "processor": models[0] if models else platform.processor() or "unknown",
        "cores": str(os.cpu_count()),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
    }
    for package in (*_PACKAGES, *more):
        found |= {package: number} if (number := installed_version(package)) else {}
    return found


def installed_version(package: str) -> str:
    """Return the version of a package, or an empty string if it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return ""
