"""Goal-conditioned envs that draw a flat object on a table, without physics and renderer."""

from __future__ import annotations

from typing import Any

import cv2
import gymnasium as gym
import numpy as np

from shape_obs import CameraModel, Intrinsics, ShapeObservation
from shape_obs.robot import ActionSpec

INTRINSICS = Intrinsics(160, 120, 150.0, 150.0, 79.5, 59.5)
RED = {"kind": "hsv", "low": [170, 120, 60], "high": [10, 255, 255]}
ROWS, COLS = 5, 7
LAYOUTS: dict[str, dict[str, Any]] = {
    "centerline": {"kind": "centerline"},
    "contour": {"kind": "contour"},
    "surface": {"kind": "surface", "rows": ROWS, "cols": COLS},
}
COUNTS = {"centerline": 15, "contour": 40, "surface": ROWS * COLS}


def tilted(degrees: float) -> np.ndarray:
    """Return the pose of a camera 0.6 m from the origin of the table, tilted about base x, (4, 4)."""
    turn = np.deg2rad(degrees)
    across, up, back = np.array([1.0, 0, 0]), np.array([0, np.cos(turn), np.sin(turn)]), np.zeros(3)
    back = np.cross(across, up)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([across, -up, -back], axis=1)
    pose[:3, 3] = 0.6 * back
    return pose


