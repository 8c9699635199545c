"""Where grippers may go."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Workspace(Protocol):
    """Where G grippers may go, in poses (G, 3)."""

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest poses, (G, 3) each."""
        ...

    def allows(self, poses: Array) -> bool:
        """Whether `poses` keep all limits, to within a micrometre."""
        ...

    def clip(self, poses: Array, previous: Array) -> Array:
        """The allowed poses near `poses`; `previous`, which must be allowed, where there are none close by."""
        ...


@dataclass(frozen=True)
class BoxWorkspace:
    """A box of poses for each gripper and nothing else.

    Attributes:
        low: Lowest pose of each gripper.
        high: Highest pose of each gripper.
    """

    low: tuple[tuple[float, float, float], ...]
    high: tuple[tuple[float, float, float], ...]

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest poses, (G, 3) each."""
        return np.array(self.low), np.array(self.high)

    def allows(self, poses: Array) -> bool:
        """Whether `poses` keep all limits, to within a micrometre."""
        low, high = self.bounds
        return bool(np.all(poses >= low - 1e-6) and np.all(poses <= high + 1e-6))

    def clip(self, poses: Array, previous: Array) -> Array:
        """The nearest allowed poses."""
        return np.clip(poses, *self.bounds)


@dataclass(frozen=True)
class TwoGripperWorkspace:
    """Of the two ends of a rope: boxes, limits of yaw, and of their distance, neither stretched nor folded over.

    Poses are (2, 3): a row of x, y [m] and yaw [rad] for each gripper, in the base frame. Yaw is the heading of the
    rope from end 0 to end 1, so that a straight rope along x has yaw 0 at both ends.

    Attributes:
        low: Lower corner of gripper 0's box (x, y) [m].
        high: Upper corner of gripper 0's box (x, y) [m]; gripper 1's box is its mirror image at x = 0.
        yaw: Largest |yaw| [rad].
        closest: Least distance of the tips [m].
        reach: Largest distance [m] of the two points that lie `lever` inside the tips along the yaws.
        lever: See `reach` [m]. It makes turning a gripper away from a taut rope count as stretching.
    """

    low: tuple[float, float] = (-0.24, -0.08)
    high: tuple[float, float] = (-0.06, 0.12)
    yaw: float = 1.0
    closest: float = 0.25
    reach: float = 0.385
    lever: float = 0.05

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest poses, (2, 3) each."""
        (x0, y0), (x1, y1) = self.low, self.high
        low = np.array([[x0, y0, -self.yaw], [-x1, y0, -self.yaw]])
        high = np.array([[x1, y1, self.yaw], [-x0, y1, self.yaw]])
        return low, high

    def allows(self, poses: Array) -> bool:
        """Whether `poses` keep all limits, to within a micrometre."""
        low, high = self.bounds
        inside = bool(np.all(poses >= low - 1e-6) and np.all(poses <= high + 1e-6))
        span, inner = np.linalg.norm(self._spans(poses), axis=1)
        return inside and bool(span >= self.closest - 1e-6 and inner <= self.reach + 1e-6)

    def clip(self, poses: Array, previous: Array) -> Array:
        """The allowed poses near `poses`; `previous`, which must be allowed, where there are none close by.

        Grippers that pull too far apart or push too close slide along the limit, each giving way by half.
        """
        low, high = self.bounds
        out = np.clip(poses, low, high)
        for _ in range(3):  # each correction can undo a little of the others
            if self.allows(out):
                return out
            tips, inner = self._spans(out)
            span, stretch = np.linalg.norm(tips), np.linalg.norm(inner)
            if stretch > self.reach:
                shift = inner * (1 - self.reach / stretch) / 2
            elif span < self.closest:
                shift = tips * (1 - self.closest / max(float(span), 1e-9)) / 2
            else:
                shift = np.zeros(2)
            out[0, :2] += shift
            out[1, :2] -= shift
            out = np.clip(out, low, high)
        return out if self.allows(out) else previous.copy()

    def _spans(self, poses: Array) -> Array:
        """Vectors from end 0 to end 1: (2, 2) of the tips and of the points inside them."""
        lever = self.lever * np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])]) * [[1], [-1]]
        tips = poses[:, :2]
        return np.stack([tips[1] - tips[0], (tips + lever)[1] - (tips + lever)[0]])
