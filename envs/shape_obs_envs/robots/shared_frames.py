"""Data exchanged with the simulation process: its parameters, its messages, and images in shared memory."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass, field
from multiprocessing.context import SpawnContext
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs_envs.sources.realsense.driver import Geometry

Array = npt.NDArray[np.float64]
RawPair = tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint16]]
#: Largest number of queued image pairs: a quarter of a second at 30 Hz.
_COUNT: Final = 8


@dataclass(frozen=True)
class SimulationSpec:
    """Parameters of a simulation.

    Args:
        env: Id of the environment.
        geometry: Geometry of the raw images.
        fps: Frames per second.
        seed: Seed of the first start and of the noise.
        noise: Whether images have the noise of a D455.
        options: Arguments of the environment.
    """

    env: str
    geometry: Geometry
    fps: float
    seed: int | None
    noise: bool
    options: Mapping[str, Any] = field(default_factory=dict)


class Started(NamedTuple):
    """Message: a new start.

    Attributes:
        poses: Gripper poses, shape ``(G, 3)``.
        state: Physics state.
        anchors: Where the grippers hold the object: name -> (x, y, z) in metres, base frame.
    """

    poses: Array
    state: Array
    anchors: dict[str, tuple[float, ...]]


class Captured(NamedTuple):
    """Message: a frame was captured.

    Attributes:
        period: Number of the camera period; gaps are frames that were skipped for lack of time.
        stamp: ``time.monotonic()`` of the scene in seconds.
        slot: Index of the images in shared memory; None if the queue was full.
        points: True points of the object, shape ``(n, 3)``, in metres, base frame.
        anchors: Where the grippers hold the object: name -> (x, y, z) in metres, base frame.
        covered: Whether a hand is in the image.
    """

    period: int
    stamp: float
    slot: int | None
    points: Array
    anchors: dict[str, tuple[float, ...]]
    covered: bool


class Failed(NamedTuple):
    """Message: the simulation ended with an error."""

    reason: str


class SharedFrames:
    """A ring buffer of raw image pairs in shared memory, written by one process and read by another.

    Args:
        context: Multiprocessing context of the processes.
        colour: Size ``(H, W)`` of the colour images.
        depth: Size ``(H, W)`` of the depth images.
    """

    def __init__(self, context: SpawnContext, colour: tuple[int, int], depth: tuple[int, int]) -> None:
        self._sizes = colour, depth
        self._colours: Any = context.RawArray(ctypes.c_uint8, _COUNT * colour[0] * colour[1] * 3)
        self._depths: Any = context.RawArray(ctypes.c_uint16, _COUNT * depth[0] * depth[1])
        self._free: Any = context.Semaphore(_COUNT)
        self._next = 0

    def put(self, colour: npt.NDArray[np.uint8], depth: npt.NDArray[np.uint16]) -> int | None:
        """Copy a pair into the next slot and return its index; None if all slots are full."""
        if not self._free.acquire(block=False):
            return None
        slot, self._next = self._next, (self._next + 1) % _COUNT
        into_colour, into_depth = self.get(slot)
        into_colour[:], into_depth[:] = colour, depth
        return slot

    def get(self, slot: int) -> RawPair:
        """Return the pair in a slot without copying: colour ``(H, W, 3)`` uint8 and depth ``(H, W)`` uint16."""
        colour, depth = self._sizes
        colours = np.frombuffer(self._colours, np.uint8).reshape(_COUNT, *colour, 3)
        return colours[slot], np.frombuffer(self._depths, np.uint16).reshape(_COUNT, *depth)[slot]

    def release(self) -> None:
        """Free the oldest full slot."""
        self._free.release()
