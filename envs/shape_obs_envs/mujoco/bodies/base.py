"""What the simulated objects share: a MuJoCo model with its state, held by grippers that are moved step by step."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.engine import mujoco
from shape_obs_envs.mujoco.rays import cast_rays

Array = NDArray[np.float64]

#: Geom group of the object, so that rays can be cast at it alone. Table and grippers are in group 0.
OBJECT_GROUP = 1
GRIPPERS = ("gripper0", "gripper1")
_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


@dataclass(frozen=True)
class MaterialFactors:
    """An object's material, as factors of what its model was written with.

    Attributes:
        thickness: Of its thickness; its length stays.
        stiffness: Of the stiffness of a bend.
        damping: Of the damping of a bend.
        friction: Of what the table does to it.
    """

    thickness: float = 1.0
    stiffness: float = 1.0
    damping: float = 1.0
    friction: float = 1.0


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
        self._state_size = mujoco.mj_stateSize(model, _STATE)

    @abc.abstractmethod
    def gripper_poses(self) -> Array:
        """Where the grippers hold the object, as measured: (G, 3), a row for each gripper."""

    @abc.abstractmethod
    def set_grippers(self, poses: Array) -> None:
        """Move the mocap bodies to `poses` (G, 3)."""

    @abc.abstractmethod
    def gripper_targets(self) -> Array:
        """Where the mocap bodies are: (G, 3), what `set_grippers` was last given."""

    @property
    @abc.abstractmethod
    def colour(self) -> tuple[float, float, float]:
        """Red, green and blue, 0 ... 1, that its model was written with."""

    @property
    @abc.abstractmethod
    def tone_shape(self) -> tuple[int, int]:
        """How many tones `paint` takes."""

    @property
    @abc.abstractmethod
    def underlay(self) -> float:
        """Height [m] of what may lie under it on the table without hiding any of it; 0 for nothing."""

    @abc.abstractmethod
    def landmarks(self) -> Array:
        """Points (n, 3) [m] by which its form is known: where they are all seen, no part of it looks like the whole."""

    @abc.abstractmethod
    def paint(self, rgb: Sequence[float], tones: NDArray[Any]) -> None:
        """Colour it `rgb`, 0 ... 1, brighter or darker by factors `tones` (tone_shape) from place to place."""

    @abc.abstractmethod
    def set_material(self, factors: MaterialFactors) -> None:
        """Make it of another material; it is to be placed anew after that."""

    def step_to(self, start: Array, target: Array, substeps: int) -> None:
        """Move the grippers from poses `start` to poses `target` in equal parts, one for each substep."""
        for i in range(1, substeps + 1):
            # A ramp: a jump of the target would pull at the grips with the whole step's length at once.
            self.set_grippers(start + (target - start) * (i / substeps))
            mujoco.mj_step(self.model, self.data)
        self.refresh()

    def refresh(self) -> None:
        """Bring the poses of bodies and geoms up to date: `mj_step` leaves them one substep behind."""
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)

    def get_state(self) -> Array:
        """The whole physics state (positions, velocities, mocap poses, warm start, time)."""
        state = np.empty(self._state_size)
        mujoco.mj_getState(self.model, self.data, state, _STATE)
        return state

    def set_state(self, state: Array) -> None:
        """Restore what `get_state` returned.

        Raises:
            ValueError: `state` is not one of this model.
        """
        if state.shape != (self._state_size,) or not np.isfinite(state).all():
            raise ValueError(
                f"expected a physics state, ({self._state_size},) finite numbers, got {state.shape}. "
                "Take it from `env.unwrapped.get_state()` of an environment made with the same arguments."
            )
        mujoco.mj_setState(self.model, self.data, state, _STATE)
        self.refresh()

    def seen(self, points: Array, eye: Array, reach: float) -> Array:
        """What a camera at `eye` (3,) sees of the object in the direction of `points` (n, 3); world frame, metres.

        Args:
            points: (n, 3) points in or on the object [m].
            eye: (3,) the camera's place [m].
            reach: How far before a point its own surface can be [m]; a hit further away is another part.

        Returns:
            (n, 3); where the line of sight misses or only grazes the object the point itself.
        """
        rays = points - eye
        distance = np.linalg.norm(rays, axis=1)
        rays /= distance[:, None]
        hit, _ = cast_rays(self.model, self.data, eye, rays, groups=(OBJECT_GROUP,))
        near = (hit >= 0) & (distance - hit < reach)
        return np.where(near[:, None], eye + rays * hit[:, None], points)


class PlanarBody(Body):
    """An object on the table, whose grippers move by x, y [m] and yaw [rad]."""

    def set_state(self, state: Array) -> None:
        """Restore what `get_state` returned; the grippers are at the height of the present thickness."""
        super().set_state(state)
        self.data.mocap_pos[self._grippers, 2] = self.model.body_pos[self._held_by, 2]

    def set_grippers(self, poses: Array) -> None:
        """Move the mocap bodies to `poses` (G, 3): x, y [m] and yaw [rad] in the world frame."""
        self.data.mocap_pos[self._grippers, :2] = poses[:, :2]
        self.data.mocap_quat[self._grippers, 0] = np.cos(poses[:, 2] / 2)
        self.data.mocap_quat[self._grippers, 3] = np.sin(poses[:, 2] / 2)

    def gripper_targets(self) -> Array:
        """Where the mocap bodies are: (G, 3) of x, y [m] and yaw [rad] in the world frame."""
        turn = self.data.mocap_quat[self._grippers]
        return np.column_stack([self.data.mocap_pos[self._grippers, :2], 2 * np.arctan2(turn[:, 3], turn[:, 0])])
