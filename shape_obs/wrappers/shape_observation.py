"""ShapeObservation: RGB-D observations in, a shape vector out.

Constructor arguments as JSON values, so that ``gym.make(env.spec)`` rebuilds the wrapped env.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs

from shape_obs import spec
from shape_obs.camera import CameraModel, Intrinsics, as_camera_model
from shape_obs.config import DetectorConfig
from shape_obs.detector import ShapeDetector
from shape_obs.features import Feature, FeatureContext, FeatureVector, read_features
from shape_obs.shape import Detection, Shape
from shape_obs.spec import SpecError, did_you_mean
from shape_obs.wrappers import env_protocol
from shape_obs.wrappers.env_protocol import Images
from shape_obs.wrappers.goals import EnvGoal
from shape_obs.wrappers.observation_layout import Layout, scalars

Corners = tuple[tuple[float, float, float], tuple[float, float, float]]


class ShapeObservation(gym.ObservationWrapper[Any, Any, Any], RecordConstructorArgs):
    """Replaces images by ordered points on the object, as a flat finite float32 ``Box``.

    Over a goal-conditioned env the observation is a Dict of ``observation`` (features and kept vectors),
    ``achieved_goal`` (from the camera) and ``desired_goal`` (the same feature of the target); the reward is computed
    from these two. With ``keep`` over any other env it is a Dict of ``shape`` and the kept keys.

    ``info`` gains ``shape/ok``, ``shape/age`` and, for each shape, ``shape/<name>/ok``, ``shape/<name>/valid_fraction``
    and ``shape/<name>/quality``. Times are no part of it, since equal seeds must give equal infos (Gymnasium's
    ``check_env`` insists): they are in ``detection.timings``.

    Args:
        env: Its observation is a Dict with an RGB image (and depth), or an RGB image. What it may publish stands in
            ``shape_obs.wrappers.env_protocol``; whatever is passed here wins over that.
        shapes: Configurations; default one centerline.
        segmentation: The pixel rule.
        features: Features of each shape; default ``points3d`` with depth and camera, else ``points2d_normalized``.
        camera: Intrinsics or camera model, for envs that publish none.
        keep: Keys of the env's observation to pass on.
        rgb_key: Key of the image, default ``"rgb"``.
        depth_key: Key of the depth image, uint16 millimetres or float metres; default ``"depth"`` where there is one.
        workspace: (low, high) corners in metres, base frame, that bound points in the base frame.
        options: The other fields of ``DetectorConfig``; ``on_invalid`` defaults to ``"interpolate"`` here.

    Attributes:
        detector: The ``ShapeDetector``; its state is the wrapper's.
        detection: What it found in the last observation; None before the first.
        features: Of each shape, in the order of the vector.
        blocks: What stands where in the vector: a ``Block`` for each feature of each shape.
        contexts: Camera and anchor of each shape in the last observation.
        target: The goal of a goal-conditioned env in the last observation, as a shape; else None.

    Example:
        >>> env = ShapeObservation(env, ["centerline"], HSVRange((90, 60, 30), (130, 255, 255)))  # doctest: +SKIP
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        shapes: Iterable[Any] | None = None,
        segmentation: Any = None,
        features: Iterable[Feature | Mapping[str, Any] | str] | None = None,
        *,
        camera: CameraModel | Intrinsics | Mapping[str, Any] | None = None,
        keep: Sequence[str] | None = None,
        rgb_key: str | None = None,
        depth_key: str | None = None,
        workspace: Corners | None = None,
        **options: Any,
    ) -> None:
        given = {"shapes": shapes, "segmentation": segmentation, "features": features, "camera": camera, "keep": keep}
        given |= {"rgb_key": rgb_key, "depth_key": depth_key, "workspace": workspace, **options}
        given = {name: plain(value) for name, value in given.items() if value is not None}
        RecordConstructorArgs.__init__(self, **given)
        gym.ObservationWrapper.__init__(self, env)

        chosen = {"on_invalid": "interpolate", **env_protocol.defaults(env), **given}
        check_names(chosen)
        for policy in ("on_missing", "on_invalid"):
            if chosen.get(policy) == "nan":
                raise ValueError(
                    f"{policy}='nan' would put NaN into observations; choose another, or use ShapeDetector."
                )
        own = {name: chosen.pop(name, None) for name in OWN}
        self.detector = ShapeDetector(**chosen)
        self._images = Images.find(env.observation_space, own["rgb_key"], own["depth_key"])
        self._given_camera = read_camera(own["camera"])
        camera = self._given_camera or env_protocol.camera_model(env)
        height, width = self._images.size
        self._context = context = FeatureContext(width, height, camera, own["workspace"], self.detector.config.max_age)
        in_3d = self._images.depth_key is not None and camera is not None
        self.features = tuple(read_features(own["features"] or ("points3d" if in_3d else "points2d_normalized")))
        if self._images.depth_key is None and any(feature.needs_depth for feature in self.features):
            raise ValueError("features need depth, but the observation has no 'depth'; pass depth_key=.")
        space, shapes = env.observation_space, self.detector.shapes
        self._vector = FeatureVector(self.features, shapes, context)
        self.blocks = self._vector.blocks
        self._goal = EnvGoal.find(space, self.features, shapes, context, env_protocol.goal_layout(env))
        self._layout = Layout(space, own["keep"] or (), self._vector, self._goal and self._goal.vector)
        self.observation_space = self._layout.space
        self.detection: Detection | None = None
        self.contexts = len(shapes) * [context]
        self.target: Shape | None = None
        self._time = 0.0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the env and forget the track."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._context = replace(self._context, camera=self._given_camera or env_protocol.camera_model(self.env))
        self.detector.reset()
        self._time = 0.0
        return self._observe(observation, info), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the env; the reward of a goal-conditioned env is computed from what the camera saw."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._time += self.detector.config.dt
        seen = self._observe(observation, info)
        if self._goal is not None:
            info["truth/reward"] = reward
            reward = self.compute_reward(seen["achieved_goal"], seen["desired_goal"], info)
        lost = self.detector.config.on_missing == "truncate" and not info["shape/ok"]
        return seen, reward, terminated, truncated or lost, info

    def observation(self, observation: Any) -> Any:
        """The shape vector of an observation, with the kept keys and goals; this takes the detector one frame on."""
        return self._observe(observation, {})

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """The env's reward for goals as this wrapper gives them: flat points in metres, batched as the env allows."""
        return self.env.get_wrapper_attr("compute_reward")(achieved_goal, desired_goal, info)

    def _observe(self, observation: Any, info: dict[str, Any]) -> Any:
        rgb, depth = self._images.read(observation)
        named, camera = env_protocol.anchors(self.env), self._context.camera
        stamp = info.get("stamp", self._time)
        self.detection = detection = self.detector.detect(rgb, depth, camera, stamp=stamp, anchors=named)
        info.update(scalars(detection))
        points = [env_protocol.base_point(spec, named) for spec in self.detector.shapes]
        self.contexts = [replace(self._context, anchor=point, anchors=named) for point in points]
        values = self._vector.compute(detection.shapes, self.contexts)
        if self._goal is None or camera is None:
            return self._layout.compose(values, observation)
        self.target = self._goal.target(observation["desired_goal"], camera)
        goals = self._goal.achieved(values), self._goal.vector.desired(self.target, self.contexts[0])
        return self._layout.compose(values, observation, goals)


