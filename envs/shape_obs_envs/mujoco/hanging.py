"""The hanging environment: bring a rope that hangs from two grippers, or one, into a goal shape in space."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar, Final

import gymnasium as gym
import numpy as np
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from shape_obs_envs.arguments import count, one_of, positive
from shape_obs_envs.mujoco.bodies.chain import ChainSpec
from shape_obs_envs.mujoco.bodies.strand import Strand, strand_bodies, strand_equality, strand_sections
from shape_obs_envs.mujoco.cable import RopeEnv
from shape_obs_envs.mujoco.goal_env import SUBSTEPS, ShapeGoalEnv
from shape_obs_envs.mujoco.goals import DIFFICULTIES, Actions, Difficulty, actions_towards
from shape_obs_envs.mujoco.workspace import BoxWorkspace, HangingWorkspace

Array = NDArray[np.float64]

#: Fields of ``CameraSpec`` for each ``view``.
VIEWS: Final[Mapping[str, Mapping[str, Any]]] = {
    "side": {"distance": 0.62, "tilt": math.radians(80), "aim": (0.0, 0.0, 0.29)},
    "above": {"distance": 0.62, "tilt": math.radians(45), "aim": (0.0, 0.0, 0.29)},
}
_WALL: Final = '<geom name="wall" type="plane" pos="0 .7 0" zaxis="0 -1 0" size="4 4 .1" rgba=".72 .74 .76 1"/>'
_ROPE: Final = {"links": 24, "stiffness": 0.004, "damping": 3e-3}
_TWO: Final = ChainSpec(length=0.5, **_ROPE)
_ONE: Final = ChainSpec(length=0.36, grippers=1, **_ROPE)
# No point of a rope is lower than the middle of its ends by more than half its length, so it never meets the table.
_LOW, _HIGH = (-0.2, -0.12, 0.29), (-0.05, 0.12, 0.48)
_BOX: Final = BoxWorkspace(low=((-0.16, -0.1, 0.42),), high=((0.16, 0.1, 0.5),))
#: Largest step for which the physics was tested, in metres: 1 m/s.
_FASTEST: Final = 0.05
#: Largest distance of the grippers as a fraction of the rope's length: the rope is never pulled taut.
_REACH: Final = 0.88


class HangingEnv(RopeEnv):
    """Bring a rope that hangs under gravity into a goal with one gripper or two; see docs/reference/envs/hanging.md.

    Args:
        grippers: 2 to hold both ends, 1 to hold end 0 of a shorter rope.
        view: "side" for a camera that is nearly level with the rope, "above" for one that looks down at 45 degrees.
        step: Largest motion of a gripper in one step along each axis, in metres, at most 0.05.
        **options: Arguments of ``ShapeGoalEnv``.

    Raises:
        ValueError: An argument is out of its range.
    """

    REACH = ((-0.23, -0.24, 0.03), (0.23, 0.2, 0.51))
    BOUNDS = ((-0.5, -0.5, 0.0), (0.5, 0.5, 0.8))
    GOALS: ClassVar[Mapping[str, Difficulty]] = {**DIFFICULTIES, "far": DIFFICULTIES["far"]._replace(least=0.1)}

    def __init__(self, grippers: int = 2, view: str = "side", step: float = 0.05, **options: Any) -> None:
        EzPickle.__init__(self, grippers, view, step, **options)
        self._view = VIEWS[one_of("view", view, VIEWS)]
        ShapeGoalEnv.__init__(self, **options)
        if positive("step", step, "0.05") > _FASTEST:
            raise ValueError(f"step: expected at most {_FASTEST} m, with which the physics is stable, got {step}.")
        self.STEP = np.full(3, step)
        two = count("grippers", grippers, 1, 2) == 2
        spec = _TWO if two else _ONE
        model = self._compile(strand_bodies(spec) + _WALL, strand_equality(spec), strand_sections(spec))
        self._rope = self._strand = Strand(spec, model)
        workspace = HangingWorkspace(self._reach, _LOW, _HIGH) if two else _BOX
        low, high = (np.asarray(corner, np.float32).ravel() for corner in workspace.bounds)
        # A moving rope pulls the grippers aside.
        self._install(self._strand, workspace, gym.spaces.Box(low - 0.05, high + 0.05, dtype=np.float32))

    def _reach(self) -> float:
        return _REACH * self._strand.spec.length

    def _gripper(self) -> NDArray[np.float32]:
        return self._strand.gripper_poses().astype(np.float32).ravel()

    def _draw_start(self) -> Array:
        low, high = self._workspace.bounds
        poses = self._workspace.clip(self.np_random.uniform(low, high), (low + high) / 2)
        self._strand.place(poses)
        # The rope settles: its stiffness opens the bend of the catenary.
        self._strand.step_to(poses, poses, 8 * SUBSTEPS)
        return poses

    def _draw_motion(self, vigour: float, bent: bool) -> Actions:
        if bent:
            return super()._draw_motion(vigour, bent)
        # Not at random from step to step: at this speed, the grippers would be at their limits all the time.
        poses = self._target + 0.1 * vigour * self.np_random.uniform(-1, 1, self._target.shape)
        return actions_towards(self.np_random, self._target, self._workspace.clip(poses, self._target), self.STEP)

    def _draw_bend(self) -> Array:
        """Draw grippers close to each other in x, one high and one low: the rope hangs in a narrow, crooked loop."""
        rng, (low, high) = self.np_random, self._workspace.bounds
        poses = rng.uniform(low, high)
        if len(poses) == 2:
            inner = np.array([high[0, 0], low[1, 0]])
            poses[:, 0] = inner + rng.uniform(0, 0.04, 2) * (-1, 1)
            part = rng.permutation([rng.uniform(0, 0.3), rng.uniform(0.7, 1)])
            poses[:, 2] = low[:, 2] + part * (high - low)[:, 2]
        return self._workspace.clip(poses, self._target)
