"""Slots: pictures on their way from one process to another, in memory that both of them see."""

from __future__ import annotations

import ctypes
from multiprocessing.context import SpawnContext
from typing import Any, Final

import numpy as np
import numpy.typing as npt

#: Pictures that may wait: a quarter of a second at 30 Hz.
COUNT: Final = 8

Pictures = tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint16]]


class Slots:
    """Places for pairs of raw images, filled by one process and emptied by another.

    Args:
        context: Of the processes.
        colour: (H, W) of the colour images.
        depth: (H, W) of the depth images.
    """

    def __init__(self, context: SpawnContext, colour: tuple[int, int], depth: tuple[int, int]) -> None:
        self._sizes = colour, depth
        self._colours: Any = context.RawArray(ctypes.c_uint8, COUNT * colour[0] * colour[1] * 3)
        self._depths: Any = context.RawArray(ctypes.c_uint16, COUNT * depth[0] * depth[1])
        self._free: Any = context.Semaphore(COUNT)
        self._next = 0

    def put(self, colour: npt.NDArray[np.uint8], depth: npt.NDArray[np.uint16]) -> int | None:
        """Copy a pair into the next place, and tell which; None where all are full."""
        if not self._free.acquire(block=False):
            return None
        slot, self._next = self._next, (self._next + 1) % COUNT
        into_colour, into_depth = self.get(slot)
        into_colour[:], into_depth[:] = colour, depth
        return slot

    def get(self, slot: int) -> Pictures:
        """The pair in a place, without a copy: colour (H,W,3) uint8 and depth (H,W) uint16."""
        colour, depth = self._sizes
        colours = np.frombuffer(self._colours, np.uint8).reshape(COUNT, *colour, 3)
        return colours[slot], np.frombuffer(self._depths, np.uint16).reshape(COUNT, *depth)[slot]

    def release(self) -> None:
        """The oldest place that is full may be filled again."""
        self._free.release()