class FlatGoalEnv(gym.Env[Any, Any]):
    """A red strip, blob or sheet on a gray table, to be brought from a drawn pose and shape to another.

    The action goes on by up to a tenth of the way to the goal.

    Args:
        kind: ``"centerline"``, ``"contour"`` or ``"surface"``.
        tilt: Degrees by which the camera looks at the table aslant.
        published: Whether it says how its goals are laid out.
        turned_over: Whether it gives outlines and lattices counterclockwise.
        goals: Whether it is goal-conditioned.
        spin: Radians by which the goal is turned beyond what is drawn.
        lobes: 0 makes the blob a disk, which looks the same whichever way it is turned.
    """

    metadata = {"render_modes": [], "render_fps": 10}  # noqa: RUF012

    def __init__(
        self,
        kind: str = "centerline",
        tilt: float = 20.0,
        published: bool = True,
        turned_over: bool = False,
        goals: bool = True,
        spin: float = 0.0,
        lobes: float = 1.0,
    ) -> None:
        self.kind, self.turned_over, self.goals, self.spin, self.lobes = kind, turned_over, goals, spin, lobes
        self.camera_model = CameraModel(INTRINSICS, tilted(tilt))
        if published:
            self.goal_layout = LAYOUTS[kind]
        self.action_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float32)
        images = {
            "rgb": gym.spaces.Box(0, 255, (120, 160, 3), np.uint8),
            "depth": gym.spaces.Box(0.0, 10.0, (120, 160), np.float32),
            "way": gym.spaces.Box(0.0, 1.0, (1,), np.float32),
        }
        goal = gym.spaces.Box(-1.0, 1.0, (3 * COUNTS[kind],), np.float32)
        more = {"achieved_goal": goal, "desired_goal": goal} if goals else {}
        self.observation_space = gym.spaces.Dict({**images, **more})
        self.start, self.end, self.goal, self.way = np.zeros(5), np.zeros(5), np.zeros(5), 0.0

    # ---- truth

    def state(self) -> np.ndarray:
        """Return x and y in metres, turn in radians, bend and stretch, (5,)."""
        return self.start + self.way * (self.end - self.start)

    def material(self, state: np.ndarray, s: Any, t: Any = 0.0) -> np.ndarray:
        """Return material points in the base frame, (..., 3) metres.

        From the gripper on, s and t in 0...1 run along and across the strip, around the blob and inwards to its middle,
        or across and down the sheet.
        """
        x, y, turn, bend, stretch = state
        s, t = np.broadcast_arrays(np.asarray(s, float), np.asarray(t, float))
        if self.kind == "centerline":  # the length is the same for all bends
            at = np.linspace(0, 1, 401)
            heading = np.exp(1j * (5 * bend * np.cos(np.pi * at) + 2 * (stretch - 1) * np.cos(3 * np.pi * at)))
            along = np.concatenate([[0], np.cumsum((heading[1:] + heading[:-1]) / 2)]) / 400 * 0.3
            along = along - along.mean()
            place = np.interp(s, at, along) + 0.02 * (0.5 - t) * 1j * np.interp(s, at, heading)
            p, q = place.real, place.imag
        elif self.kind == "contour":
            angle = -2 * np.pi * s
            lobes = 0.25 * np.cos(2 * angle) + (0.1 + 0.2 * bend) * np.cos(3 * angle + 0.4)
            radius = (1 - t) * 0.1 * (1 + self.lobes * lobes)
            p, q = radius * np.cos(angle) * stretch, radius * np.sin(angle)
        else:
            p = (s - 0.5) * 0.26 * stretch + 0.05 * bend * np.sin(np.pi * t)
            q = (0.5 - t) * 0.18 + 0.06 * bend * np.sin(np.pi * s) + 0.05 * (s - 0.5)
        c, d = np.cos(turn), np.sin(turn)
        return np.stack([x + c * p - d * q, y + d * p + c * q, np.zeros_like(p)], axis=-1)

    def points(self, state: np.ndarray) -> np.ndarray:
        """Return the points in the order of the goals, (K, 3)."""
        if self.kind != "surface":
            closed = self.kind == "contour"
            points = self.material(state, np.linspace(0, 1, COUNTS[self.kind] + closed), 0.0 if closed else 0.5)
            points = points[:-1] if closed else points
            return np.roll(points[::-1], 1, axis=0) if self.turned_over else points
        down, across = np.meshgrid(np.linspace(0, 1, ROWS), np.linspace(0, 1, COLS), indexing="ij")
        s, t = (down, across) if self.turned_over else (across, down)
        return self.material(state, s, t).reshape(-1, 3)

    def outline(self, state: np.ndarray) -> np.ndarray:
        """Return the closed outline, (P, 3)."""
        side, zero, one = np.linspace(0, 1, 80), np.zeros(80), np.ones(80)
        if self.kind == "contour":
            return self.material(state, np.linspace(0, 1, 400))
        sides = [(side, zero), (one, side), (side[::-1], one), (zero, side[::-1])]
        return np.concatenate([self.material(state, s, t) for s, t in sides])

    @property
    def anchors(self) -> dict[str, tuple[float, float, float]]:
        """The position of the gripper, which holds point 0."""
        x, y, z = self.points(self.state())[0].tolist()
        return {"gripper0": (x, y, z)}

    # ---- gymnasium

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        if options:
            raise ValueError(f"no options, got {options}")
        low, high = np.array([-0.03, -0.03, -0.6, -0.3, 0.9]), np.array([0.03, 0.03, 0.6, 0.3, 1.1])
        self.start, self.end, self.way = self.np_random.uniform(low, high), self.np_random.uniform(low, high), 0.0
        self.end[2] += self.spin
        self.start[3], self.end[3] = (np.sign(v) * max(abs(v), 0.1) for v in (self.start[3], self.end[3]))
        self.goal = self.end
        return self._observe(), self._info()

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.way = float(np.clip(self.way + 0.1 * np.asarray(action)[0], 0, 1))
        return self._observe(), float(self.way), False, False, self._info()

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        apart = (np.asarray(achieved_goal, float) - desired_goal).reshape(*np.shape(achieved_goal)[:-1], -1, 3)
        reward = -np.linalg.norm(apart, axis=-1).mean(axis=-1)
        return float(reward) if reward.ndim == 0 else reward

    def _info(self) -> dict[str, Any]:
        return {"is_success": self.way > 0.95} if self.goals else {}

    def _observe(self) -> dict[str, np.ndarray]:
        camera = self.camera_model
        outline = camera.project_from_base(self.outline(self.state()))
        fine = np.zeros((480, 640), np.uint8)  # four times as fine: a drawn polygon takes in all pixels that it touches
        cv2.fillPoly(fine, [np.rint((4 * outline + 1.5) * 16).astype(np.int32)], 255, shift=4)
        mask = cv2.resize(fine, (160, 120), interpolation=cv2.INTER_AREA)
        rgb = np.where(mask[..., None] > 127, np.array([200, 40, 30]), np.array([150, 150, 150])).astype(np.uint8)
        rays = INTRINSICS.rays(np.stack(np.meshgrid(np.arange(160.0), np.arange(120.0)), axis=-1))
        assert camera.transform_camera_to_base is not None
        rotation, place = camera.transform_camera_to_base[:3, :3], camera.transform_camera_to_base[:3, 3]
        depth = (-place[2] / (rays @ rotation[2])).astype(np.float32)
        seen = {"rgb": rgb, "depth": depth, "way": np.array([self.way], np.float32)}
        if not self.goals:
            return seen
        achieved, desired = (self.points(state).astype(np.float32).ravel() for state in (self.state(), self.goal))
        return {**seen, "achieved_goal": achieved, "desired_goal": desired}


SHAPES = {
    "centerline": {"kind": "centerline", "n": 12, "ends": "tips"},
    "contour": {"kind": "contour", "n": 24, "order": "image"},
    "surface": {"kind": "surface", "rows": 4, "cols": 6, "ends": "tips"},
}
BASE = {"kind": "points3d", "frame": "base"}
ON = np.ones(1, np.float32)  # the action that goes on


def observing(kind: str = "contour", *, goals: bool = False, features: Any = (BASE,), **options: Any) -> Any:
    """Return an env that observes the object from straight above."""
    inner = FlatGoalEnv(kind, tilt=0, goals=goals)
    return ShapeObservation(inner, [SHAPES[kind]], RED, features, **options)


