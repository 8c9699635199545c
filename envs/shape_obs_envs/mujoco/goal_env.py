"""What the goal-conditioned shape environments share: spaces, reward, camera and its published facts."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from shape_obs.camera import CameraModel
from shape_obs_envs.arguments import one_of
from shape_obs_envs.mujoco.cameras import RENDERERS, Camera, open_camera
from shape_obs_envs.mujoco.cameras.gl_context import GLUnavailableError
from shape_obs_envs.mujoco.scene import TIMESTEP, camera_model, camera_spec

Array = NDArray[np.float64]
REWARDS = ("dense", "sparse")
SUBSTEPS = 5
#: Points of a goal.
POINTS = 20
#: Every point of the object stays within these, base frame [m].
POINTS_LOW, POINTS_HIGH = (-0.4, -0.4, 0.0), (0.4, 0.4, 0.1)


def mean_point_distance(achieved: Any, desired: Any) -> Array:
    """Mean distance [m] of corresponding points of two flat point lists (..., 3 n); shape (...,)."""
    achieved, desired = np.asarray(achieved, np.float64), np.asarray(desired, np.float64)
    if achieved.shape != desired.shape or achieved.ndim == 0 or achieved.shape[-1] == 0 or achieved.shape[-1] % 3:
        raise ValueError(
            "expected two goals of equal shape (..., 3 n), x y z of each point in a row, "
            f"got {achieved.shape} and {desired.shape}"
        )
    apart = (achieved - desired).reshape(*achieved.shape[:-1], -1, 3)
    return np.sqrt((apart**2).sum(axis=-1)).mean(axis=-1)


class ShapeGoalEnv(gym.Env[Any, NDArray[np.float32]], abc.ABC):
    """Base of the simulated environments: bring a deformable object into a goal shape under one RGB-D camera.

    A subclass builds `self._model` and `self._data`, sets `action_space`, calls `_define_observation`, and fills in
    the abstract methods.

    Args:
        camera: "rl" (160 x 120), "d455" (640 x 480) or [width, height] in pixels.
        renderer: "gl", "rays", or "auto" for OpenGL where there is one.
        reward_type: "dense" or "sparse".
        render_mode: None or "rgb_array".
        success_threshold: Mean point distance [m] under which the goal counts as reached.

    Raises:
        ValueError: An argument is out of its range; the message says what it takes.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 20}  # type: ignore[misc]
    _model: Any
    _data: Any

    def __init__(
        self,
        camera: str | Sequence[int] = "rl",
        renderer: str = "auto",
        reward_type: str = "dense",
        render_mode: str | None = None,
        success_threshold: float = 0.01,
    ) -> None:
        self._camera_spec = camera_spec(camera)
        self._renderer = one_of("renderer", renderer, RENDERERS)
        self.reward_type = one_of("reward_type", reward_type, REWARDS)
        self.render_mode = one_of("render_mode", render_mode, (None, "rgb_array"))
        number = isinstance(success_threshold, (int, float)) and not isinstance(success_threshold, bool)
        if not (number and 0 < success_threshold < float("inf")):
            raise ValueError(
                f"success_threshold: expected a distance in metres above 0, got {success_threshold!r}. "
                "The default is 0.01, one centimetre."
            )
        self.success_threshold = float(success_threshold)
        self._camera: Camera | None = None
        self._rgb: NDArray[np.uint8] | None = None
        self._goal = np.zeros(3 * POINTS, np.float32)

    # ---- for the subclass

    @abc.abstractmethod
    def _start(self) -> None:
        """Draw a start state from `np_random` and put the physics there."""

    @abc.abstractmethod
    def _draw_goal(self) -> Array:
        """Draw a reachable goal shape (POINTS, 3) [m] from `np_random`; leaves the physics where they are."""

    @abc.abstractmethod
    def _move(self, action: Array) -> None:
        """Advance the physics by one step of `dt` under `action`, which is in its space."""

    @abc.abstractmethod
    def _gripper(self) -> NDArray[np.float32]:
        """The measured gripper poses, flat."""

    @abc.abstractmethod
    def truth(self, n: int = POINTS, frame: str = "world", ends: str = "tips", surface: bool = False) -> Array:
        """True points of the object."""

    def _define_observation(self, gripper: gym.spaces.Box) -> None:
        height, width = self._camera_spec.height, self._camera_spec.width
        low, high = (np.tile(np.asarray(corner, np.float32), POINTS) for corner in (POINTS_LOW, POINTS_HIGH))
        self.observation_space = gym.spaces.Dict(
            {
                "rgb": gym.spaces.Box(0, 255, (height, width, 3), np.uint8),
                "depth": gym.spaces.Box(0, 65535, (height, width), np.uint16),
                "gripper": gripper,
                "achieved_goal": gym.spaces.Box(low, high, dtype=np.float32),
                "desired_goal": gym.spaces.Box(low, high, dtype=np.float32),
            }
        )

    # ---- gymnasium

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Draw a start state and a goal that can be reached from it.

        Raises:
            ValueError: `options` has a key: there are none yet.
        """
        super().reset(seed=seed)
        if options:
            keys = ", ".join(map(repr, options))
            raise ValueError(f"options: expected none, got {keys}. Start and goal are drawn from the seed: pass seed=.")
        self._start()
        self._goal = self._draw_goal().astype(np.float32).ravel()
        observation = self._observe()
        return observation, self._info(observation)

    def step(self, action: NDArray[np.float32]) -> tuple[dict[str, NDArray[Any]], float, bool, bool, dict[str, Any]]:
        """Move the grippers by `action`, clipped to its space, for `dt` seconds.

        Raises:
            ValueError: `action` has another shape than the action space, or is not finite.
        """
        space = self.action_space
        assert isinstance(space, gym.spaces.Box)
        move = np.asarray(action, np.float64)
        if move.shape != space.shape or not np.isfinite(move).all():
            raise ValueError(f"action: expected {space.shape} finite numbers in [-1, 1], got {action!r}")
        self._move(np.clip(move, space.low, space.high))
        observation = self._observe()
        info = self._info(observation)
        reward = self.compute_reward(observation["achieved_goal"], observation["desired_goal"], info)
        return observation, reward, False, False, info

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """Reward of goals (..., 3 n), flat points in metres; a float for single goals, else an array (...,).

        Dense: minus the mean point distance [m]. Sparse: 0 where that is below `success_threshold`, else -1.
        `info` is not used.
        """
        distance = mean_point_distance(achieved_goal, desired_goal)
        reward = -distance if self.reward_type == "dense" else np.where(distance < self.success_threshold, 0.0, -1.0)
        return float(reward) if reward.ndim == 0 else reward

    def render(self) -> NDArray[np.uint8] | None:  # type: ignore[override]
        """The camera's picture, (H, W, 3) uint8 RGB, with `render_mode="rgb_array"`; else None and a warning."""
        if self.render_mode is None:
            gym.logger.warn('render() without a render mode: make the environment with render_mode="rgb_array".')
            return None
        return None if self._rgb is None else self._rgb.copy()

    def close(self) -> None:
        """Free the camera; a later `reset` opens it again."""
        if self._camera is not None:
            self._camera.close()
            self._camera = None

    # ---- published

    @property
    def dt(self) -> float:
        """Duration of a step [s]."""
        return SUBSTEPS * TIMESTEP

    @property
    def camera_model(self) -> CameraModel:
        """Intrinsics and pose of the camera; p_base = T p_camera."""
        return camera_model(self._camera_spec, self._model, self._data)

    # ---- inside

    def _observe(self) -> dict[str, NDArray[Any]]:
        rgb, depth = self._capture()
        self._rgb = rgb
        # millimetres as a depth camera gives them; beyond its range is invalid
        millimetres = np.rint(depth * 1000)
        return {
            "rgb": rgb.copy(),
            "depth": np.where(millimetres <= 65535, millimetres, 0).astype(np.uint16),
            "gripper": self._gripper(),
            "achieved_goal": self.truth().astype(np.float32).ravel(),
            "desired_goal": self._goal.copy(),
        }

    def _capture(self) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        # Opened here and not in __init__: vector environments build one in the parent process only to read spaces.
        if self._camera is None:
            self._camera = open_camera(self._renderer, self._camera_spec, self._model)
        try:
            return self._camera.render(self._data)
        except GLUnavailableError:  # in a forked worker; rays work there
            if self._renderer != "auto":
                raise
            self._camera = open_camera(self._renderer, self._camera_spec, self._model)
            return self._camera.render(self._data)

    def _info(self, observation: dict[str, NDArray[Any]]) -> dict[str, Any]:
        distance = float(mean_point_distance(observation["achieved_goal"], observation["desired_goal"]))
        return {
            "is_success": distance < self.success_threshold,
            "truth/points": observation["achieved_goal"].reshape(-1, 3).copy(),
            "truth/mean_error": distance,
        }
