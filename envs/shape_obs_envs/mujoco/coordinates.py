"""Coordinates: what the actions of a simulated environment mean."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shape_obs.robot import ActionSpec
from shape_obs_envs.mujoco.bodies.base import Body, PlanarBody
from shape_obs_envs.mujoco.workspace import Workspace


def gripper_axes(body: Body) -> tuple[str, str, str]:
    """Names of the coordinates of a gripper's pose."""
    return ("x", "y", "yaw") if isinstance(body, PlanarBody) else ("x", "y", "z")


def gripper_spec(body: Body, workspace: Workspace, step: NDArray[np.float64]) -> ActionSpec:
    """Displacements of the grippers in the base frame.

    Args:
        body: What they hold.
        workspace: Where they may go.
        step: (3,) how far one of them moves with an action of 1, x, y, z [m] or yaw [rad].
    """
    axes, (low, high) = gripper_axes(body), workspace.bounds
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