OWN: Final = ("features", "camera", "keep", "rgb_key", "depth_key", "workspace")


def plain(value: Any) -> Any:
    """Specs, cameras, arrays and iterables -> dicts, lists and scalars."""
    if isinstance(value, CameraModel):
        transform = value.transform_camera_to_base
        return {"intrinsics": value.intrinsics.to_dict(), "transform_camera_to_base": spec.plain(transform)}
    return spec.plain(value)


def check_names(arguments: Iterable[str]) -> None:
    """Refuse what is neither an argument of the wrapper nor of the detector.

    Raises:
        SpecError: The nearest known name is told.
    """
    known = [*(field.name for field in dataclasses.fields(DetectorConfig)), *OWN]
    for name in arguments:
        if name not in known:
            raise SpecError(f"ShapeObservation: unknown argument {name!r}{did_you_mean(name, known)}")


def read_camera(value: CameraModel | Intrinsics | Mapping[str, Any] | None) -> CameraModel | None:
    """A camera from what ``plain`` made of it: a camera model's mapping, or bare intrinsics'."""
    if not isinstance(value, Mapping):
        return as_camera_model(value)
    if "intrinsics" not in value:
        return CameraModel(Intrinsics.from_dict(value))
    transform = value.get("transform_camera_to_base")
    return CameraModel(Intrinsics.from_dict(value["intrinsics"]), None if transform is None else np.asarray(transform))
