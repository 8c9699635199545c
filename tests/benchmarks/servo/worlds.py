"""The worlds in which laws are tested: the images of a D455, with disturbances, and the points of the simulator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from shape_obs.configurations.base import Configuration
from shape_obs.detector import ShapeDetector
from shape_obs.features import FeatureContext, read_features
from shape_obs.shape import Detection, Shape
from shape_obs.wrappers import ShapeGoal, ShapeObservation, env_protocol, record_goal
from shape_obs.wrappers.goal_points import shape_at
from tests.benchmarks.env_physics import make_env
from tests.benchmarks.servo.settings import Disturbance, Setting, feature_set

Array = npt.NDArray[np.float64]
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
        lost: Takes N, returns the lost points, ``(N,)``.
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
        lost: The lost points, ``(N,)``; ignored if no valid point would be left.
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


class TrueDetector(ShapeDetector):
    """Return the simulator's points as the detected shape, for any images.

    Args:
        truth: Returns the points, ``(N, 3)`` metres, base frame.
        config: The arguments of ``ShapeDetector``.
    """

    def __init__(self, truth: Callable[[], Array], **config: Any) -> None:
        self._truth = truth
        super().__init__(**config)

    def detect(self, *args: Any, stamp: float = 0.0, **options: Any) -> Detection:
        """Return the points; ``args`` are the images and the camera."""
        camera, spec = args[2], self.shapes[0]
        return Detection((shape_at(camera.from_base(self._truth()), spec, camera.intrinsics),), stamp)


class Unseen(gym.ObservationWrapper[Any, Any, Any]):
    """Add black images to the observation of a simulated environment that does not render.

    Args:
        env: The environment.
        size: (width, height) of the images in pixels.
    """

    def __init__(self, env: gym.Env[Any, Any], size: tuple[int, int]) -> None:
        super().__init__(env)
        width, height = size
        self._images = {"rgb": np.zeros((height, width, 3), np.uint8), "depth": np.zeros((height, width), np.uint16)}
        boxes = {key: gym.spaces.Box(0, 255, image.shape, image.dtype.type) for key, image in self._images.items()}
        assert isinstance(env.observation_space, gym.spaces.Dict)
        self.observation_space = gym.spaces.Dict({**env.observation_space.spaces, **boxes})

    def observation(self, observation: Any) -> Any:
        """Return the observation with the images."""
        return {**observation, **self._images}


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


class World:
    """An environment of a setting, with goals in its features.

    The observation has ``achieved_goal`` and ``desired_goal``; ``info`` has ``truth/mean_error``, the mean distance of
    the true points from the true goal in metres, and ``truth/points`` and ``truth/goal``, (N, 3) metres, base frame.
    Equal seeds give equal episodes in all worlds.

    Args:
        setting: The setting.

    Attributes:
        env: The env; it never ends an episode by itself.
        features: The features of the goals.
        spec: The configuration of the shape.
        coordinates: The values of an action that move the gripper of the named rope, and no other; None for all.

    Raises:
        ValueError: The setting has features that do not exist for the environment, or is otherwise not understood.
    """

    def __init__(self, setting: Setting) -> None:
        from shape_obs_envs.d455 import D455Noise

        specs = feature_set(setting.env, setting.features, setting.pca)
        if specs is None:
            raise ValueError(f"there are no features {setting.features!r} of {setting.env}.")
        is_true, wrong = setting.source == "truth", setting.disturbance
        options = {"camera": setting.pixels, "renderer": setting.renderer, "difficulty": setting.difficulty}
        options |= {name: value for name in ("view", "rope") if (value := getattr(setting, name)) is not None}
        env = Witness(make_env(setting.env, {**options, "render_observation": not is_true}))
        self._disturbed = Disturbed(Unseen(env, setting.pixels) if is_true else D455Noise(env), wrong)
        # The simulator's points are those of the shape with the goal, which other slots need not be known for.
        first = Configuration.from_dict(env_protocol.defaults(env)["shapes"][0]).slots()[0]
        self._observing = ShapeObservation(self._disturbed, [first] if is_true else None)
        config = self._observing.detector.config.to_dict()
        if is_true:
            self._observing.detector = TrueDetector(env.get_wrapper_attr("truth"), **config)
        elif wrong.invalid:
            self._observing.detector = LosingDetector(self._disturbed.lost, **config)
        rope, moved = getattr(env.unwrapped, "rope", None), env.get_wrapper_attr("STEP").size
        self.coordinates = None if rope is None else range(rope * moved, (rope + 1) * moved)
        self.features, self.spec = tuple(read_features(specs)), self._observing.detector.shapes[0]
        # A reward needs a threshold, but the reward is not used here.
        self.env: gym.Env[Any, Any] = ShapeGoal(self._observing, features=self.features, threshold=0.01)
        if setting.source == "taught":
            self.env = Taught(self.env)

    @property
    def seen(self) -> Shape:
        """The shape of the last observation."""
        assert self._observing.detection is not None
        return self._observing.detection.shapes[0]

    @property
    def view(self) -> FeatureContext:
        """The context of its features."""
        return self._observing.contexts[0]

    @property
    def milliseconds(self) -> float | None:
        """The detector's time for it; None without a detector."""
        assert self._observing.detection is not None
        return self._observing.detection.timings.get("total")

    @property
    def dark(self) -> bool:
        """Whether the last frame was black."""
        return self._disturbed.dark
