"""Which way the surfaces of geoms face."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.engine import mujoco

Array = NDArray[np.float64]


def normals(model: Any, data: Any, geoms: NDArray[np.int32], points: Array) -> Array:
    """Outward unit normals (M, 3) of `geoms` (M,) at `points` (M, 3) [m] of their surfaces, world frame."""
    rotation = data.geom_xmat[geoms].reshape(-1, 3, 3)
    local = np.einsum("mji,mj->mi", rotation, points - data.geom_xpos[geoms])
    size, kinds = model.geom_size[geoms], model.geom_type[geoms]
    out = np.empty_like(local)
    for kind in np.unique(kinds):
        here = kinds == kind
        out[here] = _OUTWARD[int(kind)](local[here], size[here])
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    return np.einsum("mij,mj->mi", rotation, out)


def _sphere(points: Array, size: Array) -> Array:
    return points


def _ellipsoid(points: Array, size: Array) -> Array:
    return points / size**2


def _capsule(points: Array, size: Array) -> Array:
    out = points.copy()
    out[:, 2] -= np.clip(points[:, 2], -size[:, 1], size[:, 1])
    return out


def _cylinder(points: Array, size: Array) -> Array:
    lid = size[:, 1] - np.abs(points[:, 2]) < size[:, 0] - np.hypot(points[:, 0], points[:, 1])
    return np.where(lid[:, None], points * (0.0, 0.0, 1.0), points * (1.0, 1.0, 0.0))


def _box(points: Array, size: Array) -> Array:
    rows, face = np.arange(len(points)), np.argmax(np.abs(points) / size, axis=1)
    out = np.zeros_like(points)
    out[rows, face] = np.sign(points[rows, face])
    return out


_OUTWARD: Final[dict[int, Callable[[Array, Array], Array]]] = {
    int(mujoco.mjtGeom.mjGEOM_SPHERE): _sphere,
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): _ellipsoid,
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): _capsule,
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): _cylinder,
    int(mujoco.mjtGeom.mjGEOM_BOX): _box,
}
