"""Base class of the goal-conditioned shape environments: spaces, reset, step and reward."""

from __future__ import annotations

import abc
import copy
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from shape_obs.camera import CameraModel
from shape_obs_envs.arguments import one_of, positive
from shape_obs_envs.mujoco.bodies import Body
from shape_obs_envs.mujoco.cameras import RENDERERS
from shape_obs_envs.mujoco.goals import (
    DIFFICULTIES,
    SETTLING,
    TABLE,
    Actions,
    Corner,
    Difficulty,
    actions_towards,
    draw_goal,
    mean_point_distance,
    read_options,
    smooth_actions,
)
from shape_obs_envs.mujoco.randomization import Randomizer
from shape_obs_envs.mujoco.randomization.factors import Scene
from shape_obs_envs.mujoco.rendering import RENDER_MODES, Rendering, has_display
from shape_obs_envs.mujoco.scene import TIMESTEP, camera_model, camera_spec, compile_scene
from shape_obs_envs.mujoco.workspace import Workspace, gripper_spec

Array = NDArray[np.float64]
Observation = dict[str, NDArray[Any]]
REWARDS = ("dense", "sparse")
SUBSTEPS = 5


class ShapeGoalEnv(gym.Env[Any, NDArray[np.float32]], abc.ABC):
    """Base of the simulated environments: bring a deformable object into a goal shape under one RGB-D camera.

    A subclass builds a model and its ``Body``, calls ``_install``, and implements the abstract methods.

    Args:
        camera: "rl" (160 x 120), "d455" (640 x 480) or [width, height] in pixels.
        renderer: "gl", "rays", or "auto" for OpenGL if available.
        reward_type: "dense" or "sparse".
        render_mode: None, "rgb_array", "rgbd_tuple" or "human".
        success_threshold: Mean point distance in metres below which the goal counts as reached.
        difficulty: "near", "middle" or "far": distance of goals from the start.
        render_observation: False omits the images from the observation and renders nothing.
        render_size: Size of the images that ``render`` returns, like ``camera``; None for the observation's.
        randomize: True draws new light, appearance, camera, material, distractors and a hand at each reset; a mapping
            selects factors and their strength. See docs/how-to/randomise-a-simulation.md.

    Raises:
        ValueError: An argument is out of its range.

    Attributes:
        action_spec: Meaning of an action: displacements of the grippers, base frame.
        goal_actions: Actions of shape ``(T, A)`` that lead from the last start state to its goal, where the object
            comes to rest within a second: a demonstration. Empty if the goal was given.
    """

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES), "render_fps": 20}  # noqa: RUF012
    #: Largest motion of a gripper in one step.
    STEP: Array
    #: Two corners in metres of a box that always contains the object, base frame.
    REACH: ClassVar[tuple[Corner, Corner]]
    #: Bounds of the points of a goal in metres, base frame.
    BOUNDS: ClassVar[tuple[Corner, Corner]] = TABLE
    #: Distance of goals from the start, for each `difficulty`.
    GOALS: ClassVar[Mapping[str, Difficulty]] = DIFFICULTIES

    _body: Body
    _workspace: Workspace
    #: Fields of ``CameraSpec`` that differ from its defaults; set before ``__init__``.
    _view: Mapping[str, Any] = MappingProxyType({})

    def __init__(
        self,
        *,
        camera: str | Sequence[int] = "rl",
        renderer: str = "auto",
        reward_type: str = "dense",
        render_mode: str | None = None,
        success_threshold: float = 0.01,
        difficulty: str = "middle",
        render_observation: bool = True,
        render_size: str | Sequence[int] | None = None,
        randomize: bool | Mapping[str, Any] = False,
    ) -> None:
        self._camera_spec = camera_spec(camera, **self._view)
        display = camera_spec(camera if render_size is None else render_size, "render_size", **self._view)
        self.reward_type = one_of("reward_type", reward_type, REWARDS)
        self.render_mode = one_of("render_mode", render_mode, (None, *RENDER_MODES))
        self.success_threshold = positive("success_threshold", success_threshold, "0.01, one centimetre")
        self.difficulty = difficulty
        self.render_observation = one_of("render_observation", render_observation, (True, False))
        self._randomizer = Randomizer(randomize)
        # Only modes that work here: environment checkers try every mode, and a window needs a display.
        modes = [mode for mode in RENDER_MODES if mode != "human" or has_display()]
        self.metadata = {**type(self).metadata, "render_modes": modes}
        self._rendering = Rendering(one_of("renderer", renderer, RENDERERS), self._camera_spec, display, self.dt)

    # ---- implemented by subclasses

    @abc.abstractmethod
    def _draw_start(self) -> Array:
        """Draw a start state from ``np_random``, set the physics to it, and return the gripper poses ``(G, D)``."""

    @abc.abstractmethod
    def _draw_bend(self) -> Array:
        """Draw poses ``(G, D)`` in the workspace that lead to an S bend or a fold."""

    @abc.abstractmethod
    def _goal_points(self) -> Array:
        """Return the points ``(n, 3)``, in metres, that are compared with the goal."""

    @abc.abstractmethod
    def _gripper(self) -> NDArray[np.float32]:
        """Return the measured gripper poses, flat."""

    def _compile(self, bodies: str, equality: str = "", sections: str = "") -> Any:
        """Compile the scene from MJCF parts, with those of the randomisation."""
        extra = self._randomizer
        return compile_scene(self._camera_spec, bodies + extra.bodies(), equality, sections + extra.sections())

    def _install(self, body: Body, workspace: Workspace, gripper: gym.spaces.Box) -> None:
        """Install the object, its workspace, and the space of the observation's ``gripper``."""
        self._body, self._workspace = body, workspace
        self.action_spec = gripper_spec(body, workspace, self.STEP)
        self._randomizer.bind(Scene(body, self._camera_spec, self.REACH, self._goal_points))
        body.refresh()
        self._target = body.gripper_poses()
        self._goal = self._goal_points().astype(np.float32).ravel()
        self.action_space = gym.spaces.Box(-1.0, 1.0, (self._target.size,), np.float32)
        self.goal_actions: Actions = np.zeros((0, self._target.size), np.float32)
        count = len(self._goal) // 3
        low, high = (np.tile(np.asarray(corner, np.float32), count) for corner in self.BOUNDS)
        height, width = self._camera_spec.height, self._camera_spec.width
        images = {
            "rgb": gym.spaces.Box(0, 255, (height, width, 3), np.uint8),
            "depth": gym.spaces.Box(0, 65535, (height, width), np.uint16),
        }
        goals = {key: gym.spaces.Box(low, high, dtype=np.float32) for key in ("achieved_goal", "desired_goal")}
        seen = images if self.render_observation else {}
        self.observation_space = gym.spaces.Dict({**seen, "gripper": gripper, **goals})

    # ---- gymnasium

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Draw a start state and a goal that can be reached from it, or use those given.

        Args:
            seed: Seed of the random numbers.
            options: "start": a result of ``get_state``; "goal": the points of a goal in metres, flat or ``(n, 3)``.

        Raises:
            ValueError: An option is unknown, or start or goal are invalid.
        """
        super().reset(seed=seed)
        given = read_options(options or {}, self.observation_space["desired_goal"])  # type: ignore[index]
        self._randomizer.draw_physics(self.np_random)
        if given["start"] is None:
            self._target = self._draw_start()
        else:
            self._body.set_state(given["start"])
            self._target = self._body.gripper_targets()
        if given["goal"] is None:
            goal = draw_goal(self.GOALS[self.difficulty], self._goal_points(), self._draw_motion, self._rehearse)
            self._goal, self.goal_actions = goal.points.astype(np.float32).ravel(), goal.actions
        else:
            self._goal, self.goal_actions = given["goal"], self.goal_actions[:0]
        if self._randomizer.draw_appearance():
            self._rendering.refresh()
        self._rendering.show(self._body, self.render_mode)
        observation = self._observe()
        return observation, self._info(observation)

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Move the grippers by ``action``, clipped to its space, for ``dt`` seconds.

        Raises:
            ValueError: ``action`` has another shape than the action space, or is not finite.
        """
        move = np.asarray(action, np.float64)
        if move.shape != self.action_space.shape or not np.isfinite(move).all():
            raise ValueError(f"action: expected {self.action_space.shape} finite numbers in [-1, 1], got {action!r}")
        self._move(np.clip(move, -1.0, 1.0))
        self._randomizer.advance()
        self._rendering.show(self._body, self.render_mode)
        observation = self._observe()
        info = self._info(observation)
        reward = self.compute_reward(observation["achieved_goal"], observation["desired_goal"], info)
        return observation, reward, False, False, info

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """Return the reward of goals ``(..., 3 n)``, flat points in metres; a float for single goals, or an array.

        Dense: minus the mean point distance in metres. Sparse: 0 if that is below ``success_threshold``, otherwise -1.
        ``info`` is not used.
        """
        distance = mean_point_distance(achieved_goal, desired_goal)
        reward = -distance if self.reward_type == "dense" else np.where(distance < self.success_threshold, 0.0, -1.0)
        return float(reward) if reward.ndim == 0 else reward

    def render(self) -> Any:
        """Return the camera's image ``(H, W, 3)`` uint8 RGB, and with "rgbd_tuple" also depth ``(H, W)`` in metres.

        With "human" MuJoCo's viewer shows the scene, and None is returned.
        """
        if self.render_mode is None:
            gym.logger.warn('render() without a render mode: make the environment with render_mode="rgb_array".')
            return None
        return self._rendering.render(self._body, self.render_mode)

    def close(self) -> None:
        """Free the camera; a later ``reset`` reopens it."""
        self._rendering.close()

    # ---- published

    @property
    def difficulty(self) -> str:
        """Distance of goals from the start; may be set between episodes."""
        return self._difficulty

    @difficulty.setter
    def difficulty(self, value: str) -> None:
        self._difficulty: str = one_of("difficulty", value, DIFFICULTIES)

    @property
    def dt(self) -> float:
        """Duration of a step in seconds."""
        return SUBSTEPS * TIMESTEP

    @property
    def camera_model(self) -> CameraModel:
        """Intrinsics and pose of the camera; p_base = T p_camera."""
        return camera_model(self._camera_spec, self._body.model, self._body.data)

    @property
    def randomization(self) -> dict[str, Any]:
        """A copy of the values drawn at the last reset, by factor; empty without ``randomize``."""
        return copy.deepcopy(self._randomizer.drawn)

    def get_state(self) -> Array:
        """Return the physics state, for ``reset(options={"start": ...})`` of an environment with the same arguments."""
        return self._body.get_state()

    # ---- internal

    @property
    def _eye(self) -> Array:
        """Where the camera stands, ``(3,)`` metres, world frame."""
        transform = self.camera_model.transform_camera_to_base
        assert transform is not None
        return transform[:3, 3]

    def _in_frame(self, points: Array, frame: str) -> Array:
        """Return points ``(n, 3)`` of the world frame in one of the frames of ``truth``."""
        one_of("frame", frame, ("world", "camera", "pixels"))
        if frame == "world":
            return points
        camera = self.camera_model
        return camera.from_base(points) if frame == "camera" else camera.project_from_base(points)

    def _move(self, action: Array) -> None:
        target = self._workspace.clip(self._target + action.reshape(self._target.shape) * self.STEP, self._target)
        self._body.step_to(self._target, target, SUBSTEPS)
        self._target = target

    def _draw_motion(self, vigour: float, bent: bool) -> Actions:
        if bent:
            return actions_towards(self.np_random, self._target, self._draw_bend(), self.STEP)
        return smooth_actions(self.np_random, self._target.size, vigour)

    def _rehearse(self, actions: Actions) -> tuple[Array, Array]:
        """Return the points after ``actions``, shortly before and at the end of the rest; restore the physics."""
        start, target = self._body.get_state(), self._target
        last = SETTLING // 4
        for action in [*actions.astype(np.float64), *np.zeros((SETTLING - last, self._target.size))]:
            self._move(action)
        nearly = self._goal_points()
        for _ in range(last):
            self._move(np.zeros(self._target.size))
        goal = self._goal_points()
        self._body.set_state(start)
        self._target = target
        return nearly, goal

    def _observe(self) -> Observation:
        images = self._rendering.observe(self._body) if self.render_observation else {}
        return {
            **images,
            "gripper": self._gripper(),
            "achieved_goal": self._goal_points().astype(np.float32).ravel(),
            "desired_goal": self._goal.copy(),
        }

    def _info(self, observation: Observation) -> dict[str, Any]:
        distance = float(mean_point_distance(observation["achieved_goal"], observation["desired_goal"]))
        return {
            "is_success": distance < self.success_threshold,
            "truth/points": observation["achieved_goal"].reshape(-1, 3).copy(),
            "truth/mean_error": distance,
        }


def even_fractions(n: int, ends: str) -> Array:
    """Return ``n`` even fractions of a length: from tip to tip, or in the middle of n equal parts."""
    one_of("ends", ends, ("tips", "centers"))
    return np.linspace(0.0, 1.0, n) if ends == "tips" else (np.arange(n) + 0.5) / n
