"""Where the two grippers that hold a sheet may go."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HeldEdgeWorkspace:
    """A box for each gripper, limits of their distance and of the held edge's turn, and a floor that may rise.

    Poses are (2, 3): a row of x, y, z [m] for each gripper, in the base frame.

    Attributes:
        floor: Least heights of the grippers (2,) [m] as the sheet lies at present. It is approached no faster than
            `lift` in a step and never lies above the box.
        low: Lower corner of gripper 0's box (x, y, z) [m].
        high: Upper corner of gripper 0's box (x, y, z) [m]; gripper 1's box is its mirror image at x = 0.
        closest: Least distance of the grippers [m].
        reach: Largest distance of the grippers [m]: the sheet is not pulled taut.
        turn: Largest difference of their y [m].
        lift: See `floor` [m].
    """

    floor: Callable[[], Array]
    low: tuple[float, float, float] = (-0.24, -0.05, 0.02)
    high: tuple[float, float, float] = (-0.08, 0.14, 0.08)
    closest: float = 0.19
    reach: float = 0.35
    turn: float = 0.08
    lift: float = 0.015

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest poses, (2, 3) each."""
        (x0, y0, z0), (x1, y1, z1) = self.low, self.high
        return np.array([[x0, y0, z0], [-x1, y0, z0]]), np.array([[x1, y1, z1], [-x0, y1, z1]])

    def allows(self, poses: Array) -> bool:
        """Whether `poses` keep all limits but the floor, to within a micrometre."""
        low, high = self.bounds
        inside = bool(np.all(poses >= low - 1e-6) and np.all(poses <= high + 1e-6))
        way = poses[1] - poses[0]
        span = float(np.linalg.norm(way))
        return inside and self.closest - 1e-6 <= span <= self.reach + 1e-6 and bool(abs(way[1]) <= self.turn + 1e-6)

    def clip(self, poses: Array, previous: Array) -> Array:
        """The allowed poses near `poses`; `previous`, which must be allowed, where there are none close by.

        Grippers that go too far apart, too close or too uneven give way by half each.
        """
        low, high = self.bounds
        out = poses.copy()
        rise = np.minimum(self.floor(), previous[:, 2] + self.lift)
        out[:, 2] = np.maximum(out[:, 2], rise)
        for _ in range(4):  # each correction can undo a little of the others
            out = np.clip(out, low, high)
            if self.allows(out):
                return out
            way = out[1] - out[0]
            span = max(float(np.linalg.norm(way)), 1e-9)
            shift = way * (1 - np.clip(span, self.closest, self.reach) / span)
            shift[1] += way[1] - shift[1] - np.clip(way[1] - shift[1], -self.turn, self.turn)
            out += np.array([[0.5], [-0.5]]) * shift
        out = np.clip(out, low, high)
        return out if self.allows(out) else previous.copy()
