"""Deformable objects: a MuJoCo model with its state and true shape, held by grippers that move step by step."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.scene import TIMESTEP, cast_rays, mujoco

Array = NDArray[np.float64]

#: Geom group of the object, so that rays can be cast at it alone. Table and grippers are in group 0.
OBJECT_GROUP = 1
GRIPPERS = ("gripper0", "gripper1")
_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


@dataclass(frozen=True)
class MaterialFactors:
    """An object's material, as factors of the nominal values in its model.

    Attributes:
        thickness: Factor of its thickness; its length from end to end stays.
        stiffness: Factor of its bending stiffness.
        damping: Factor of its bending damping.
        friction: Factor of its friction on the table, or of its drag in the air.
        length: Factor of its length; ignored by objects on the table.
    """

    thickness: float = 1.0
    stiffness: float = 1.0
    damping: float = 1.0
    friction: float = 1.0
    length: float = 1.0


class Body(abc.ABC):
    """A deformable object inside a compiled model: its state, its grippers and stepping.

    Args:
        model: The compiled model.
        grippers: Names of the mocap bodies that hold the object.
    """

    def __init__(self, model: Any, grippers: Sequence[str]) -> None:
        self.model = model
        self.data = mujoco.MjData(model)
        self._grippers = np.array([int(model.body(name).mocapid[0]) for name in grippers])
        self._held_by = np.array([model.body(name).id for name in grippers])
        self._viscosity = float(model.opt.viscosity)
        self._state_size = mujoco.mj_stateSize(model, _STATE)

    @abc.abstractmethod
    def gripper_poses(self) -> Array:
        """Return the measured poses ``(G, 3)`` at which the grippers hold the object."""

    @abc.abstractmethod
    def set_grippers(self, poses: Array) -> None:
        """Move the mocap bodies to ``poses`` ``(G, 3)``."""

    @abc.abstractmethod
    def gripper_targets(self) -> Array:
        """Return the poses ``(G, 3)`` of the mocap bodies, as last set by ``set_grippers``."""

    @property
    @abc.abstractmethod
    def colour(self) -> tuple[float, float, float]:
        """Nominal red, green and blue, 0 ... 1."""

    @property
    @abc.abstractmethod
    def tone_shape(self) -> tuple[int, int]:
        """Shape of the tones for ``set_colours``."""

    @property
    @abc.abstractmethod
    def underlay(self) -> float:
        """Largest height in metres of an object under it on the table that does not hide any of it; 0 for none."""

    @abc.abstractmethod
    def landmarks(self) -> Array:
        """Return points ``(n, 3)`` in metres of its landmarks: if all are visible, no part looks like the whole."""

    @abc.abstractmethod
    def set_colours(self, rgb: Sequence[float], tones: NDArray[Any]) -> None:
        """Set its colour to ``rgb``, 0 ... 1, times the factors ``tones`` of shape ``tone_shape``."""

    @abc.abstractmethod
    def set_material(self, factors: MaterialFactors) -> None:
        """Change its material; it must be placed again after that."""

    def step_to(self, start: Array, target: Array, substeps: int) -> None:
        """Move the grippers from poses ``start`` to poses ``target`` in equal parts, in ``substeps`` times 0.01 s."""
        steps = round(substeps * TIMESTEP / self.timestep)
        for i in range(1, steps + 1):
            # A ramp: a jump of the target would pull at the welds with the whole step's length at once.
            self.advance(start + (target - start) * (i / steps))
        self.refresh()

    @property
    def timestep(self) -> float:
        """Duration of a step of the physics in seconds."""
        return float(self.model.opt.timestep)

    def advance(self, poses: Array) -> None:
        """Move the grippers to ``poses`` and advance the physics by one step; ``refresh`` must follow."""
        self.set_grippers(poses)
        mujoco.mj_step(self.model, self.data)

    def refresh(self) -> None:
        """Update the poses of bodies and geoms, which ``mj_step`` leaves one substep behind."""
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)

    def get_state(self) -> Array:
        """Return the physics state (positions, velocities, mocap poses, warm start, time)."""
        state = np.empty(self._state_size)
        mujoco.mj_getState(self.model, self.data, state, _STATE)
        return state

    def set_state(self, state: Array) -> None:
        """Restore a result of ``get_state``.

        Raises:
            ValueError: ``state`` is not a state of this model.
        """
        if state.shape != (self._state_size,) or not np.isfinite(state).all():
            raise ValueError(
                f"expected a physics state, ({self._state_size},) finite numbers, got {state.shape}. "
                "Take it from `env.unwrapped.get_state()` of an environment made with the same arguments."
            )
        mujoco.mj_setState(self.model, self.data, state, _STATE)
        self.refresh()

    def _set_bending(self, joints: slice, stiffness: float, damping: float, factors: MaterialFactors) -> None:
        """Set the hinges between links, and the viscosity of the medium, to factors of their nominal values."""
        self.model.jnt_stiffness[joints] = stiffness * factors.stiffness
        self.model.dof_damping[self.model.jnt_dofadr[joints]] = damping * factors.damping
        self.model.opt.viscosity = self._viscosity * factors.friction

    def visible_surface(self, points: Array, eye: Array, reach: float) -> Array:
        """Return the object's surface in the line of sight of a camera to each point; world frame, metres.

        Args:
            points: Points ``(n, 3)`` in or on the object.
            eye: Position ``(3,)`` of the camera.
            reach: Largest distance from a point to the surface before it; a hit further away is another part.

        Returns:
            Points ``(n, 3)``; the given point if the line of sight misses or only grazes the object.
        """
        rays = points - eye
        distance = np.linalg.norm(rays, axis=1)
        rays /= distance[:, None]
        hit, _ = cast_rays(self.model, self.data, eye, rays, groups=(OBJECT_GROUP,))
        near = (hit >= 0) & (distance - hit < reach)
        return np.where(near[:, None], eye + rays * hit[:, None], points)


class PlanarBody(Body):
    """An object on the table, whose grippers move in x, y (metres) and yaw (radians).

    Args:
        model: The compiled model; the viscosity of its medium stands for the friction on the table.
        grippers: Names of the mocap bodies that hold the object.
    """

    def set_state(self, state: Array) -> None:
        """Restore a result of ``get_state``, with the grippers at the height of the present thickness."""
        super().set_state(state)
        self.data.mocap_pos[self._grippers, 2] = self.model.body_pos[self._held_by, 2]

    def set_grippers(self, poses: Array) -> None:
        """Move the mocap bodies to ``poses`` ``(G, 3)``: x, y in metres and yaw in radians, world frame."""
        self.data.mocap_pos[self._grippers, :2] = poses[:, :2]
        self.data.mocap_quat[self._grippers, 0] = np.cos(poses[:, 2] / 2)
        self.data.mocap_quat[self._grippers, 3] = np.sin(poses[:, 2] / 2)

    def gripper_targets(self) -> Array:
        """Return the poses ``(G, 3)`` of the mocap bodies: x, y in metres and yaw in radians, world frame."""
        turn = self.data.mocap_quat[self._grippers]
        return np.column_stack([self.data.mocap_pos[self._grippers, :2], 2 * np.arctan2(turn[:, 3], turn[:, 0])])
