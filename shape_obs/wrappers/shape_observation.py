"""ShapeObservation: replace the images of an environment by the features of the detected shapes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs

from shape_obs.camera import CameraLike, CameraModel, as_camera_model
from shape_obs.detector import ShapeDetector
from shape_obs.features import Block, Feature, FeatureContext, FeatureVector, read_features
from shape_obs.features.coordinates import check_workspace
from shape_obs.features.feature import what_needs_depth
from shape_obs.shape import Detection, Shape
from shape_obs.wrappers import env_protocol
from shape_obs.wrappers.env_images import Images, Key
from shape_obs.wrappers.goals import EnvGoal
from shape_obs.wrappers.observation_layout import ObservationLayout
from shape_obs.wrappers.recorded_arguments import OWN, check_names, check_shapes, to_recorded

Corners = tuple[tuple[float, float, float], tuple[float, float, float]]


class ShapeObservation(gym.ObservationWrapper[Any, Any, Any], RecordConstructorArgs):
    """Replace images by ordered points on the object, as a flat finite float32 ``Box``.

    Over a goal-conditioned env the observation is a Dict of ``observation`` (features and kept vectors),
    ``achieved_goal`` (from the camera) and ``desired_goal`` (the same feature of the target); the reward is computed
    from these two. With ``keep`` over any other env it is a Dict of ``shape`` and the kept keys.

    ``info`` gains ``shape/ok``, ``shape/age`` and, for each shape, ``shape/<name>/ok``, ``shape/<name>/quality``,
    ``shape/<name>/valid_fraction``, ``shape/<name>/track_id`` and ``shape/<name>/sigma`` (of the point that is known
    least, in metres, or pixels without depth). Times are in ``detection.timings`` instead, because Gymnasium's
    ``check_env`` requires equal infos for equal seeds.

    Args:
        env: An env whose observation is an RGB image, or a Dict with an RGB image (and depth); ``Images`` lists the
            layouts that are read. What it may publish is listed in ``shape_obs.wrappers.env_protocol``; arguments given
            here take precedence.
        shapes: Configurations; default one centerline.
        segmentation: The segmentation rule, or a function ``(rgb, depth) -> mask`` at the top of a module, or its
            import path ``"module:function"``: ``env.spec`` records the path.
        features: Features of each shape; default ``points3d`` with depth and camera, else ``points2d_normalized``.
        camera: Intrinsics or camera model, for envs that publish none; or what ``as_camera_model`` makes one of.
        keep: Keys of the env's observation to pass on.
        rgb_key: Key of the image, default ``"rgb"``; of an image in a Dict within the Dict the keys on the way to it,
            ``("images", "rgb")`` or ``"images/rgb"``.
        depth_key: Key of the depth image, uint16 millimetres or float metres; default ``"depth"`` if it is an image.
        workspace: (low, high) corners in metres, base frame: the bounds of points in the base frame.
        options: The other fields of ``DetectorConfig``; ``on_invalid`` defaults to ``"interpolate"`` here.

    Attributes:
        detector: The ``ShapeDetector``; its state is the wrapper's state.
        detection: The detection in the last observation; None before the first.
        features: The features of each shape, in the order of the vector.
        blocks: The position of each feature of each shape in the vector, a ``Block`` each.
        targets: The goals of a goal-conditioned env in the last observation, a shape each; else empty.

    Raises:
        ValueError: An argument is unknown or does not fit the env, or a shape has no segmentation.

    Example:
        >>> env = ShapeObservation(env, ["centerline"], HSVRange((90, 60, 30), (130, 255, 255)))  # doctest: +SKIP
    """

    detector: ShapeDetector
    detection: Detection | None
    features: tuple[Feature, ...]
    blocks: tuple[Block, ...]
    targets: tuple[Shape, ...]

    def __init__(
        self,
        env: gym.Env[Any, Any],
        shapes: Iterable[Any] | None = None,
        segmentation: Any = None,
        features: Iterable[Feature | Mapping[str, Any] | str] | None = None,
        *,
        camera: CameraLike = None,
        keep: Sequence[str] | None = None,
        rgb_key: Key | None = None,
        depth_key: Key | None = None,
        workspace: Corners | None = None,
        **options: Any,
    ) -> None:
        gym.ObservationWrapper.__init__(self, env)
        published, keys = env_protocol.defaults(env), {"rgb_key": rgb_key, "depth_key": depth_key}
        keys = {name: published.get(name) if key is None else key for name, key in keys.items()}
        self._images = Images.find(env.observation_space, **keys)
        camera = as_camera_model(camera, self._images.size)
        given = {"shapes": shapes, "segmentation": segmentation, "features": features, "camera": camera, "keep": keep}
        given |= {"rgb_key": rgb_key, "depth_key": depth_key, "workspace": workspace, **options}
        given = {name: to_recorded(value) for name, value in given.items() if value is not None}
        RecordConstructorArgs.__init__(self, **given)

        chosen = {"on_invalid": "interpolate", **published, **given}
        check_names(chosen)
        for policy in ("on_missing", "on_invalid"):
            if chosen.get(policy) == "nan":
                raise ValueError(
                    f"{policy}='nan' would put NaN into observations; choose another policy, or use ShapeDetector."
                )
        own = {name: chosen.pop(name, None) for name in OWN}
        self.detector = ShapeDetector(**chosen)
        check_shapes(self.detector.config.filled())
        self._given_camera = camera or as_camera_model(own["camera"], self._images.size)
        camera = self._camera_of(env)
        height, width = self._images.size
        check_workspace(own["workspace"])
        context = FeatureContext(width, height, camera, own["workspace"], self.detector.config.max_age)
        in_3d = self._images.has_depth and camera is not None
        self.features = tuple(read_features(own["features"] or ("points3d" if in_3d else "points2d_normalized")))
        needs = what_needs_depth(self.detector.shapes, self.features) if not self._images.has_depth else []
        if needs:
            raise ValueError(
                f"the observation has no 'depth', but the config needs it: {', '.join(needs)}. Choose features in "
                "pixels, such as points2d_normalized, and spacing='px'; or pass depth_key= if it has another name."
            )
        space, shapes = env.observation_space, self.detector.shapes
        self._vector = FeatureVector(self.features, shapes, context)
        self.blocks = self._vector.blocks
        self._goal = EnvGoal.find(space, self.features, shapes, context, env_protocol.goal_layout(env))
        self._layout = ObservationLayout(space, own["keep"] or (), self._vector, self._goal and self._goal.vector)
        self.observation_space = self._layout.space
        self.detection = None
        self.targets = ()
        self._clock = env_protocol.EnvClock(env, given.get("dt"))
        self._begin(context)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the env and the track."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._begin_episode()
        return self._observe(observation, info), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the env; the reward of a goal-conditioned env is computed from the detected shape."""
        observation, reward, terminated, truncated, info = self._clock.step(action)
        if self._clock.was_reset:
            self._begin_episode()
        seen = self._observe(observation, info)
        if self._goal is not None:
            info["truth/reward"] = reward
            reward = self.compute_reward(seen["achieved_goal"], seen["desired_goal"], info)
        lost = self.detector.config.on_missing == "truncate" and not info["shape/ok"]
        return seen, reward, terminated, truncated or lost, info

    def observation(self, observation: Any) -> Any:
        """Return the wrapped observation of one of the env's; this advances the track by one frame."""
        return self._observe(observation, {})

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """Return the env's reward for goals of this wrapper: flat points in metres, batched if the env supports it."""
        return self.env.get_wrapper_attr("compute_reward")(achieved_goal, desired_goal, info)

    def named_features(self, values: Any) -> dict[str, dict[str, float]]:
        """Return the features of an observation, ``(D,)``, by feature and component, see ``FeatureVector.named``."""
        return self._vector.named(values)

    @property
    def contexts(self) -> list[FeatureContext]:
        """The context of each shape in the last observation: camera, image size and anchors."""
        if self._contexts is None:
            anchors = dict(self._anchors)
            points = [env_protocol.base_point(spec, anchors) for spec in self.detector.shapes]
            self._contexts = [replace(self._context, anchor=point, anchors=anchors) for point in points]
        return self._contexts

    @property
    def dt(self) -> float:
        """Duration of a step, seconds: as given, else with the repetitions by wrappers that are known or were seen."""
        return self._clock.dt

    @property
    def target(self) -> Shape | None:
        """The first of ``targets``; None without any."""
        return self.targets[0] if self.targets else None

    @property
    def goal_count(self) -> int:
        """How many shapes, from the first on, have goals of the env."""
        return 0 if self._goal is None else len(self._goal.shapes)

    def _camera_of(self, env: gym.Env[Any, Any]) -> CameraModel | None:
        return self._given_camera or env_protocol.camera_model(env, self._images.size)

    def _begin_episode(self) -> None:
        """Forget the track, and read the camera again: it may have another pose in each episode."""
        self._begin(replace(self._context, camera=self._camera_of(self.env)))
        self.detector.reset()
        self._clock.now = 0.0

    def _begin(self, context: FeatureContext) -> None:
        """Start an episode with a camera, and find the wrapper or env that publishes the anchors."""
        self._context = context
        self._unanchored = len(self.detector.shapes) * [context]
        self._anchors = env_protocol.PublishedAnchors(env_protocol.publisher(self.env, "anchors"))
        self._contexts: list[FeatureContext] | None = self._unanchored

    def _observe(self, observation: Any, info: dict[str, Any]) -> Any:
        """Detect the shapes of a frame, add them to ``info`` and return the wrapped observation."""
        rgb, depth = self._images.read(observation)
        camera, stamp = self._context.camera, self._clock.stamp(info)
        self._contexts = None
        self.detection = detection = self.detector.detect(rgb, depth, camera, stamp=stamp, anchors=self._anchors)
        _add_info(info, detection.shapes)
        contexts = self.contexts if self._vector.anchored else self._unanchored
        values = self._vector.compute(detection.shapes, contexts)
        if self._layout.flat:
            return values
        if self._goal is None or camera is None:
            return self._layout.compose(values, observation)
        self.targets = self._goal.targets(observation["desired_goal"], camera)
        desired = self._goal.vector.desired(self.targets, contexts[: len(self.targets)])
        goals = self._goal.achieved(values), desired
        return self._layout.compose(values, observation, goals)


def _add_info(info: dict[str, Any], shapes: Sequence[Shape]) -> None:
    """Add the scalars that describe the shapes to ``info``."""
    ok, age = True, 0.0
    for shape in shapes:
        ok, age, name = ok and shape.ok, max(age, shape.age), f"shape/{shape.name}/"
        info[name + "ok"] = bool(shape.ok)
        info[name + "valid_fraction"] = int(np.count_nonzero(shape.valid)) / len(shape.valid)
        info[name + "quality"] = float(shape.quality)
        info[name + "sigma"] = max(shape.sigma.tolist())
        info[name + "track_id"] = shape.track_id
    info["shape/ok"], info["shape/age"] = bool(ok), float(age)
