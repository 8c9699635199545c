"""The camera's pose: nearer or farther, tilted, turned and aimed otherwise, with the whole workspace in view."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.engine import mujoco
from shape_obs_envs.mujoco.randomization.factor import Factor, Scene
from shape_obs_envs.mujoco.scene import CAMERA

Array = NDArray[np.float64]
#: What the camera may come back by at most, in parts of its distance, to see the whole workspace.
_FARTHEST: Final = 1.4
_RIM: Final = 0.01  # of the image's half, that the workspace keeps from its edge


@dataclass(frozen=True)
class Pose(Factor):
    """How the camera's pose varies. After that it comes back as far as it takes to see the whole workspace.

    Attributes:
        distance: Largest part by which it stands nearer or farther.
        tilt: Largest change of the angle between its axis and the vertical [rad].
        turn: Largest turn about the vertical through its aim [rad].
        roll: Largest turn about its own axis [rad].
        aim: Largest shift of the point on the table that it looks at, along x and along y [m].
    """

    distance: float = 0.08
    tilt: float = 0.12
    turn: float = 0.2
    roll: float = 0.05
    aim: float = 0.025

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check(distance=(0, 0.3), tilt=(0, 0.4), turn=(0, np.pi), roll=(0, 0.5), aim=(0, 0.1))

    def apply(self, rng: np.random.Generator, scene: Scene) -> dict[str, Any]:
        """Draw a pose and put the camera there."""
        spec, model = scene.camera, scene.model
        distance = spec.distance * (1 + self.distance * rng.uniform(-1, 1))
        tilt = spec.tilt + self.tilt * rng.uniform(-1, 1)
        turn, roll = self.turn * rng.uniform(-1, 1), self.roll * rng.uniform(-1, 1)
        aim = np.array([*(self.aim * rng.uniform(-1, 1, 2)), 0.0])
        axes = _about(2, turn) @ _about(0, tilt) @ _about(2, roll)
        half = np.array([spec.width, spec.height]) / 2 / spec.intrinsics.fx * (1 - _RIM)
        distance = min(max(distance, _least_distance(axes, _corners(scene) - aim, half)), _FARTHEST * spec.distance)
        index, quaternion = model.camera(CAMERA).id, np.empty(4)
        mujoco.mju_mat2Quat(quaternion, axes.ravel())
        model.cam_pos[index], model.cam_quat[index] = aim + distance * axes[:, 2], quaternion
        scene.body.refresh()
        return {"distance": float(distance), "tilt": tilt, "turn": turn, "roll": roll, "aim": aim[:2].tolist()}


def _least_distance(axes: Array, points: Array, half: Array) -> float:
    """The least distance from which a camera that looks at the origin along -z of `axes` (3, 3) sees all of `points`.

    Args:
        axes: Columns: to the right, up and backwards of the camera.
        points: (n, 3) [m].
        half: (2,) tangents of half the fields of view, across and up.
    """
    local = points @ axes
    # |x| <= half * (distance - z), and likewise y
    return float((np.abs(local[:, :2]) / half + local[:, 2:]).max())


def _corners(scene: Scene) -> Array:
    """The eight corners (8, 3) [m] of the box that the object never leaves."""
    return np.array(np.meshgrid(*zip(*scene.reach, strict=True))).reshape(3, -1).T


def _about(axis: int, angle: float) -> Array:
    """Rotation (3, 3) about a coordinate axis."""
    one, two = (axis + 1) % 3, (axis + 2) % 3
    out = np.eye(3)
    out[one, one] = out[two, two] = np.cos(angle)
    out[one, two], out[two, one] = -np.sin(angle), np.sin(angle)
    return out
