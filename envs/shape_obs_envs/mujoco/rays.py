"""Rays into a MuJoCo scene, with one signature for every MuJoCo from 3.3 on."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.engine import mujoco

# The `normal` argument came with MuJoCo 3.5, in the middle of the list.
_NORMAL = (None,) if "normal:" in (mujoco.mj_multiRay.__doc__ or "") else ()
_CUTOFF = 10.0


def cast_rays(
    model: Any, data: Any, eye: NDArray[np.float64], directions: NDArray[np.float64], groups: tuple[int, ...] = ()
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Cast rays from one point and tell what each hits first.

    Args:
        model: The MuJoCo model.
        data: Its data, with up-to-date kinematics.
        eye: (3,) start of the rays [m], world frame.
        directions: (M, 3) unit vectors, world frame.
        groups: The geom groups that rays can hit; all if empty.

    Returns:
        Distances (M,) [m] and geom ids (M,); both -1 where a ray hits nothing.
    """
    n = len(directions)
    distances, geoms = np.full(n, -1.0), np.full(n, -1, np.int32)
    if n:
        mask = None
        if groups:
            mask = np.zeros(6, np.uint8)
            mask[list(groups)] = 1
        flat = np.ascontiguousarray(directions, np.float64).ravel()
        mujoco.mj_multiRay(model, data, eye, flat, mask, 1, -1, geoms, distances, *_NORMAL, n, _CUTOFF)
    return distances, geoms
