"""Time several methods in turns on the same frames."""

from __future__ import annotations

import time
from collections.abc import Callable, Container, Iterable, Sequence
from dataclasses import dataclass
from itertools import count, islice, product
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from shape_obs.utils.threads import one_thread

S = TypeVar("S")
T = TypeVar("T")


@dataclass(frozen=True)
class Method(Generic[S]):
    """A method to be timed.

    Args:
        name: Its name in the tables.
        run: The timed call, on one frame.
        frames: Numbers of the frames on which the method runs; None for all.
    """

    name: str
    run: Callable[[S], Any]
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
                if method.frames is None or i in method.frames:
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
