"""The ring environment: bring a closed elastic band on a table, held at two points, into a goal shape."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from shape_obs_envs.arguments import count
from shape_obs_envs.mujoco.bodies import GRIPPERS
from shape_obs_envs.mujoco.bodies.loop import Loop, LoopSpec, loop_bodies, loop_equality, loop_skin
from shape_obs_envs.mujoco.goal_env import SUBSTEPS, ShapeGoalEnv
from shape_obs_envs.mujoco.goals import measured_space
from shape_obs_envs.mujoco.workspace import TwoGripperWorkspace

Array = NDArray[np.float64]

#: Number of points of a goal.
POINTS = 32
_BLUE = {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]}
_WORKSPACE = TwoGripperWorkspace(low=(-0.22, -0.08), high=(-0.06, 0.1), yaw=0.6, closest=0.18, reach=0.33, lever=0.0)


class RingEnv(ShapeGoalEnv, EzPickle):
    """Bring a closed elastic band into a goal shape with two grippers; see docs/reference/envs/ring.md.

    Args:
        **options: Arguments of ``ShapeGoalEnv``.

    Raises:
        ValueError: An argument is out of its range.
    """

    STEP = np.array([0.012, 0.012, 0.1])  # x, y in metres and turn in radians
    REACH = ((-0.26, -0.26, 0.0), (0.26, 0.28, 0.01))

    def __init__(self, **options: Any) -> None:
        EzPickle.__init__(self, **options)
        ShapeGoalEnv.__init__(self, **options)
        spec = LoopSpec()
        # Less drag than the rope: it would pull the band open at its closing constraint.
        medium = '<option viscosity="0.5"/>'
        model = self._compile(loop_bodies(spec), loop_equality(spec), loop_skin(spec) + medium)
        self._loop = Loop(spec, model)
        self._loop.place(np.zeros(2), 0.0)
        low, high = _WORKSPACE.bounds
        low, high = low - 0.05, high + 0.05  # the welds are slightly compliant, and the edge is half a width away
        self._install(
            self._loop,
            _WORKSPACE,
            gym.spaces.Box(
                np.concatenate([[*pose[:2], 0.0, -1.0, -1.0] for pose in low]).astype(np.float32),
                np.concatenate([[*pose[:2], 0.1, 1.0, 1.0] for pose in high]).astype(np.float32),
                dtype=np.float32,
            ),
        )

    # ---- published

    @property
    def anchors(self) -> Mapping[str, tuple[float, float, float]]:
        """Where the band is held, on its outline: name -> (x, y, z) in metres, base frame; gripper0 is at point 0."""
        held = self._loop.held_points().tolist()
        return {name: (x, y, z) for name, (x, y, z) in zip(GRIPPERS, held, strict=True)}

    @property
    def goal_layout(self) -> dict[str, Any]:
        """Layout of the points of a goal: around the outline, clockwise as the camera sees it."""
        return {"kind": "contour"}

    @property
    def shape_obs_defaults(self) -> dict[str, Any]:
        """Suitable arguments of ``shape_obs.ShapeObservation`` for this environment."""
        return {
            "shapes": [
                {"kind": "contour", "n": POINTS, "anchor": "gripper0", "order": "image", "spacing": "m", "ring": True}
            ],
            "segmentation": self._randomizer.segmentation(_BLUE),
            "features": [{"kind": "points3d", "frame": "base"}],
            "workspace": measured_space(self.BOUNDS),
        }

    def truth(self, n: int = POINTS, frame: str = "world") -> Array:
        """Return true points of the outline, the band's upper outer edge, without rendering.

        Args:
            n: Number of points, at least 3, equidistant along the outline, clockwise from gripper 0.
            frame: "world" (the base frame, metres), "camera" (optical frame, metres) or "pixels" (u right, v down).

        Returns:
            Points of shape ``(n, 3)``, or pixels of shape ``(n, 2)``.

        Raises:
            ValueError: An argument is out of its range.
        """
        return self._in_frame(self._loop.points(count("n", n, 3)), frame)

    # ---- ShapeGoalEnv

    def _goal_points(self) -> Array:
        return self._loop.points(POINTS)

    def _gripper(self) -> NDArray[np.float32]:
        turn = self._loop.gripper_poses()[:, 2]
        return np.column_stack([self._loop.held_points(), np.cos(turn), np.sin(turn)]).astype(np.float32).ravel()

    def _draw_start(self) -> Array:
        low, high = self._workspace.bounds
        turn, middle = self.np_random.uniform(-0.3, 0.3), self.np_random.uniform(-0.04, 0.04, 2)
        self._loop.place(middle, turn)
        circle = self._loop.gripper_poses()
        poses = self._workspace.clip(self.np_random.uniform(low, high) * 0.5 + circle * 0.5, circle)
        self._loop.step_to(circle, poses, 10 * SUBSTEPS)
        self._loop.step_to(poses, poses, 8 * SUBSTEPS)
        return poses

    def _draw_bend(self) -> Array:
        """Draw both grippers turned strongly the same way, and pulled apart or pushed together."""
        low, high = self._workspace.bounds
        turn = self.np_random.choice([-1.0, 1.0]) * self.np_random.uniform(0.7, 1.0)
        half = self.np_random.choice([0.092, 0.155]) + self.np_random.uniform(-0.002, 0.008)
        middle = self.np_random.uniform([-0.04, low[0, 1]], [0.04, high[0, 1]])
        poses = np.array([[*middle, turn * high[0, 2]]] * 2)
        poses[:, 0] += [-half, half]
        return self._workspace.clip(poses, self._target)