def target_of(env: gym.Env[Any, Any], seed: int = 0) -> list[Any]:
    """Return the points to which the env leads from a seed."""
    inner: Any = env.unwrapped
    env.reset(seed=seed)
    return inner.points(inner.end).tolist()


# ---- a goal of several shapes

POINTS = 9  # of a strip
CAP = 0.012  # m: half the width of a strip, by which a drawn line is longer at each end


class StripsEnv(gym.Env[Any, Any]):
    """Bent strips side by side; the action moves strip k by up to a tenth of the way to its goal.

    Args:
        strips: Number of strips.
        goals: Whether it is goal-conditioned.
        counted: Whether ``goal_layout`` says that all strips have a goal; else only the first one has.
    """

    metadata = {"render_modes": [], "render_fps": 10}  # noqa: RUF012

    def __init__(self, strips: int = 2, goals: bool = True, counted: bool = True) -> None:
        self.strips, self.goals, self.hidden = strips, goals, set[int]()
        self.camera_model = CameraModel(INTRINSICS, tilted(0))
        self.counted = strips if counted else 1
        self.goal_layout = {"kind": "centerline", **({"count": strips} if counted else {})}
        self.action_space = gym.spaces.Box(-1.0, 1.0, (strips,), np.float32)
        limits = {"units": ["m"] * strips, "scale": [0.01] * strips, "low": [-1.0] * strips, "high": [1.0] * strips}
        self.action_spec = ActionSpec.from_dict({"names": [f"strip{k}" for k in range(strips)], **limits})
        images = {
            "rgb": gym.spaces.Box(0, 255, (120, 160, 3), np.uint8),
            "depth": gym.spaces.Box(0.0, 10.0, (120, 160), np.float32),
        }
        goal = gym.spaces.Box(-1.0, 1.0, (self.counted * POINTS * 3,), np.float32)
        self.observation_space = gym.spaces.Dict(
            {**images, **({"achieved_goal": goal, "desired_goal": goal} if goals else {})}
        )
        self.start = self.end = self.way = np.zeros(strips)

    def points(self, place: np.ndarray, cut: float = 0.0) -> np.ndarray:
        """Return points ``(strips, 9, 3)`` for places along y, without ``cut`` metres at the ends."""
        x = np.linspace(-0.12 + cut, 0.12 - cut, POINTS)
        y = place[:, None] + np.linspace(-0.1, 0.1, self.strips)[:, None] + 0.02 * np.cos(12 * x)
        return np.stack([np.broadcast_to(x, y.shape), y, np.zeros_like(y)], axis=-1)

    @property
    def anchors(self) -> dict[str, tuple[float, float, float]]:
        """Where each strip begins."""
        ends = self.points(self.start + self.way * (self.end - self.start))[:, 0].tolist()
        return {f"gripper{k}": (x, y, z) for k, (x, y, z) in enumerate(ends)}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.start, self.end = self.np_random.uniform(-0.02, 0.02, (2, self.strips))
        self.end = self.end + np.where(self.end > self.start, 0.01, -0.01)
        self.way = np.zeros(self.strips)
        return self._observe(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.way = np.clip(self.way + 0.1 * np.asarray(action), 0, 1)
        return self._observe(), 0.0, False, False, {}

    compute_reward = FlatGoalEnv.compute_reward

    def _observe(self) -> dict[str, np.ndarray]:
        place = self.start + self.way * (self.end - self.start)
        strips = self.points(place)
        rgb = np.full((120, 160, 3), 150, np.uint8)
        for k, strip in enumerate(self.points(place, CAP)):
            if k not in self.hidden:
                pixels = np.rint(16 * self.camera_model.project_from_base(strip)).astype(np.int32)
                cv2.polylines(rgb, [pixels], False, (200, 40, 30), 6, cv2.LINE_AA, 4)
        seen = {"rgb": rgb, "depth": np.full((120, 160), 0.6, np.float32)}
        if not self.goals:
            return seen
        both = strips[: self.counted], self.points(self.end)[: self.counted]
        achieved, desired = (each.astype(np.float32).ravel() for each in both)
        return {**seen, "achieved_goal": achieved, "desired_goal": desired}


def observing_strips(strips: int = 2, **options: Any) -> ShapeObservation:
    """Return an env that observes strips in slots ``strip0``, ``strip1``, ...: slot k holds strip k."""
    shape = {
        "kind": "centerline", "name": "strip", "n": 12, "ends": "tips", "spacing": "m", "count": strips,
        "anchor": {f"strip{k}": f"gripper{k}" for k in range(strips)},
    }  # fmt: skip
    return ShapeObservation(StripsEnv(strips, **options), [shape], RED, [BASE, "ok"])
