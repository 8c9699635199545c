"""The cable environment: bring a rope on a table into a goal shape with two grippers or one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from shape_obs_envs.arguments import count
from shape_obs_envs.mujoco.bodies import GRIPPERS
from shape_obs_envs.mujoco.bodies.chain import Chain, ChainSpec, Rope, chain_bodies, chain_equality, chain_skin
from shape_obs_envs.mujoco.goal_env import SUBSTEPS, ShapeGoalEnv, even_fractions
from shape_obs_envs.mujoco.goals import Corner, measured_space
from shape_obs_envs.mujoco.workspace import BoxWorkspace, TwoGripperWorkspace

Array = NDArray[np.float64]

#: Number of points of a goal.
POINTS = 20
_BLUE = {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]}
_TWO = ChainSpec(), TwoGripperWorkspace()
# Shorter, so that the free end stays in view in every direction, and without stiffness, so that it keeps its bends.
_ONE = (
    ChainSpec(length=0.4, links=26, stiffness=0.0, damping=0.03, grippers=1),
    BoxWorkspace(low=((-0.26, -0.1, -0.5),), high=((-0.1, 0.1, 0.5),)),
)


class RopeEnv(ShapeGoalEnv, EzPickle):
    """Base of the environments with a rope: what they publish, and their goals of 20 points along the rope."""

    _rope: Rope

    @property
    def anchors(self) -> Mapping[str, tuple[float, float, float]]:
        """The ``(x, y, z)`` of each gripper by its name, in metres in the base frame; gripper0 holds end 0."""
        tips = self._rope.vertices()[[0, -1]][: self._rope.spec.grippers].tolist()
        return {name: (x, y, z) for name, (x, y, z) in zip(GRIPPERS, tips, strict=False)}

    @property
    def goal_layout(self) -> dict[str, Any]:
        """Layout of the points of a goal, along the rope from end 0."""
        return {"kind": "centerline"}

    @property
    def shape_obs_defaults(self) -> dict[str, Any]:
        """Suitable arguments of ``shape_obs.ShapeObservation`` for this environment."""
        return {
            "shapes": [
                {
                    "kind": "centerline",
                    "n": POINTS,
                    "anchor": "gripper0",
                    "ends": "tips",
                    "spacing": "m",
                    "radius": self._rope.nominal.radius,
                }
            ],
            "segmentation": self._randomizer.segmentation(_BLUE),
            "features": [{"kind": "points3d", "frame": "base"}],
            "workspace": measured_space(self.BOUNDS),
        }

    def truth(self, n: int = POINTS, frame: str = "world", ends: str = "tips", surface: bool = False) -> Array:
        """Return true points of the rope, equidistant by arc length from end 0 to end 1, without rendering.

        Args:
            n: Number of points, at least 2.
            frame: "world" (the base frame, metres), "camera" (optical frame, metres) or "pixels" (u right, v down).
            ends: "tips": point i at i / (n - 1) of the length, first and last on the tips. "centers": at
                (i + 0.5) / n, in the middle of n equal parts.
            surface: Return the rope's surface in the camera's line of sight to each point, not its axis.

        Returns:
            Points of shape ``(n, 3)``, or pixels of shape ``(n, 2)``.

        Raises:
            ValueError: An argument is out of its range.
        """
        points = self._rope.points(even_fractions(count("n", n, 2), ends))
        if surface:
            points = self._rope.visible_surface(points, self._eye, 3 * self._rope.spec.radius)
        return self._in_frame(points, frame)

    def _goal_points(self) -> Array:
        return self._rope.points(np.linspace(0, 1, POINTS))


class CableEnv(RopeEnv):
    """Bring a rope into a goal shape with two grippers or one; see docs/reference/envs/cable.md.

    Args:
        grippers: 2 to hold both ends, 1 to hold end 0 of a shorter rope.
        **options: Arguments of ``ShapeGoalEnv``.

    Raises:
        ValueError: An argument is out of its range.
    """

    STEP: Array = np.array([0.015, 0.015, 0.12])  # x, y in metres and yaw in radians
    REACH: ClassVar[tuple[Corner, Corner]] = ((-0.285, -0.27, 0.0), (0.285, 0.32, 0.02))

    def __init__(self, grippers: int = 2, **options: Any) -> None:
        EzPickle.__init__(self, grippers, **options)
        ShapeGoalEnv.__init__(self, **options)
        spec, workspace = {1: _ONE, 2: _TWO}[count("grippers", grippers, 1, 2)]
        model = self._compile(chain_bodies(spec), chain_equality(spec), chain_skin(spec))
        self._rope = self._chain = Chain(spec, model)
        low, high = workspace.bounds
        low, high = low - 0.05, high + 0.05  # the welds are slightly compliant
        self._install(
            self._chain,
            workspace,
            gym.spaces.Box(
                np.concatenate([[*pose[:2], 0.0, -1.0, -1.0] for pose in low]).astype(np.float32),
                np.concatenate([[*pose[:2], 0.1, 1.0, 1.0] for pose in high]).astype(np.float32),
                dtype=np.float32,
            ),
        )

    # ---- ShapeGoalEnv

    def _gripper(self) -> NDArray[np.float32]:
        poses = self._chain.gripper_poses()
        held, yaw = self._chain.vertices()[[0, -1]][: len(poses)], poses[:, 2]
        return np.column_stack([held, np.cos(yaw), np.sin(yaw)]).astype(np.float32).ravel()

    def _draw_start(self) -> Array:
        headings, poses = self._draw_bow()
        self._chain.place(poses[0, :2], headings)
        # The rope settles in a bow slightly different from the drawn one.
        self._chain.step_to(poses, poses, 4 * SUBSTEPS)
        return poses

    def _draw_bow(self) -> tuple[Array, Array]:
        """Draw headings of the links ``(links,)`` in radians, a bow with some sway, and gripper poses ``(G, 3)``."""
        low, high = self._workspace.bounds
        s = (np.arange(self._chain.spec.links) + 0.5) / self._chain.spec.links
        for _ in range(1000):
            # Never straight: a straight rope does not buckle when pushed.
            bow = self.np_random.choice([-1.0, 1.0]) * self.np_random.uniform(0.5, 1.2)
            sway, turn = self.np_random.uniform(-0.5, 0.5), self.np_random.uniform(-0.3, 0.3)
            headings = turn + bow * np.cos(np.pi * s) + sway * np.sin(2 * np.pi * s)
            middle = self.np_random.uniform(low[:, :2].mean(axis=0), high[:, :2].mean(axis=0))
            half = self._chain.span(headings) / 2
            if self._chain.spec.grippers == 1:
                poses = np.array([[*middle, headings[0]]])
            else:
                poses = np.array([[*(middle - half), headings[0]], [*(middle + half), headings[-1]]])
            if self._workspace.allows(poses):
                return headings, poses
        raise RuntimeError("no start state within the workspace in 1000 draws: the workspace is too small for the rope")

    def _draw_bend(self) -> Array:
        """Draw an S bend: both ends turned the same way, and closer together."""
        low, high = self._workspace.bounds
        poses = self.np_random.uniform(low, high)
        turn = self.np_random.choice([-1.0, 1.0]) * self.np_random.uniform(0.7, 1.0)
        poses[:, 2] = turn * high[:, 2]
        if len(poses) == 2:
            half = self.np_random.uniform(0.13, 0.16)
            middle = poses[:, :2].mean(axis=0)
            poses[:, :2] = middle + half * np.array([[-1.0, 0.0], [1.0, 0.0]])
        return self._workspace.clip(poses, self._target)
