"""Timing in turns: every method on every frame, now one first and now another, so that none has the quieter machine."""

from __future__ import annotations

import time
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import count, islice
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
