"""Limit the actions that are sent to a robot: clipping, a largest step, and a workspace box."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.robot import ActionSpec, Array

Box = tuple[Sequence[float], Sequence[float]]


class Guarded(NamedTuple):
    """A motion within the limits.

    Attributes:
        motion: ``(A,)`` in physical units.
        clipped: Whether the action was outside -1 ... 1.
        capped: Whether the step was longer than allowed.
        boxed: Whether the step would have left the workspace.
    """

    motion: Array
    clipped: bool
    capped: bool
    boxed: bool


class Guard:
    """Convert actions to motions that do not exceed the largest step and do not leave the workspace.

    Args:
        spec: The meaning of actions.
        max_step: (A,) largest change of each coordinate in one step, in physical units. None means ``spec.scale`` for
            displacements, ``spec.scale * dt`` for velocities, and no limit for positions.
        workspace: (low, high), each ``(A,)``: a smaller box than the robot's own, in physical units.
        dt: Seconds per step.

    Raises:
        ValueError: A length is wrong, a number is not positive, or the box does not overlap the robot's own.
    """

    def __init__(
        self,
        spec: ActionSpec,
        max_step: Sequence[float] | None = None,
        workspace: Box | None = None,
        dt: float = 1 / 30,
    ) -> None:
        self.spec, self.dt = spec, dt
        rate = {"displacement": 1.0, "velocity": dt, "position": np.inf}[spec.mode]
        self.max_step = np.asarray(spec.scale) * rate if max_step is None else _checked("max_step", max_step, spec)
        if not np.all(self.max_step > 0):
            raise ValueError(f"max_step: expected positive numbers, got {list(self.max_step)}.")
        low, high = np.asarray(spec.low), np.asarray(spec.high)
        if workspace is not None:
            narrow_low, narrow_high = (_checked("workspace", corner, spec) for corner in workspace)
            low, high = np.maximum(low, narrow_low), np.minimum(high, narrow_high)
        if not np.all(low < high):
            i = int(np.argmin(high - low))
            raise ValueError(
                f"workspace: nothing is left of {spec.names[i]!r}, which the robot can move within "
                f"{spec.low[i]:g} ... {spec.high[i]:g} {spec.units[i]}; expected low < high, and an overlap."
            )
        self.low, self.high = low, high

    def motion(self, action: npt.ArrayLike, state: npt.ArrayLike) -> Guarded:
        """Return the motion of an action within the limits.

        Args:
            action: ``(A,)`` in -1 ... 1.
            state: ``(A,)`` commanded state of the robot, in physical units.

        Raises:
            ValueError: A shape is wrong, or a number is not finite.
        """
        spec = self.spec
        action, state = np.asarray(action, np.float64), np.asarray(state, np.float64)
        for name, value in (("action", action), ("state", state)):
            if value.shape != (len(spec),) or not np.isfinite(value).all():
                raise ValueError(f"{name}: expected {len(spec)} finite numbers, {', '.join(spec.names)}; got {value}.")
        within = np.clip(action, -1.0, 1.0)
        step = spec.following(state, spec.physical(within), self.dt) - state
        short = np.clip(step, -self.max_step, self.max_step)
        # From outside the box, every step that does not lead further out is allowed.
        target = np.clip(state + short, np.minimum(self.low, state), np.maximum(self.high, state))
        return Guarded(
            spec.leading(state, target, self.dt),
            clipped=not np.array_equal(within, action),
            capped=not np.allclose(short, step, rtol=0, atol=1e-12),
            boxed=not np.allclose(target, state + short, rtol=0, atol=1e-12),
        )


def _checked(name: str, values: Sequence[float], spec: ActionSpec) -> Array:
    array = np.asarray(values, np.float64)
    if array.shape != (len(spec),) or np.isnan(array).any():
        raise ValueError(f"{name}: expected {len(spec)} numbers, one for each of {list(spec.names)}, got {values}.")
    return array
