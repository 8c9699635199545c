"""Workspaces: allowed poses of the grippers, and the meaning of the actions that move them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from shape_obs.robot import ActionSpec
from shape_obs_envs.mujoco.bodies import Body, PlanarBody

Array = NDArray[np.float64]


class Workspace(Protocol):
    """Allowed poses ``(G, 3)`` of G grippers."""

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest poses, ``(G, 3)`` each."""
        ...

    def allows(self, poses: Array) -> bool:
        """Return whether ``poses`` satisfy all limits, to within a micrometre."""
        ...

    def clip(self, poses: Array, previous: Array) -> Array:
        """Return allowed poses near ``poses``, or ``previous``, which must be allowed, if there are none close by."""
        ...


@dataclass(frozen=True)
class BoxWorkspace:
    """A box of poses for each gripper.

    Attributes:
        low: Lowest pose of each gripper.
        high: Highest pose of each gripper.
    """

    low: tuple[tuple[float, float, float], ...]
    high: tuple[tuple[float, float, float], ...]

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest poses, ``(G, 3)`` each."""
        return np.array(self.low), np.array(self.high)

    def allows(self, poses: Array) -> bool:
        """Return whether ``poses`` satisfy all limits, to within a micrometre."""
        return _inside(poses, self.bounds)

    def clip(self, poses: Array, previous: Array) -> Array:
        """Return the nearest allowed poses."""
        return np.clip(poses, *self.bounds)


@dataclass(frozen=True)
class TwoGripperWorkspace:
    """Limits for the two ends of a rope: boxes, yaw, and distances that neither stretch nor fold the rope.

    Poses have shape ``(2, 3)``: a row of x, y in metres and yaw in radians for each gripper, in the base frame. Yaw is
    the heading of the rope from end 0 to end 1, so that a straight rope along x has yaw 0 at both ends.

    Attributes:
        low: Lower corner (x, y) of gripper 0's box in metres.
        high: Upper corner (x, y) of gripper 0's box in metres; gripper 1's box is its mirror image at x = 0.
        yaw: Largest absolute yaw in radians.
        closest: Smallest distance of the tips in metres.
        reach: Largest distance in metres of the two points that lie ``lever`` inside the tips along the yaws.
        lever: See ``reach``, in metres. With it, turning a gripper away from a taut rope counts as stretching.
    """

    low: tuple[float, float] = (-0.24, -0.08)
    high: tuple[float, float] = (-0.06, 0.12)
    yaw: float = 1.0
    closest: float = 0.25
    reach: float = 0.385
    lever: float = 0.05

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest poses, ``(2, 3)`` each."""
        (x0, y0), (x1, y1) = self.low, self.high
        low = np.array([[x0, y0, -self.yaw], [-x1, y0, -self.yaw]])
        high = np.array([[x1, y1, self.yaw], [-x0, y1, self.yaw]])
        return low, high

    def allows(self, poses: Array) -> bool:
        """Return whether ``poses`` satisfy all limits, to within a micrometre."""
        span, inner = np.linalg.norm(self._spans(poses), axis=1)
        return _inside(poses, self.bounds) and bool(span >= self.closest - 1e-6 and inner <= self.reach + 1e-6)

    def clip(self, poses: Array, previous: Array) -> Array:
        """Return allowed poses near ``poses``, or ``previous``, which must be allowed, if there are none close by.

        Grippers that pull too far apart or push too close slide along the limit; each is corrected by half.
        """
        low, high = self.bounds
        out = np.clip(poses, low, high)
        for _ in range(3):  # a correction can partly undo the others
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
        """Return vectors ``(2, 2)`` from end 0 to end 1: between the tips and between the points inside them."""
        lever = self.lever * np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])]) * [[1], [-1]]
        tips = poses[:, :2]
        return np.stack([tips[1] - tips[0], (tips + lever)[1] - (tips + lever)[0]])


