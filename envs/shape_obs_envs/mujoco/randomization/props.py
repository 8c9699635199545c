"""Things without physics that stand in a scene: geoms on mocap bodies, changed and moved while the model stays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from shape_obs_envs.mujoco.engine import mujoco

#: Geom kinds and how far a point of each can be from its middle, by its size.
_KINDS: Final[dict[str, Any]] = {
    "box": (mujoco.mjtGeom.mjGEOM_BOX, lambda s: np.linalg.norm(s)),
    "cylinder": (mujoco.mjtGeom.mjGEOM_CYLINDER, lambda s: np.hypot(s[0], s[1])),
    "capsule": (mujoco.mjtGeom.mjGEOM_CAPSULE, lambda s: s[0] + s[1]),
    "sphere": (mujoco.mjtGeom.mjGEOM_SPHERE, lambda s: s[0]),
    "ellipsoid": (mujoco.mjtGeom.mjGEOM_ELLIPSOID, lambda s: np.max(s)),
}


def prop(name: str, geoms: int, group: int = 0) -> str:
    """MJCF of a body `name` with unseen geoms `name0`, `name1`, ... that `shape` gives their form."""
    unseen = "".join(
        f'<geom name="{name}{i}" type="sphere" size="0.01" mass="0.001" group="{group}" rgba="0 0 0 0"/>'
        for i in range(geoms)
    )
    return f'<body name="{name}" mocap="true">{unseen}</body>'


def shape(model: Any, geom: int, kind: str, size: Sequence[float], pos: Any = (0, 0, 0), quat: Any = (1, 0, 0, 0)):
    """Give a prop's geom its form, its size [m] as MJCF has it, and its pose in its body."""
    number, bound = _KINDS[kind]
    model.geom_type[geom], model.geom_rbound[geom] = int(number), bound(size)
    model.geom_size[geom] = [*size, *(3 - len(size)) * [0.0]]
    model.geom_pos[geom], model.geom_quat[geom] = pos, quat
    # the compiler's shortcut: where a geom's frame was its body's, its own pose is not looked at
    model.geom_sameframe[geom] = 0


def colour(model: Any, geoms: Any, rgb: Sequence[float]) -> None:
    """Show props in a colour."""
    model.geom_rgba[geoms] = [*rgb, 1.0]


def hide(model: Any, geoms: Any) -> None:
    """Show props no more: neither camera draws what is wholly transparent."""
    model.geom_rgba[geoms, 3] = 0.0
