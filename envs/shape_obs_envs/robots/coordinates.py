"""Coordinates: what a simulated robot's actions mean, and whether something is one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from shape_obs.robot import ActionSpec, Array, RobotError

if TYPE_CHECKING:
    from shape_obs_envs.mujoco.stage import Stage


def action_spec(stage: Stage) -> ActionSpec:
    """Displacements of the grippers in the base frame; 1 is what it is in the environment."""
    low, high = stage.workspace.bounds
    grippers = [f"gripper{i}" for i in range(len(low))]
    return ActionSpec(
        names=tuple(f"{gripper}/{axis}" for gripper in grippers for axis in stage.axes),
        units=tuple("rad" if axis == "yaw" else "m" for _ in grippers for axis in stage.axes),
        scale=tuple(float(value) for _ in grippers for value in stage.step),
        low=tuple(low.ravel().tolist()),
        high=tuple(high.ravel().tolist()),
        mode="displacement",
        frame="base",
    )


def checked_motion(action: Array, spec: ActionSpec) -> Array:
    """A motion as an array of its own.

    Raises:
        RobotError: A wrong shape, or numbers that are not finite.
    """
    motion = np.array(action, np.float64)
    if motion.shape != (len(spec),) or not np.isfinite(motion).all():
        raise RobotError(
            f"Expected a motion of {len(spec)} finite numbers ({', '.join(spec.names)}), got {action!r}; the robot "
            "goes on with the last one."
        )
    return motion