@dataclass(frozen=True)
class HangingWorkspace:
    """Limits for the two ends of a rope in space: boxes, and distances that neither stretch nor tangle the rope.

    Poses have shape ``(2, 3)``: a row of x, y, z in metres for each gripper, in the base frame.

    Attributes:
        reach: Returns the largest distance of the grippers in metres.
        low: Lower corner (x, y, z) of gripper 0's box in metres.
        high: Upper corner (x, y, z) of gripper 0's box in metres; gripper 1's box is its mirror image at x = 0.
    """

    reach: Callable[[], float]
    low: tuple[float, float, float]
    high: tuple[float, float, float]

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest poses, ``(2, 3)`` each."""
        return _mirrored(self.low, self.high)

    def allows(self, poses: Array) -> bool:
        """Return whether ``poses`` satisfy all limits, to within a micrometre."""
        return _inside(poses, self.bounds) and bool(np.linalg.norm(poses[1] - poses[0]) <= self.reach() + 1e-6)

    def clip(self, poses: Array, previous: Array) -> Array:
        """Return allowed poses near ``poses``, or ``previous``, which must be allowed, if there are none close by.

        Grippers that are too far apart are each corrected by half.
        """
        low, high = self.bounds
        out = np.clip(poses, low, high)
        for _ in range(3):  # the boxes can partly undo the correction
            if self.allows(out):
                return out
            middle = out.mean(axis=0)
            out = np.clip(middle + (out - middle) * (self.reach() / np.linalg.norm(out[1] - out[0])), low, high)
        return out if self.allows(out) else previous.copy()


@dataclass(frozen=True)
class HeldEdgeWorkspace:
    """Limits for the two held corners of a sheet: boxes, distance, turn of the held edge, and a variable floor.

    Poses have shape ``(2, 3)``: a row of x, y, z in metres for each gripper, in the base frame.

    Attributes:
        floor: Returns the lowest heights ``(2,)`` of the grippers in metres for the sheet's present state. It is
            approached by at most ``lift`` per step and never lies above the box.
        low: Lower corner (x, y, z) of gripper 0's box in metres.
        high: Upper corner (x, y, z) of gripper 0's box in metres; gripper 1's box is its mirror image at x = 0.
        closest: Smallest distance of the grippers in metres.
        reach: Largest distance of the grippers in metres: the sheet is not pulled taut.
        turn: Largest difference of their y in metres.
        lift: See ``floor``, in metres.
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
        """Lowest and highest poses, ``(2, 3)`` each."""
        return _mirrored(self.low, self.high)

    def allows(self, poses: Array) -> bool:
        """Return whether ``poses`` satisfy all limits but the floor, to within a micrometre."""
        way = poses[1] - poses[0]
        span = float(np.linalg.norm(way))
        in_reach = self.closest - 1e-6 <= span <= self.reach + 1e-6
        return _inside(poses, self.bounds) and in_reach and bool(abs(way[1]) <= self.turn + 1e-6)

    def clip(self, poses: Array, previous: Array) -> Array:
        """Return allowed poses near ``poses``, or ``previous``, which must be allowed, if there are none close by.

        If the grippers are too far apart, too close or too uneven, each is corrected by half.
        """
        low, high = self.bounds
        out = poses.copy()
        rise = np.minimum(self.floor(), previous[:, 2] + self.lift)
        out[:, 2] = np.maximum(out[:, 2], rise)
        for _ in range(4):  # a correction can partly undo the others
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


def gripper_spec(body: Body, workspace: Workspace, step: Array) -> ActionSpec:
    """Return the spec of actions that displace the grippers in the base frame.

    Args:
        body: The held object.
        workspace: Allowed poses.
        step: Motion of one gripper for an action of 1, shape ``(3,)``: x, y, z in metres, or yaw in radians.
    """
    axes, (low, high) = ("x", "y", "yaw") if isinstance(body, PlanarBody) else ("x", "y", "z"), workspace.bounds
    grippers = [f"gripper{i}" for i in range(len(low))]
    return ActionSpec(
        names=tuple(f"{gripper}/{axis}" for gripper in grippers for axis in axes),
        units=tuple("rad" if axis == "yaw" else "m" for _ in grippers for axis in axes),
        scale=tuple(float(value) for _ in grippers for value in step),
        low=tuple(low.ravel().tolist()),
        high=tuple(high.ravel().tolist()),
        mode="displacement",
        frame="base",
    )


def _mirrored(low: tuple[float, float, float], high: tuple[float, float, float]) -> tuple[Array, Array]:
    """Return the lowest and highest poses, ``(2, 3)`` each, of a box and its mirror image at x = 0."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    return np.array([[x0, y0, z0], [-x1, y0, z0]]), np.array([[x1, y1, z1], [-x0, y1, z1]])


def _inside(poses: Array, bounds: tuple[Array, Array]) -> bool:
    low, high = bounds
    return bool(np.all(poses >= low - 1e-6) and np.all(poses <= high + 1e-6))


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
