"""A sheet: the physics of a cloth that lies on a table and is held at two neighbouring corners.

The sheet consists of point masses on slides, connected by tendons (see sheet_model.py). The table is a lower limit of
their heights; its friction is a damping that decreases with speed, so that the force is nearly the same at all speeds.
The motion of the two corners is prescribed. Contacts are off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.bodies import GRIPPERS, Body, MaterialFactors
from shape_obs_envs.mujoco.bodies.sheet_mesh import SKIN, SheetMesh
from shape_obs_envs.mujoco.bodies.sheet_model import PRINT, SheetSpec, bending_tendons
from shape_obs_envs.mujoco.scene import mujoco

Array = NDArray[np.float64]

_CLEAR = 0.004  # height in metres above which a mass has no friction on the table


class Sheet(Body):
    """The sheet in a compiled model: poses, surface, state and stepping. A gripper's pose is x, y, z in metres.

    Args:
        spec: Nominal size and material, from which the model was compiled.
        model: The compiled model.

    Attributes:
        nominal: Nominal size and material.
        spec: Size and present material.
        mesh: The surface, for points and for rendering.
    """

    def __init__(self, spec: SheetSpec, model: Any) -> None:
        super().__init__(model, GRIPPERS)
        self.nominal = self.spec = spec
        self.mesh = SheetMesh(model)
        bodies = [model.body(f"mass{i}_{j}").id for j in range(spec.cols) for i in range(spec.rows)]
        self._rest = model.body_pos[bodies].copy()
        self._dofs = np.arange(3 * len(bodies)).reshape(-1, 3)
        self._held = np.array([0, len(bodies) - spec.rows])

    # ---- Body

    def gripper_poses(self) -> Array:
        """Return the positions ``(2, 3)`` of the held corners in metres, world frame."""
        return self.data.qpos[self._dofs[self._held]] + self._rest[self._held]

    def gripper_targets(self) -> Array:
        """Return the positions ``(2, 3)`` of the mocap bodies in metres, world frame."""
        return self.data.mocap_pos[self._grippers]

    def set_grippers(self, poses: Array) -> None:
        """Move the mocap bodies to ``poses`` ``(2, 3)``, rotated with the line between them."""
        way = poses[1] - poses[0]
        half = np.arctan2(way[1], way[0]) / 2
        self.data.mocap_pos[self._grippers] = poses
        self.data.mocap_quat[self._grippers] = np.cos(half), 0.0, 0.0, np.sin(half)

    def advance(self, poses: Array) -> None:
        """Move the grippers to ``poses`` and advance the physics by one step; ``refresh`` must follow."""
        self.set_grippers(poses)
        self._move_corners()
        self._set_friction()
        mujoco.mj_step(self.model, self.data)

    @property
    def colour(self) -> tuple[float, float, float]:
        """Nominal red, green and blue, 0 ... 1."""
        return self.nominal.rgba[:3]

    @property
    def tone_shape(self) -> tuple[int, int]:
        """Texels of its texture, down from the held edge and across from gripper 0's side."""
        return PRINT

    @property
    def underlay(self) -> float:
        """Half the height of its surface, in metres."""
        return self.spec.lift / 2

    def landmarks(self) -> Array:
        """Return points ``(16, 3)`` at and near the four corners, in metres, world frame."""
        near = np.array([0.0, 0.12, 0.88, 1.0])
        return self.points(near, near).reshape(-1, 3)

    def set_colours(self, rgb: Sequence[float], tones: NDArray[Any]) -> None:
        """Set its colour to ``rgb``, 0 ... 1, times the factors ``tones`` ``(64, 128)``, at most 1."""
        model = self.model
        model.skin_rgba[model.skin(SKIN).id, :3] = rgb
        start = int(model.tex_adr[model.texture(SKIN).id])
        texels = np.repeat(np.rint(255 * np.clip(tones, 0, 1)).astype(np.uint8), 3)
        model.tex_data[start : start + texels.size] = texels

    def set_material(self, factors: MaterialFactors) -> None:
        """Change its material; it must be placed again after that. The thickness is ignored."""
        model, nominal = self.model, self.nominal
        self.spec = replace(
            nominal,
            bending=nominal.bending * factors.stiffness,
            damping=nominal.damping * factors.damping,
            friction=nominal.friction * factors.friction,
        )
        model.tendon_stiffness[-bending_tendons(nominal) :] = self.spec.bending
        model.tendon_damping[:] = self.spec.damping

    # ---- shape

    def lay(self, middle: Array, turn: float) -> None:
        """Place the sheet flat and at rest.

        Args:
            middle: Middle of the held edge, x and y in metres.
            turn: Heading of the held edge from corner 0 to corner 1 in radians.
        """
        mujoco.mj_resetData(self.model, self.data)
        along = np.array([np.cos(turn), np.sin(turn)])
        flat = self._rest[:, :2] - (0.0, self.spec.depth / 2)
        at = middle + flat[:, :1] * along + flat[:, 1:] * (-along[1], along[0])
        self.data.qpos[self._dofs[:, :2]] = at - self._rest[:, :2]
        self.refresh()
        self.set_grippers(self.gripper_poses())

    def vertices(self) -> Array:
        """Return the surface's fine vertices ``(fine rows, fine cols, 3)`` in metres, world frame."""
        return self.mesh.vertices(self.data)

    def points(self, down: Array, across: Array) -> Array:
        """Return points ``(R, C, 3)`` of the surface in metres, world frame; see ``SheetMesh.points``."""
        return self.mesh.points(self.vertices(), down, across)

    def stretch(self) -> float:
        """Return the largest strain of an edge between neighbouring masses; 0.05 is 5 % longer than at rest."""
        masses = self.mesh.masses(self.data)
        sides = (self.spec.depth / (self.spec.rows - 1), self.spec.width / (self.spec.cols - 1))
        lengths = [np.linalg.norm(np.diff(masses, axis=axis), axis=-1).max() for axis in (0, 1)]
        return max(float(length / side) - 1 for length, side in zip(lengths, sides, strict=True))

    def slack(self) -> Array:
        """Return how much nearer each held corner is to its free corner than the side's length, ``(2,)``, in metres."""
        masses = self.mesh.masses(self.data)
        sides = masses[0, [0, -1], :2] - masses[-1, [0, -1], :2]
        return np.maximum(self.spec.depth - np.linalg.norm(sides, axis=1), 0.0)

    # ---- internal

    def _move_corners(self) -> None:
        """Set the velocities of the two corners so that they reach the grippers in one timestep."""
        dofs = self._dofs[self._held]
        away = self.gripper_targets() - self.gripper_poses()
        self.data.qvel[dofs] = away / self.spec.timestep

    def _set_friction(self) -> None:
        """Set the horizontal damping: drag of the air, and friction of the masses on the table."""
        spec = self.spec
        velocity = self.data.qvel[self._dofs[:, :2]]
        speed = np.sqrt(np.einsum("ij,ij->i", velocity, velocity))
        lying = np.clip(1 - self.data.qpos[self._dofs[:, 2]] / _CLEAR, 0.0, 1.0)
        friction = spec.friction * spec.mass * spec.gravity * lying / (speed + spec.creep)
        self.model.dof_damping[self._dofs[:, :2]] = spec.drag + friction[:, None]
