"""ShapeObservation: RGB-D observations in, a shape vector out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import gymnasium as gym
from gymnasium.utils import RecordConstructorArgs

from shape_obs.camera import CameraModel, Intrinsics
from shape_obs.detector import ShapeDetector
from shape_obs.features import Feature, FeatureVector, View, read_features
from shape_obs.shape import Detection
from shape_obs.wrappers.env_protocol import Images, anchors, base_point, camera_model, published, seconds_per_step
from shape_obs.wrappers.goals import goal_vector, target_shape
from shape_obs.wrappers.layout import Layout, scalars
from shape_obs.wrappers.recording import OWN, check_names, plain, read_camera

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

    Example:
        >>> env = ShapeObservation(gym.make("shape_obs_envs:ShapeObs/Cable-v0"))  # doctest: +SKIP
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

        chosen = {"on_invalid": "interpolate", "dt": seconds_per_step(env), "anchor": next(iter(anchors(env)), None)}
        chosen |= {**published(env, "shape_obs_defaults", {}), **given}
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
        self._camera = self._given_camera or camera_model(env)
        height, width = self._images.size
        self._view = View(width, height, self._camera, own["workspace"], self.detector.config.max_age)
        in_3d = self._images.depth_key is not None and self._camera is not None
        parsed = read_features(own["features"] or ("points3d" if in_3d else "points2d_normalized"))
        if self._images.depth_key is None and any(feature.needs_depth for feature in parsed):
            raise ValueError("features need depth, but the observation has no 'depth'; pass depth_key=.")
        self._vector = FeatureVector(parsed, self.detector.shapes, self._view)
        self._goal = goal_vector(env.observation_space, parsed, self.detector.shapes, self._view)
        self._layout = Layout(env.observation_space, own["keep"] or (), self._vector, self._goal)
        self.observation_space = self._layout.space
        self.detection: Detection | None = None
        self._time = 0.0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the env and forget the track."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._camera = self._given_camera or camera_model(self.env)
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
        named = anchors(self.env)
        stamp = info.get("stamp", self._time)
        detection = self.detector.detect(rgb, depth, self._camera, stamp=stamp, anchors=named)
        self.detection = detection
        info.update(scalars(detection))
        views = [replace(self._view, camera=self._camera, anchor=base_point(s, named)) for s in self.detector.shapes]
        values = self._vector.compute(detection.shapes, views)
        if self._goal is None or self._camera is None:
            return self._layout.compose(values, observation)
        target = target_shape(observation["desired_goal"], self.detector.shapes[0], self._camera)
        goals = [self._goal.compute([shape], views[:1]) for shape in (detection.shapes[0], target)]
        return self._layout.compose(values, observation, goals)
