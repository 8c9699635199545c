"""The workspace of ropes that are each held by a gripper at one end and fixed at the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TetheredWorkspace:
    """Limits for ropes that are each held at end 0 and fixed at end 1: boxes, and distances from the fixed ends.

    Poses have shape ``(G, 3)``: a row of x, y in metres and yaw in radians for each gripper, in the base frame. Yaw is
    the heading of the rope from end 0 to end 1.

    Attributes:
        tethers: Returns the poses ``(G, 3)`` of the fixed ends.
        low: Lowest pose of each gripper.
        high: Highest pose of each gripper.
        closest: Smallest distance of a rope's tips in metres.
        reach: Largest distance in metres of the two points that lie ``lever`` inside the tips along the yaws.
        lever: See ``reach``, in metres.
    """

    tethers: Callable[[], Array]
    low: tuple[tuple[float, float, float], ...]
    high: tuple[tuple[float, float, float], ...]
    closest: float = 0.27
    reach: float = 0.375
    lever: float = 0.05

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest poses, ``(G, 3)`` each."""
        return np.array(self.low), np.array(self.high)

    def allows(self, poses: Array) -> bool:
        """Return whether ``poses`` satisfy all limits, to within a micrometre."""
        low, high = self.bounds
        inside = bool(np.all(poses >= low - 1e-6) and np.all(poses <= high + 1e-6))
        return inside and bool(self._within(poses).all())

    def clip(self, poses: Array, previous: Array) -> Array:
        """Return allowed poses near ``poses``; a gripper for which there are none close by keeps its previous pose."""
        out = np.clip(poses, *self.bounds)
        for _ in range(3):  # a correction can partly undo the others
            tips, inner = self._spans(out)
            span, stretch = (np.linalg.norm(way, axis=1, keepdims=True) for way in (tips, inner))
            out[:, :2] += np.maximum(1 - self.reach / stretch, 0) * inner
            out[:, :2] -= np.maximum(self.closest / np.maximum(span, 1e-9) - 1, 0) * tips
            out = np.clip(out, *self.bounds)
        return np.where(self._within(out)[:, None], out, previous)

    def _within(self, poses: Array) -> NDArray[np.bool_]:
        """Return for each gripper whether its distances from the fixed end are allowed, ``(G,)``."""
        span, stretch = np.linalg.norm(self._spans(poses), axis=2)
        return (span >= self.closest - 1e-6) & (stretch <= self.reach + 1e-6)

    def _spans(self, poses: Array) -> Array:
        """Return vectors ``(2, G, 2)`` from end 0 to end 1: between the tips and between the points inside them."""
        tips, levers = zip(*(_tip_and_lever(ends, self.lever) for ends in (poses, self.tethers())), strict=True)
        between = tips[1] - tips[0]
        return np.stack([between, between - levers[0] - levers[1]])


def _tip_and_lever(poses: Array, lever: float) -> tuple[Array, Array]:
    """Return the tips ``(G, 2)`` of poses ``(G, 3)`` and vectors of length ``lever`` along their yaws."""
    return poses[:, :2], lever * np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
