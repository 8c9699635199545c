"""The worlds in which laws are tested: the images of a D455, with disturbances, and the points of the simulator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from shape_obs.bench.env_physics import make_env
from shape_obs.bench.servo.settings import Disturbance, Setting, feature_set
from shape_obs.configurations.base import Configuration
from shape_obs.detector import ShapeDetector
from shape_obs.features import Feature, FeatureContext, read_features
from shape_obs.shape import Detection, Shape
from shape_obs.wrappers import ShapeGoal, ShapeObservation, env_protocol
from shape_obs.wrappers.goal_points import shape_at
from shape_obs.wrappers.goals import EnvGoal, GoalVector
from shape_obs.wrappers.shape_goal import record_goal

Mask = npt.NDArray[np.bool_]
#: Separates the lost points from everything that the environment draws from the same seed.
_STREAM: Final = 0x1057
#: Steps at rest before a goal is recorded.
SETTLING: Final = 20


class Disturbed(gym.ObservationWrapper[Any, Any, Any]):
    """Black out frames of an RGB-D env, and draw the lost points, equal in all episodes of one seed.

    Args:
        env: An environment whose observation has ``rgb`` and ``depth``.
        disturbance: The disturbance.

    Attributes:
        dark: Whether the last frame was black.
    """

    def __init__(self, env: gym.Env[Any, Any], disturbance: Disturbance) -> None:
        super().__init__(env)
        disturbance.check()
        self._disturbance = disturbance
        self._rng = np.random.default_rng(_STREAM)
        self._step = 0
        self.dark = False

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the env; a seed also seeds the lost points."""
        if seed is not None:
            self._rng = np.random.default_rng((_STREAM, seed))
        self._step = -1
        return super().reset(seed=seed, options=options)

    def observation(self, observation: Any) -> Any:
        """Return the observation, or black images, and advance the disturbance by one frame."""
        self._step += 1
        first, count = self._disturbance.blackout or (0, 0)
        self.dark = first <= self._step < first + count
        if not self.dark:
            return observation
        return {**observation, **{key: np.zeros_like(observation[key]) for key in ("rgb", "depth")}}

    def lost(self, count: int) -> Mask:
        """Draw the points that are lost in this frame, (count,)."""
        return self._rng.random(count) < self._disturbance.invalid


class LosingDetector(ShapeDetector):
    """A detector that loses detected points and interpolates them from the others.

    Args:
        lost: Takes N, returns the lost points, (N,).
        config: The arguments of ``ShapeDetector``.
    """

    def __init__(self, lost: Callable[[int], Mask], **config: Any) -> None:
        self._lost = lost
        super().__init__(**config)

    def detect(self, *args: Any, **options: Any) -> Detection:
        """Detect the shapes and lose points."""
        detection = super().detect(*args, **options)
        return replace(detection, shapes=tuple(without(shape, self._lost(len(shape))) for shape in detection))


def without(shape: Shape, lost: Mask) -> Shape:
    """Return a shape in which some points are interpolated and neither visible nor valid; a held shape is unchanged.

    Args:
        shape: The detected shape.
        lost: The lost points, (N,); ignored if no valid point would be left.
    """
    left = shape.valid & ~lost
    if shape.reason or not left.any():
        return shape
    known = ~lost
    return replace(
        shape,
        points2d=shape.layout.interpolate(shape.pixels, known),
        points3d=None if shape.points3d is None else shape.layout.interpolate(shape.points3d, known),
        visible=shape.visible & ~lost,
        valid=left,
    )


class World(NamedTuple):
    """An env whose observation has ``achieved_goal`` and ``desired_goal`` in the features of a setting.

    ``info`` has ``truth/mean_error``, the mean distance of the true points from the true goal in metres, and
    ``truth/points`` and ``truth/goal``, (N, 3) metres, base frame. Equal seeds give equal episodes in all worlds.

    Args:
        env: The env; it never ends an episode by itself.
        features: The features of the goals.
        spec: The configuration of the shape.
        seen: Returns the shape of the last observation.
        view: Returns the context of its features.
        milliseconds: Returns the detector's time for it; None without a detector.
        dark: Returns whether the last frame was black.
    """

    env: gym.Env[Any, Any]
    features: tuple[Feature, ...]
    spec: Configuration
    seen: Callable[[], Shape]
    view: Callable[[], FeatureContext]
    milliseconds: Callable[[], float | None]
    dark: Callable[[], bool]


def world(setting: Setting) -> World:
    """Make the world of a setting.

    Raises:
        ValueError: The setting has features that do not exist for the environment, or is otherwise not understood.
    """
    specs = feature_set(setting.env, setting.features, setting.pca)
    if specs is None:
        raise ValueError(f"there are no features {setting.features!r} of {setting.env}.")
    features = read_features(specs)
    return (_true_world if setting.source == "truth" else _camera_world)(setting, features)


