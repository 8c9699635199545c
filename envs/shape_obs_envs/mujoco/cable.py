"""The cable environment: a rope on a table, held by two grippers, to be brought into a goal shape."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from shape_obs_envs.arguments import one_of
from shape_obs_envs.mujoco.bodies.chain import GRIPPERS, Chain, ChainSpec, chain_bodies, chain_equality
from shape_obs_envs.mujoco.goal_env import POINTS, POINTS_HIGH, POINTS_LOW, SUBSTEPS, ShapeGoalEnv
from shape_obs_envs.mujoco.scene import compile_scene
from shape_obs_envs.mujoco.workspace import TwoGripperWorkspace

Array = NDArray[np.float64]

#: Largest motion of a gripper in one step: x, y [m] and yaw [rad].
STEP = np.array([0.015, 0.015, 0.12])
#: A goal nearer to the start than this [m] is drawn again.
_LEAST_CHANGE = 0.03
#: Steps at rest before a goal is recorded: a goal that is still relaxing could be reached but not kept.
_SETTLING = 20


class CableEnv(ShapeGoalEnv, EzPickle):
    """Bring a rope into a goal shape with two grippers; see docs/envs/cable.md.

    Args:
        camera: "rl" (160 x 120), "d455" (640 x 480) or [width, height] in pixels.
        renderer: "gl", "rays", or "auto" for OpenGL where there is one.
        reward_type: "dense" or "sparse".
        render_mode: None or "rgb_array".
        success_threshold: Mean point distance [m] under which the goal counts as reached.

    Raises:
        ValueError: An argument is out of its range; the message says what it takes.

    Attributes:
        goal_actions: (T, 6) the actions that lead from the last start state to its goal, where the rope comes to rest
            within a second: a demonstration.
    """

    def __init__(
        self,
        camera: str | Sequence[int] = "rl",
        renderer: str = "auto",
        reward_type: str = "dense",
        render_mode: str | None = None,
        success_threshold: float = 0.01,
    ) -> None:
        EzPickle.__init__(self, camera, renderer, reward_type, render_mode, success_threshold)
        ShapeGoalEnv.__init__(self, camera, renderer, reward_type, render_mode, success_threshold)
        spec = ChainSpec()
        self._model = compile_scene(self._camera_spec, chain_bodies(spec), chain_equality(spec))
        self._chain = Chain(spec, self._model)
        self._data = self._chain.data
        self._chain.refresh()
        self._workspace = TwoGripperWorkspace()
        self._target = self._chain.tip_poses()
        self.goal_actions = np.zeros((0, 6), np.float32)
        self.action_space = gym.spaces.Box(-1.0, 1.0, (6,), np.float32)
        low, high = self._workspace.bounds
        corners = (low - 0.05, high + 0.05)  # the welds give a little
        lower, upper = ([[*corner[:2], 0.0] for corner in corners[0]], [[*corner[:2], 0.1] for corner in corners[1]])
        self._define_observation(
            gym.spaces.Box(
                np.concatenate([[*xyz, -1.0, -1.0] for xyz in lower]).astype(np.float32),
                np.concatenate([[*xyz, 1.0, 1.0] for xyz in upper]).astype(np.float32),
                dtype=np.float32,
            )
        )

    # ---- published

    @property
    def anchors(self) -> Mapping[str, tuple[float, float, float]]:
        """Where the grippers hold the rope: name -> (x, y, z) [m] in the base frame; gripper0 holds end 0."""
        tips = self._chain.vertices()[[0, -1]].tolist()
        return {name: (x, y, z) for name, (x, y, z) in zip(GRIPPERS, tips, strict=True)}

    @property
    def shape_obs_defaults(self) -> dict[str, Any]:
        """Arguments of `shape_obs.ShapeObservation` that suit this environment."""
        return {
            "shapes": [
                {
                    "kind": "centerline",
                    "n": POINTS,
                    "anchor": "gripper0",
                    "ends": "tips",
                    "spacing": "m",
                    "radius": self._chain.spec.radius,
                }
            ],
            "segmentation": {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]},
            "features": [{"kind": "points3d", "frame": "base"}],
            # Below the table too: measured points scatter, and clipping them would bias their mean.
            "workspace": [[*POINTS_LOW[:2], -0.1], [*POINTS_HIGH[:2], 0.2]],
        }

    def truth(self, n: int = POINTS, frame: str = "world", ends: str = "tips", surface: bool = False) -> Array:
        """True points of the rope, equidistant by arc length from end 0 to end 1; needs no rendering.

        Args:
            n: How many points, at least 2.
            frame: "world" (= base frame, metres), "camera" (optical frame, metres) or "pixels" (u right, v down).
            ends: "tips": point i at i / (n - 1) of the length, first and last on the tips. "centers": at
                (i + 0.5) / n, in the middle of n equal parts.
            surface: The rope's surface as the camera sees it along the line of sight of each point, not its axis.

        Returns:
            (n, 3) points, or (n, 2) pixels.

        Raises:
            ValueError: An argument is out of its range.
        """
        one_of("frame", frame, ("world", "camera", "pixels"))
        one_of("ends", ends, ("tips", "centers"))
        if isinstance(n, bool) or not isinstance(n, (int, np.integer)) or n < 2:
            raise ValueError(f"n: expected a whole number of points, 2 or more, got {n!r}")
        fractions = np.linspace(0.0, 1.0, n) if ends == "tips" else (np.arange(n) + 0.5) / n
        points = self._chain.points(fractions)
        camera = self.camera_model
        if surface:
            transform = camera.transform_camera_to_base
            assert transform is not None
            points = self._chain.surface_points(points, np.ascontiguousarray(transform[:3, 3]))
        if frame == "world":
            return points
        return camera.from_base(points) if frame == "camera" else camera.project_from_base(points)

    # ---- ShapeGoalEnv

    def _start(self) -> None:
        poses, headings = self._draw_start()
        self._chain.place(poses[0, :2], headings)
        self._target = poses
        self._chain.step_to(poses, poses, 4 * SUBSTEPS)  # the drawn bow is not quite the one that the rope settles in

    def _draw_start(self) -> tuple[Array, Array]:
        """Gripper poses (2, 3) in the workspace and headings of the links (links,) [rad]: a bow with some sway."""
        low, high = self._workspace.bounds
        s = (np.arange(self._chain.spec.links) + 0.5) / self._chain.spec.links
        for _ in range(1000):
            # Never straight: a straight rope does not buckle when it is pushed.
            bow = self.np_random.choice([-1.0, 1.0]) * self.np_random.uniform(0.5, 1.2)
            sway, turn = self.np_random.uniform(-0.5, 0.5), self.np_random.uniform(-0.3, 0.3)
            headings = turn + bow * np.cos(np.pi * s) + sway * np.sin(2 * np.pi * s)
            middle = self.np_random.uniform(low[:, :2].mean(axis=0), high[:, :2].mean(axis=0))
            half = self._chain.span(headings) / 2
            poses = np.array([[*(middle - half), headings[0]], [*(middle + half), headings[-1]]])
            if self._workspace.allows(poses):
                return poses, headings
        raise RuntimeError("no start state within the workspace in 1000 draws: it is too small for the rope")

    def _draw_goal(self) -> Array:
        start, target = self._chain.get_state(), self._target
        before = self._chain.points(np.linspace(0, 1, POINTS))
        goal = before
        for _ in range(10):
            self.goal_actions = self._smooth_actions()
            for action in self.goal_actions:
                self._move(action.astype(np.float64))
            for _ in range(_SETTLING):
                self._move(np.zeros(6))
            goal = self._chain.points(np.linspace(0, 1, POINTS))
            self._chain.set_state(start)
            self._target = target
            if np.linalg.norm(goal - before, axis=1).mean() > _LEAST_CHANGE:
                break
        return goal

    def _smooth_actions(self) -> NDArray[np.float32]:
        """A random gripper motion (T, 6), T at most 35, that starts and ends at rest."""
        steps = int(self.np_random.integers(18, 33))
        knots = np.zeros((5, 6))
        knots[1:-1] = self.np_random.uniform(-1, 1, (3, 6))
        at = np.linspace(0, len(knots) - 1, steps)
        actions = np.column_stack([np.interp(at, np.arange(len(knots)), knot) for knot in knots.T])
        return np.concatenate([actions, np.zeros((3, 6))]).astype(np.float32)

    def _move(self, action: Array) -> None:
        target = self._workspace.clip(self._target + action.reshape(2, 3) * STEP, self._target)
        self._chain.step_to(self._target, target, SUBSTEPS)
        self._target = target

    def _gripper(self) -> NDArray[np.float32]:
        tips, yaw = self._chain.vertices()[[0, -1]], self._chain.tip_poses()[:, 2]
        return np.column_stack([tips, np.cos(yaw), np.sin(yaw)]).astype(np.float32).ravel()
