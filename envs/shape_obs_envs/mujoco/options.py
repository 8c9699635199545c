"""The options of a reset: a start state and a goal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import Space
from numpy.typing import NDArray

from shape_obs_envs.arguments import one_of

#: Every point of the object stays within these, base frame [m].
POINTS_LOW, POINTS_HIGH = (-0.4, -0.4, 0.0), (0.4, 0.4, 0.1)


def read_options(options: Mapping[str, Any], goals: Space[Any]) -> dict[str, Any]:
    """Start (float64) and goal (float32, flat) as new arrays, None where not given.

    Args:
        options: What `reset` was given.
        goals: The space of goals.

    Raises:
        ValueError: Another option, or a goal that is none.
    """
    for key in options:
        one_of("options", key, ("start", "goal"))
    out: dict[str, Any] = {"start": None, "goal": None}
    if options.get("start") is not None:
        out["start"] = np.asarray(options["start"], np.float64)
    if options.get("goal") is not None:
        goal: NDArray[np.float32] = np.asarray(options["goal"], np.float32)
        size = int(np.prod(goals.shape or ()))
        if goal.size != size or not goals.contains(goal.ravel()):
            raise ValueError(
                f"options['goal']: expected {size // 3} points (x, y, z) [m] in the base frame within "
                f"{POINTS_LOW} ... {POINTS_HIGH}, got an array of shape {goal.shape}: {goal.ravel()[:6]} ..."
            )
        out["goal"] = goal.ravel().copy()
    return out