class Witness(gym.Wrapper[Any, Any, Any, Any]):
    """Add the true goal to ``info``, which no policy reads."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the env."""
        observation, info = self.env.reset(seed=seed, options=options)
        info["truth/goal"] = np.asarray(observation["desired_goal"]).reshape(-1, 3).copy()
        return observation, info


class Taught(gym.Wrapper[Any, Any, Any, Any]):
    """Play the goal's own motion before each episode, and use the final image of it as the goal.

    Args:
        env: A simulated environment in a ``ShapeGoal``.
    """

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Play, record the goal, and reset to the same start."""
        self.env.reset(seed=seed, options=options)
        motion = self.get_wrapper_attr("goal_actions")
        for action in [*motion, *np.zeros((SETTLING, motion.shape[1]), np.float32)]:
            self.env.step(action)
        seen = record_goal(self.env, frame="base", unmeasured=True)
        return self.env.reset(seed=seed, options={**(options or {}), "goal": seen})


class TrueGoal(gym.Wrapper[Any, Any, Any, Any]):
    """Express goals in features of the true points, with the code that ``ShapeGoal`` uses for detected points.

    Args:
        env: A simulated environment, which need not render.
        features: The features of the goals.
        size: (width, height) of the image for features in pixels.

    Attributes:
        configuration: The configuration of the shape.
        shape: The true points as a shape, after ``reset``.
        view: The context of the features.
    """

    def __init__(self, env: gym.Env[Any, Any], features: Sequence[Feature], size: tuple[int, int]) -> None:
        super().__init__(env)
        defaults = env_protocol.defaults(env)
        self.configuration = Configuration.from_dict(defaults["shapes"][0])
        self.view = FeatureContext(*size, env_protocol.camera_model(env), defaults["workspace"])
        self._place()
        self._vector = GoalVector(features, self.configuration, self.view)
        space = env.observation_space
        assert isinstance(space, gym.spaces.Dict)
        # The target is located by the code of ShapeObservation, whatever the features are.
        metric = read_features(defaults["features"])
        known = EnvGoal.find(space, metric, [self.configuration], self.view, env_protocol.goal_layout(env))
        assert known is not None
        self._goal = known
        bounds = gym.spaces.Box(self._vector.low, self._vector.high, dtype=np.float32)
        self.observation_space = gym.spaces.Dict(dict.fromkeys(env_protocol.GOALS, bounds))
        self.shape: Shape | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the env."""
        observation, info = self.env.reset(seed=seed, options=options)
        self.view = replace(self.view, camera=env_protocol.camera_model(self.env))
        return self._observe(observation), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the env."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._observe(observation), float(reward), terminated, truncated, info

    def _place(self) -> None:
        named = env_protocol.anchors(self.env)
        self.view = replace(self.view, anchor=env_protocol.base_point(self.configuration, named), anchors=named)

    def _observe(self, observation: Any) -> dict[str, Any]:
        self._place()
        camera, simulator = self.view.camera, self.unwrapped
        assert camera is not None
        points = camera.from_base(simulator.truth())  # type: ignore[attr-defined]
        self.shape = shape_at(points, self.configuration, camera.intrinsics)
        target = self._goal.target(observation["desired_goal"], camera)
        return dict(zip(env_protocol.GOALS, self._vector.pair(self.shape, target, self.view), strict=True))


def _true_world(setting: Setting, features: Sequence[Feature]) -> World:
    options = {"camera": setting.pixels, "render_observation": False, "difficulty": setting.difficulty}
    env = TrueGoal(Witness(make_env(setting.env, options)), features, setting.pixels)

    def seen() -> Shape:
        assert env.shape is not None
        return env.shape

    return World(env, tuple(features), env.configuration, seen, lambda: env.view, lambda: None, lambda: False)


def _camera_world(setting: Setting, features: Sequence[Feature]) -> World:
    from shape_obs_envs.d455 import D455Noise

    options = {"camera": setting.pixels, "renderer": setting.renderer, "difficulty": setting.difficulty}
    disturbed = Disturbed(D455Noise(Witness(make_env(setting.env, options))), setting.disturbance)
    observing = ShapeObservation(disturbed)
    if setting.disturbance.invalid:
        observing.detector = LosingDetector(disturbed.lost, **observing.detector.config.to_dict())
    # A reward needs a threshold, but the reward is not used here.
    env: gym.Env[Any, Any] = ShapeGoal(observing, features=features, threshold=0.01)
    if setting.source == "taught":
        env = Taught(env)

    def seen() -> Shape:
        assert observing.detection is not None
        return observing.detection.shapes[0]

    def milliseconds() -> float | None:
        assert observing.detection is not None
        return observing.detection.timings["total"]

    spec = observing.detector.shapes[0]
    return World(env, tuple(features), spec, seen, lambda: observing.contexts[0], milliseconds, lambda: disturbed.dark)
