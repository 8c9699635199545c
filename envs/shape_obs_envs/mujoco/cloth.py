"""The cloth environment: bring a sheet on a table, held at two corners, into a goal shape."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from shape_obs_envs.arguments import count
from shape_obs_envs.mujoco.bodies import GRIPPERS
from shape_obs_envs.mujoco.bodies.sheet import Sheet, SheetSpec, sheet_bodies, sheet_sections
from shape_obs_envs.mujoco.goal_env import SUBSTEPS, ShapeGoalEnv, even_fractions
from shape_obs_envs.mujoco.goals import DIFFICULTIES, Actions, Difficulty, measured_space, smooth_actions
from shape_obs_envs.mujoco.workspace import HeldEdgeWorkspace

Array = NDArray[np.float64]

#: Rows and columns of the points of a goal, from the held edge down and from gripper 0's side across.
ROWS, COLS = 4, 8
_BLUE = {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]}
# Height in metres that a corner needs per metre of slack in its side and in the held edge, and the largest height.
_PER_SIDE, _PER_EDGE, _MOST = 0.3, 0.1, 0.025


class ClothEnv(ShapeGoalEnv, EzPickle):
    """Bring a sheet into a goal shape with two grippers at its corners; see docs/reference/envs/cloth.md.

    Args:
        **options: Arguments of ``ShapeGoalEnv``.

    Raises:
        ValueError: An argument is out of its range.
    """

    STEP = np.array([0.006, 0.006, 0.006])  # x, y, z in metres
    REACH = ((-0.28, -0.21, 0.0), (0.28, 0.19, 0.1))
    # Nearer than for other objects: a fold moves only a part of the sheet.
    GOALS: ClassVar[Mapping[str, Difficulty]] = {**DIFFICULTIES, "far": DIFFICULTIES["far"]._replace(least=0.04)}

    def __init__(self, **options: Any) -> None:
        EzPickle.__init__(self, **options)
        ShapeGoalEnv.__init__(self, **options)
        spec = SheetSpec()
        self._sheet = Sheet(spec, self._compile(sheet_bodies(spec), sections=sheet_sections(spec)))
        workspace = HeldEdgeWorkspace(self._floor)
        low, high = (np.asarray(corner, np.float32).ravel() for corner in workspace.bounds)
        self._install(self._sheet, workspace, gym.spaces.Box(low - 0.005, high + 0.005, dtype=np.float32))

    # ---- published

    @property
    def anchors(self) -> Mapping[str, tuple[float, float, float]]:
        """The held corners: name -> (x, y, z) in metres, base frame; gripper0 holds that of row 0 and column 0."""
        held = self._sheet.points(np.zeros(1), np.array([0.0, 1.0]))[0].tolist()
        return {name: (x, y, z) for name, (x, y, z) in zip(GRIPPERS, held, strict=True)}

    @property
    def goal_layout(self) -> dict[str, Any]:
        """Layout of the points of a goal: row by row from the held edge."""
        return {"kind": "surface", "rows": ROWS, "cols": COLS}

    @property
    def shape_obs_defaults(self) -> dict[str, Any]:
        """Suitable arguments of ``shape_obs.ShapeObservation`` for this environment."""
        return {
            "shapes": [
                {
                    "kind": "surface",
                    "rows": ROWS,
                    "cols": COLS,
                    "anchor": "gripper0",
                    "ends": "tips",
                    "spacing": "m",
                    "freedom": 0.2,  # each gripper moves and lifts its corner independently
                }
            ],
            "segmentation": self._randomizer.segmentation(_BLUE),
            "features": [{"kind": "points3d", "frame": "base"}],
            "workspace": measured_space(self.BOUNDS),
        }

    @property
    def unfolded(self) -> bool:
        """Whether the camera sees the whole sheet from above, each point once and none at a grazing angle.

        All triangles of the surface face the camera at 20 degrees or more to the surface, and the outline does not
        cross itself in the image, so no line of sight meets the sheet twice. Grippers are ignored.
        """
        return self._sheet.mesh.is_open(self._sheet.vertices(), self.camera_model)

    def truth(
        self, rows: int = ROWS, cols: int = COLS, frame: str = "world", ends: str = "tips", surface: bool = False
    ) -> Array:
        """Return true points of the sheet, equidistant on its material, row by row, without rendering.

        The first point is the corner held by gripper 0, at the top left of the image; columns run to gripper 1's side.

        Args:
            rows: Number of rows, at least 2.
            cols: Number of columns, at least 2.
            frame: "world" (the base frame, metres), "camera" (optical frame, metres) or "pixels" (u right, v down).
            ends: "tips": the outer rows and columns lie on the border. "centers": in the middle of rows x cols equal
                pieces.
            surface: No effect: the points lie on the rendered surface. On a folded sheet not all of them are visible.

        Returns:
            Points of shape ``(rows * cols, 3)``, or pixels of shape ``(rows * cols, 2)``.

        Raises:
            ValueError: An argument is out of its range.
        """
        places = (even_fractions(n, ends) for n in (count("rows", rows, 2), count("cols", cols, 2)))
        return self._in_frame(self._sheet.points(*places).reshape(-1, 3), frame)

    # ---- ShapeGoalEnv

    def _goal_points(self) -> Array:
        return self.truth()

    def _gripper(self) -> NDArray[np.float32]:
        return self._sheet.gripper_poses().astype(np.float32).ravel()

    def _floor(self) -> Array:
        """Return heights ``(2,)`` in metres that keep the layers of a folded sheet separate; it has no contacts.

        A corner that approaches the free end of its side folds that side, and two corners that approach each other fold
        the held edge: the sheet then needs room for its bend.
        """
        left, right = self._sheet.gripper_targets()
        edge = max(HeldEdgeWorkspace.reach - float(np.linalg.norm(right - left)), 0.0)
        return HeldEdgeWorkspace.low[2] + np.minimum(_PER_SIDE * self._sheet.slack() + _PER_EDGE * edge, _MOST)

    def _draw_start(self) -> Array:
        """Lay the sheet flat on the table, lift its held edge and bring its corners slightly closer."""
        lowest = self._workspace.bounds[0][0, 2]
        rng = self.np_random
        self._sheet.lay(np.array([rng.uniform(-0.03, 0.03), rng.uniform(0.05, 0.11)]), rng.uniform(-0.15, 0.15))
        laid = self._sheet.gripper_targets().copy()
        closer = laid.mean(axis=0) + (laid - laid.mean(axis=0)) * rng.uniform(0.88, 0.96)
        closer[:, 2] = rng.uniform(lowest + 0.005, lowest + 0.02, 2)
        poses = self._workspace.clip(closer, closer)
        self._sheet.step_to(laid, poses, 8 * SUBSTEPS)
        self._sheet.step_to(poses, poses, 10 * SUBSTEPS)
        return poses

    def _draw_motion(self, vigour: float, bent: bool) -> Actions:
        if bent:
            return super()._draw_motion(vigour, bent)
        # Mostly together, because the edge between them soon stops independent motions; and twice as strong, because
        # steps are small here.
        parts = 2 * smooth_actions(self.np_random, 9, vigour)
        return np.clip(np.tile(parts[:, :3], 2) + 0.5 * parts[:, 3:], -1, 1).astype(np.float32)

    def _draw_bend(self) -> Array:
        """Draw the held edge carried over the rest of the sheet, or its corners brought close together."""
        rng = self.np_random
        poses = self._target.copy()
        aside = -1.0 if poses[:, 0].mean() > rng.uniform(-0.03, 0.03) else 1.0  # the side with more room
        if rng.random() < 0.6:
            poses += (aside * rng.uniform(0.02, 0.08), -rng.uniform(0.13, 0.17), 0.0)
            poses += rng.uniform(-0.01, 0.01, (2, 3))
            poses[:, 2] = rng.uniform(0.04, 0.06)
        else:
            half = rng.uniform(0.095, 0.11) * np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
            poses = poses.mean(axis=0) + half + (aside * rng.uniform(0.08, 0.12), rng.uniform(-0.06, 0.06), 0.0)
            poses[:, 2] = rng.uniform(0.03, 0.08, 2)
        return self._workspace.clip(poses, self._target)
