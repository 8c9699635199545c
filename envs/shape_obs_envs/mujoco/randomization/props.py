"""Geoms without physics, on mocap bodies, whose form and place change in the compiled model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from shape_obs_envs.mujoco.scene import mujoco

#: Geom types, and their bounding radius as a function of their size.
_GEOMS: Final[dict[str, Any]] = {
    "box": (mujoco.mjtGeom.mjGEOM_BOX, lambda s: np.linalg.norm(s)),
    "cylinder": (mujoco.mjtGeom.mjGEOM_CYLINDER, lambda s: np.hypot(s[0], s[1])),
    "capsule": (mujoco.mjtGeom.mjGEOM_CAPSULE, lambda s: s[0] + s[1]),
    "sphere": (mujoco.mjtGeom.mjGEOM_SPHERE, lambda s: s[0]),
    "ellipsoid": (mujoco.mjtGeom.mjGEOM_ELLIPSOID, lambda s: np.max(s)),
}


def prop_body(name: str, geoms: int, group: int = 0) -> str:
    """Return MJCF of a body ``name`` with invisible geoms ``name0``, ``name1``, ... for ``set_form``."""
    invisible = "".join(
        f'<geom name="{name}{i}" type="sphere" size="0.01" mass="0.001" group="{group}" rgba="0 0 0 0"/>'
        for i in range(geoms)
    )
    return f'<body name="{name}" mocap="true">{invisible}</body>'


def set_form(
    model: Any, geom: int, kind: str, size: Sequence[float], pos: Any = (0, 0, 0), quat: Any = (1, 0, 0, 0)
) -> None:
    """Set type, size (in metres, as in MJCF) and pose in its body of a geom."""
    number, bound = _GEOMS[kind]
    model.geom_type[geom], model.geom_rbound[geom] = int(number), bound(size)
    model.geom_size[geom] = [*size, *(3 - len(size)) * [0.0]]
    model.geom_pos[geom], model.geom_quat[geom] = pos, quat
    # disable the compiler's shortcut, which ignores the pose of a geom whose frame was its body's
    model.geom_sameframe[geom] = 0


def show(model: Any, geoms: Any, rgb: Sequence[float]) -> None:
    """Show geoms in a colour."""
    model.geom_rgba[geoms] = [*rgb, 1.0]


def hide(model: Any, geoms: Any) -> None:
    """Hide geoms: neither camera draws what is fully transparent."""
    model.geom_rgba[geoms, 3] = 0.0
