"""A sheet: the physics of a cloth that lies on a table and is held at two neighbouring corners.

Point masses on slides, joined by tendons (see sheet_model.py). The table is a lower limit of their heights; its
friction is damping that falls with speed, so that its force is nearly the same at all speeds. The two corners are
moved as they are told to. Nothing touches anything else: contacts are off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.bodies.base import GRIPPERS, Body, MaterialFactors
from shape_obs_envs.mujoco.bodies.sheet_mesh import SKIN, SheetMesh
from shape_obs_envs.mujoco.bodies.sheet_model import PRINT, SheetSpec, bending_tendons
from shape_obs_envs.mujoco.engine import mujoco
from shape_obs_envs.mujoco.scene import TIMESTEP

Array = NDArray[np.float64]

_CLEAR = 0.004  # height [m] above which a mass does not rub against the table


class Sheet(Body):
    """The sheet inside a compiled model: poses, surface, state and stepping. A gripper's pose is its x, y, z [m].

    Args:
        spec: What the model was written from.
        model: The compiled model.

    Attributes:
        nominal: What the model was written from.
        spec: The same of the present material.
        mesh: The surface, from which points are taken and which is drawn.
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
        """Where the held corners are: (2, 3) of x, y, z [m] in the world frame."""
        return self.data.qpos[self._dofs[self._held]] + self._rest[self._held]

    def gripper_targets(self) -> Array:
        """Where the mocap bodies are: (2, 3) of x, y, z [m] in the world frame."""
        return self.data.mocap_pos[self._grippers]

    def set_grippers(self, poses: Array) -> None:
        """Move the mocap bodies to `poses` (2, 3) [m], turned with the line between them."""
        way = poses[1] - poses[0]
        half = np.arctan2(way[1], way[0]) / 2
        self.data.mocap_pos[self._grippers] = poses
        self.data.mocap_quat[self._grippers] = np.cos(half), 0.0, 0.0, np.sin(half)

    def step_to(self, start: Array, target: Array, substeps: int) -> None:
        """Move the grippers from poses `start` to poses `target` (2, 3) in `substeps` times 0.01 s."""
        steps = round(substeps * TIMESTEP / self.spec.timestep)
        for i in range(1, steps + 1):
            self.set_grippers(start + (target - start) * (i / steps))
            self._hold()
            self._rub()
            mujoco.mj_step(self.model, self.data)
        self.refresh()

    @property
    def colour(self) -> tuple[float, float, float]:
        """Red, green and blue, 0 ... 1, that its model was written with."""
        return self.nominal.rgba[:3]

    @property
    def tone_shape(self) -> tuple[int, int]:
        """Texels of its print, down from the held edge and across from gripper 0's side."""
        return PRINT

    @property
    def underlay(self) -> float:
        """Half of what is under its surface."""
        return self.spec.lift / 2

    def landmarks(self) -> Array:
        """The four corners: (16, 3) [m], those of them and of the eighth of each side beside them; world frame."""
        near = np.array([0.0, 0.12, 0.88, 1.0])
        return self.points(near, near).reshape(-1, 3)

    def paint(self, rgb: Sequence[float], tones: NDArray[Any]) -> None:
        """Colour it `rgb`, 0 ... 1, darker by factors `tones` (64, 128), at most 1."""
        model = self.model
        model.skin_rgba[model.skin(SKIN).id, :3] = rgb
        start = int(model.tex_adr[model.texture(SKIN).id])
        texels = np.repeat(np.rint(255 * np.clip(tones, 0, 1)).astype(np.uint8), 3)
        model.tex_data[start : start + texels.size] = texels

    def set_material(self, factors: MaterialFactors) -> None:
        """Make it of another material; it is to be placed anew after that. It has no thickness to change."""
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
        """Put the sheet down flat and at rest.

        Args:
            middle: (2,) the middle of the held edge, x and y [m].
            turn: Heading of the held edge from corner 0 to corner 1 [rad].
        """
        mujoco.mj_resetData(self.model, self.data)
        along = np.array([np.cos(turn), np.sin(turn)])
        flat = self._rest[:, :2] - (0.0, self.spec.depth / 2)
        at = middle + flat[:, :1] * along + flat[:, 1:] * (-along[1], along[0])
        self.data.qpos[self._dofs[:, :2]] = at - self._rest[:, :2]
        self.refresh()
        self.set_grippers(self.gripper_poses())

    def vertices(self) -> Array:
        """The surface's fine vertices: (fine rows, fine cols, 3) [m] in the world frame."""
        return self.mesh.vertices(self.data)

    def points(self, down: Array, across: Array) -> Array:
        """Points of the surface: `down` (R,) from the held edge, `across` (C,) from gripper 0's side, in parts.

        Returns:
            (R, C, 3) [m] in the world frame.
        """
        return self.mesh.points(self.vertices(), down, across)

    def stretch(self) -> float:
        """The largest strain of an edge between neighbouring masses; 0.05 is five hundredths longer than at rest."""
        masses = self.mesh.masses(self.data)
        sides = (self.spec.depth / (self.spec.rows - 1), self.spec.width / (self.spec.cols - 1))
        lengths = [np.linalg.norm(np.diff(masses, axis=axis), axis=-1).max() for axis in (0, 1)]
        return max(float(length / side) - 1 for length, side in zip(lengths, sides, strict=True))

    def slack(self) -> Array:
        """(2,) how much nearer than the length of its side each held corner is to the free corner below it [m]."""
        masses = self.mesh.masses(self.data)
        sides = masses[0, [0, -1], :2] - masses[-1, [0, -1], :2]
        return np.maximum(self.spec.depth - np.linalg.norm(sides, axis=1), 0.0)

    # ---- inside

    def _hold(self) -> None:
        """Give the two corners the speed that brings them to the grippers in one timestep."""
        dofs = self._dofs[self._held]
        away = self.gripper_targets() - self.gripper_poses()
        self.data.qvel[dofs] = away / self.spec.timestep

    def _rub(self) -> None:
        """Set the damping along the table: the air's, and friction on what lies on it."""
        spec = self.spec
        velocity = self.data.qvel[self._dofs[:, :2]]
        speed = np.sqrt(np.einsum("ij,ij->i", velocity, velocity))
        lying = np.clip(1 - self.data.qpos[self._dofs[:, 2]] / _CLEAR, 0.0, 1.0)
        friction = spec.friction * spec.mass * spec.gravity * lying / (speed + spec.creep)
        self.model.dof_damping[self._dofs[:, :2]] = spec.drag + friction[:, None]
