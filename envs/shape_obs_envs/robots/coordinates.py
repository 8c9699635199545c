"""Coordinates: whether something is a motion of a robot."""

from __future__ import annotations

import numpy as np

from shape_obs.robot import ActionSpec, Array, RobotError


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
