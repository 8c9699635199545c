"""The cables environment: bring one rope, or all of them, into a goal shape among ropes that lie over each other."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import combinations_with_replacement
from typing import Any, ClassVar, Final

import gymnasium as gym
import numpy as np
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from shape_obs_envs.arguments import count, one_of
from shape_obs_envs.mujoco.bodies import GRIPPERS
from shape_obs_envs.mujoco.bodies.chain import ChainSpec
from shape_obs_envs.mujoco.bodies.crossings import Crossing, intersections, self_intersections, stacked
from shape_obs_envs.mujoco.bodies.ropes import Ropes, ropes_bodies, ropes_equality, ropes_sections
from shape_obs_envs.mujoco.goal_env import SUBSTEPS, ShapeGoalEnv, even_fractions
from shape_obs_envs.mujoco.goals import DIFFICULTIES, Actions, Difficulty, measured_space
from shape_obs_envs.mujoco.workspace import TetheredWorkspace

Array = NDArray[np.float64]

#: Number of points of a rope's goal.
POINTS = 20
_BLUE: Final = {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]}
_SPEC: Final = {"length": 0.5, "radius": 0.007, "links": 24, "stiffness": 0.05, "damping": 2e-3}
#: Lowest and highest poses of the grippers: x, y in metres and yaw in radians. Gripper 0 stays below gripper 1.
_LOW: Final = (-0.25, -0.17, -0.6), (-0.25, 0.04, -1.2)
_HIGH: Final = (-0.12, -0.04, 1.2), (-0.12, 0.17, 0.6)
#: Lowest and highest positions (x, y) of ends 1 of ropes 0 and 1, crosswise to the grippers, so that the ropes cross.
_SOCKETS: Final = ((0.12, 0.0), (0.25, 0.17)), ((0.12, -0.17), (0.25, 0.0))
#: Lowest and highest x of rope 2: the grippers do not come there.
_MIDDLE: Final = -0.06, 0.11
#: Mean heading of each rope from end 0 to end 1, and how far it varies, in radians. Rope 2 runs down in the image.
_COURSES: Final = (0.42, 0.25), (-0.42, 0.25), (-math.pi / 2, 0.25)
#: How far the middle between the tips of a rope is from the origin at most, along x and y in metres.
_SHIFT: Final = (0.03, 0.05), (0.03, 0.05), (0.08, 0.02)
_DRAWS: Final = 2000


class CablesEnv(ShapeGoalEnv, EzPickle):
    """Bring ropes of one colour, which lie over each other, into a goal shape; see docs/reference/envs/cables.md.

    Args:
        ropes: Number of ropes, 2 or 3.
        grippers: 2 to hold end 0 of ropes 0 and 1, 1 to hold end 0 of rope 0. Every other end is in a socket.
        rope: The held rope that has a goal, 0 or 1, or "all" for a goal of all ropes.
        **options: Arguments of ``ShapeGoalEnv``.

    Raises:
        ValueError: An argument is out of its range.
    """

    STEP = np.array([0.015, 0.015, 0.12])  # x, y in metres and yaw in radians
    REACH = ((-0.29, -0.25, 0.0), (0.29, 0.25, 0.06))
    # Nearer than for one rope: only one end moves.
    GOALS: ClassVar[Mapping[str, Difficulty]] = {**DIFFICULTIES, "far": DIFFICULTIES["far"]._replace(least=0.04)}

    def __init__(self, ropes: int = 3, grippers: int = 2, rope: int | str = 0, **options: Any) -> None:
        EzPickle.__init__(self, ropes, grippers, rope, **options)
        ShapeGoalEnv.__init__(self, **options)
        ropes, held = count("ropes", ropes, 2, 3), count("grippers", grippers, 1, 2)
        self.rope = one_of("rope", rope, ("all",)) if isinstance(rope, str) else count("rope", rope, 0, held - 1)
        spec = ChainSpec(grippers=held, **_SPEC)
        model = self._compile(ropes_bodies(spec, ropes), ropes_equality(spec, ropes), ropes_sections(spec, ropes))
        self._ropes = Ropes(spec, ropes, model)
        self._holders = [GRIPPERS[k] if k < held else f"socket{k}" for k in range(ropes)]
        if not isinstance(self.rope, str):
            self._ropes.marked = (self.rope,)
        workspace = TetheredWorkspace(self._tethers, _LOW[:held], _HIGH[:held])
        low, high = workspace.bounds
        low, high = low - 0.05, high + 0.05  # the welds are slightly compliant
        self._install(
            self._ropes,
            workspace,
            gym.spaces.Box(
                np.concatenate([[*pose[:2], -0.1, -1.0, -1.0] for pose in low]).astype(np.float32),
                np.concatenate([[*pose[:2], 0.1, 1.0, 1.0] for pose in high]).astype(np.float32),
                dtype=np.float32,
            ),
        )

    # ---- published

    @property
    def anchors(self) -> Mapping[str, tuple[float, float, float]]:
        """Where end 0 of each rope is: name -> (x, y, z) in metres, base frame; gripper k or socket k holds rope k."""
        tips = self._ropes.vertices()[:, 0].tolist()
        return {name: (x, y, z) for name, (x, y, z) in zip(self._holders, tips, strict=True)}

    @property
    def goal_layout(self) -> dict[str, Any]:
        """Layout of the points of a goal: along each rope, from end 0, rope by rope."""
        return {"kind": "centerline", "count": len(self._holders)} if self.rope == "all" else {"kind": "centerline"}

    @property
    def shape_obs_defaults(self) -> dict[str, Any]:
        """Suitable arguments of ``shape_obs.ShapeObservation`` for this environment."""
        return {
            "shapes": [self._shape()],
            "segmentation": self._randomizer.segmentation(_BLUE),
            "features": [{"kind": "points3d", "frame": "base"}],
            "workspace": measured_space(self.BOUNDS),
        }

    def _shape(self) -> dict[str, Any]:
        """Return the shapes that the wrapper should find: a slot for each rope, the one that has the goal first.

        With a goal of all ropes, slot k is rope k, and point 0 is its end 0. Otherwise ropes without a gripper take the
        slots that are left, in any order.
        """
        if isinstance(self.rope, str):
            holders = self._holders
        else:
            held = range(self._ropes.spec.grippers)
            holders = [self._holders[k] for k in sorted(held, key=lambda k: k != self.rope)]
        return {
            "kind": "centerline",
            "name": "centerline",
            "n": POINTS,
            "count": self._ropes.ropes,
            "anchor": {f"centerline{slot}": name for slot, name in enumerate(holders)},
            "ends": "tips",
            "spacing": "m",
            "radius": self._ropes.nominal.radius,
        }

    def truth(
        self,
        n: int = POINTS,
        frame: str = "world",
        ends: str = "tips",
        surface: bool = False,
        rope: int | str | None = None,
    ) -> Array:
        """Return true points of a rope, equidistant by arc length from end 0 to end 1, without rendering.

        Args:
            n: Number of points of a rope, at least 2.
            frame: "world" (the base frame, metres), "camera" (optical frame, metres) or "pixels" (u right, v down).
            ends: "tips": point i at i / (n - 1) of the length, first and last on the tips. "centers": at
                (i + 0.5) / n, in the middle of n equal parts.
            surface: Return the rope's surface in the camera's line of sight to each point, not its axis. Under another
                rope it is that of the other one if this is less than three radii above.
            rope: Number of the rope, or "all" for all of them, rope by rope; None for those that have the goal.

        Returns:
            Points of shape ``(n, 3)``, or pixels of shape ``(n, 2)``; for K ropes ``(K n, 3)`` or ``(K n, 2)``.

        Raises:
            ValueError: An argument is out of its range.
        """
        points = self._ropes.points(even_fractions(count("n", n, 2), ends))
        rope = self.rope if rope is None else rope
        if isinstance(rope, str):
            one_of("rope", rope, ("all",))
            points = points.reshape(-1, 3)
        else:
            points = points[count("rope", rope, 0, self._ropes.ropes - 1)]
        if surface:
            points = self._ropes.visible_surface(points, self._eye, 3 * self._ropes.spec.radius)
        return self._in_frame(points, frame)

    def crossings(self) -> list[Crossing]:
        """Return the true crossings in the camera's image, of each rope with the others and with itself."""
        camera, vertices = self.camera_model, self._ropes.vertices()
        local = camera.from_base(vertices.reshape(-1, 3)).reshape(vertices.shape)
        pixels = camera.intrinsics.project(local.reshape(-1, 3)).reshape(*vertices.shape[:2], 2)
        out = []
        for one, other in combinations_with_replacement(range(self._ropes.ropes), 2):
            same = one == other
            places = self_intersections(pixels[one]) if same else intersections(pixels[one], pixels[other])
            for at in places:
                (first, away), (second, beyond) = (
                    (float(self._ropes.fractions(place)), _along(local[rope], place)[2])
                    for rope, place in zip((one, other), at, strict=True)
                )
                u, v = _along(pixels[one], at[0]).tolist()
                above, below = (one, first), (other, second)
                if away > beyond:
                    above, below = below, above
                out.append(Crossing(*above, *below, (u, v)))
        return out

    # ---- ShapeGoalEnv

    def _move(self, action: Array) -> None:
        target = self._workspace.clip(self._target + action.reshape(self._target.shape) * self.STEP, self._target)
        self._target = self._ropes.pull_to(self._target, target, SUBSTEPS)

    def _goal_points(self) -> Array:
        return self.truth()

    def _gripper(self) -> NDArray[np.float32]:
        poses = self._ropes.gripper_poses()
        held, yaw = self._ropes.vertices()[: len(poses), 0], poses[:, 2]
        return np.column_stack([held, np.cos(yaw), np.sin(yaw)]).astype(np.float32).ravel()

    def _tethers(self) -> Array:
        return self._ropes.end_poses()[: self._ropes.spec.grippers, 1]

    def _draw_start(self) -> Array:
        ropes = self._ropes
        for _ in range(_DRAWS):
            lines = np.stack([self._draw_line(rope) for rope in range(ropes.ropes)])
            heights = stacked(lines, ropes.spec.radius, self.np_random)
            if heights is not None:
                break
        else:
            raise RuntimeError(f"no start state in {_DRAWS} draws: the workspace is too small for the ropes")
        ropes.place(np.concatenate([lines, heights[..., None]], axis=2))
        poses = ropes.gripper_poses()
        ropes.step_to(poses, poses, 8 * SUBSTEPS)
        return poses

    def _draw_line(self, rope: int) -> Array:
        """Draw the axis of a rope with its ends where they may be, ``(links + 1, 2)`` in metres from end 0 to end 1."""
        rng, spec = self.np_random, self._ropes.spec
        course, change = _COURSES[rope]
        s = (np.arange(spec.links) + 0.5) / spec.links
        lengths = np.diff(self._ropes.arc)[:, None]
        for _ in range(_DRAWS):
            bow = rng.choice([-1.0, 1.0]) * rng.uniform(0.65, 1.0)
            sway, turn = rng.uniform(-0.4, 0.4), course + change * rng.uniform(-1, 1)
            headings = turn + bow * np.cos(np.pi * s) + sway * np.sin(2 * np.pi * s)
            line = np.zeros((spec.links + 1, 2))
            line[1:] = np.cumsum(lengths * np.column_stack([np.cos(headings), np.sin(headings)]), axis=0)
            line += rng.uniform(-1, 1, 2) * _SHIFT[rope] - (line[0] + line[-1]) / 2
            if _suits(rope, np.array([*line[0], headings[0]]), line):
                return line
        raise RuntimeError(f"no rope {rope} within the workspace in {_DRAWS} draws")

    def _draw_motion(self, vigour: float, bent: bool) -> Actions:
        actions = super()._draw_motion(vigour, bent)
        if isinstance(self.rope, str):  # stronger: the mean distance is also that of ropes which hardly move
            actions = np.clip(2 * actions, -1, 1)
        else:
            # Only its own gripper moves: a goal into which another rope has pressed it is hardly found again.
            others = np.arange(actions.shape[1]) // len(self.STEP) != self.rope
            actions[:, others] = 0
        return actions

    def _draw_bend(self) -> Array:
        """Draw grippers that turn the ropes against their bows, nearer to the sockets: each rope gets an S bend."""
        low, high = self._workspace.bounds
        poses = self.np_random.uniform(low, high)
        against = self._target[:, 2] > (low + high)[:, 2] / 2
        part = self.np_random.uniform(0.7, 1.0, len(poses))
        middle = (low + high)[:, 2] / 2
        poses[:, 2] = np.where(against, middle + part * (low[:, 2] - middle), middle + part * (high[:, 2] - middle))
        poses[:, 0] = self.np_random.uniform((low + high)[:, 0] / 2, high[:, 0])
        return self._workspace.clip(poses, self._target)


def _suits(rope: int, pose: Array, line: Array) -> bool:
    """Return whether an axis ``(links + 1, 2)`` that starts at ``pose`` lies where that of ``rope`` may be."""
    tallest = bool(np.abs(line[:, 1]).max() < CablesEnv.REACH[1][1] - 0.02)
    if rope == 2:
        return tallest and bool(_MIDDLE[0] < line[:, 0].min() and line[:, 0].max() < _MIDDLE[1])
    low, high = _SOCKETS[rope]
    held = np.all(pose >= _LOW[rope]) and np.all(pose <= _HIGH[rope])
    return bool(held and np.all(line[-1] >= low) and np.all(line[-1] <= high)) and tallest


def _along(line: Array, place: float) -> Array:
    """Return the point of a polyline ``(N, D)`` at a place in segments from its start."""
    i = int(place)
    return line[i] + (place - i) * (line[i + 1] - line[i])
