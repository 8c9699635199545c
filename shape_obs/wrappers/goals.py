"""Goals in feature space: the features of the detected shape and the same features of its target."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from shape_obs.camera import CameraModel
from shape_obs.configurations.base import Configuration
from shape_obs.features import (
    Age,
    Feature,
    FeatureContext,
    FeatureVector,
    Ok,
    Points2D,
    Points2DNormalized,
    Points3D,
    Valid,
)
from shape_obs.shape import Shape
from shape_obs.wrappers.env_protocol import has_goals
from shape_obs.wrappers.goal_points import goal_topology, resample, shape_at

Vector = npt.NDArray[np.float32]

#: Features that describe the reliability of a shape, not its position.
STATUS: Final = (Ok, Age, Valid)
# The number of coordinates of a point, and their unit.
_POINTS: Final = {Points3D: (3, "m"), Points2D: (2, "px"), Points2DNormalized: (2, "of half the image")}


class GoalVector:
    """Compute the features of a detected shape and of its target.

    Those of the target are cached until the target, the camera or the anchor changes, which is rare within an episode.

    Args:
        features: The features in the order of the vector.
        spec: The configuration of the shape.
        context: The context that determines the bounds.

    Attributes:
        low: ``(D,)`` float32 lowest values.
        high: ``(D,)`` float32 highest values.
        features: The features.
        unit: Unit of ``distance``: ``"m"``, ``"px"``, ``"of half the image"`` or ``"of the range"``.
    """

    def __init__(self, features: Sequence[Feature], spec: Configuration, context: FeatureContext) -> None:
        self._vector = FeatureVector(features, [spec], context)
        self.features, self.low, self.high = self._vector.features, self._vector.low, self._vector.high
        kinds = {type(feature) for feature in self.features}
        self._coordinates, self.unit = _POINTS.get(kinds.pop(), (0, "")) if len(kinds) == 1 else (0, "")
        self.unit = self.unit or "of the range"
        self._cached: tuple[Any, ...] = (None, None, None)
        self._desired: Vector = self.low

    def pair(self, seen: Shape, target: Shape, context: FeatureContext) -> tuple[Vector, Vector]:
        """Return the achieved and the desired values, new arrays of shape ``(D,)`` each."""
        return self._vector.compute([seen], [context]), self.desired(target, context)

    def measured(self, seen: Shape) -> npt.NDArray[np.bool_]:
        """Return which achieved values were measured in this frame and not filled in, of shape ``(D,)``."""
        return self._vector.measured([seen])

    def desired(self, target: Shape, context: FeatureContext) -> Vector:
        """Return the values of the target, a new array of shape ``(D,)``."""
        shape, camera, before = self._cached
        # The anchors move in every step, but most features do not depend on them.
        anchor = (context.anchor, context.anchors) if self._vector.anchored else None
        if shape is not target or camera is not context.camera or before != anchor:
            self._desired = self._vector.compute([target], [context])
            self._cached = (target, context.camera, anchor)
        return self._desired.copy()

    def distance(self, achieved: Any, desired: Any) -> npt.NDArray[np.float64]:
        """Return the distance between goals: ``(..., D)``, ``(..., D)`` -> ``(...,)``.

        For points of one kind it is the mean distance of corresponding points, ``mean_i |a_i - d_i|``, in their unit.
        For other features it is the root mean square of their differences, each divided by its range:
        ``sqrt(mean_j ((a_j - d_j) / (high_j - low_j))^2)``.

        Raises:
            ValueError: The goals have another size.
        """
        one, other = (np.asarray(goal, dtype=np.float64) for goal in (achieved, desired))
        if one.shape != other.shape or one.shape[-1:] != self.low.shape:
            raise ValueError(
                f"expected two goals of equal shape (..., {len(self.low)}), got {one.shape} and {other.shape}."
            )
        apart = one - other
        if self._coordinates:
            apart = apart.reshape(*apart.shape[:-1], -1, self._coordinates)
            return np.sqrt(np.einsum("...d,...d->...", apart, apart)).mean(axis=-1)
        apart /= self.high.astype(np.float64) - self.low
        return np.sqrt(np.einsum("...d,...d->...", apart, apart) / len(self.low))


class EnvGoal:
    """The goals of a goal-conditioned env: the first ``points3d`` of the first shape and of the env's own target.

    Args:
        features: The features of the wrapper.
        shapes: The configurations of the wrapper.
        context: The context that determines the bounds.
        layout: The goal layout that the env publishes.
        count: Number of values in a goal of the env.

    Attributes:
        vector: The features of goals.

    Raises:
        ValueError: The features, the first shape or the camera cannot express the env's goals.
    """

    def __init__(
        self,
        features: Sequence[Feature],
        shapes: Sequence[Configuration],
        context: FeatureContext,
        layout: Mapping[str, Any],
        count: int,
    ) -> None:
        spec, metric = shapes[0], [feature for feature in features if isinstance(feature, Points3D)]
        if layout.get("kind", spec.kind) != spec.kind:
            raise ValueError(
                f"this env has goals of the layout {layout['kind']!r}: the first of shapes must be a "
                f"{layout['kind']!r}, got {spec.kind!r}."
            )
        if not metric:
            raise ValueError(
                "this env has goals, whose distance is in metres: add 'points3d' to features, "
                f"got {[feature.kind for feature in features]}."
            )
        if context.camera is None or context.camera.transform_camera_to_base is None:
            raise ValueError(
                "this env has goals in the base frame: its camera_model (or camera=) needs transform_camera_to_base."
            )
        if count % 3:
            raise ValueError(f"this env's goals must be flat (x, y, z) points, got {count} numbers.")
        self._topology = goal_topology(layout, spec, count // 3)
        self._spec = spec
        self.vector = GoalVector(metric[:1], spec, context)
        before = features[: features.index(metric[0])]
        start = sum(len(feature.bounds(spec.layout, context)[0]) for feature in before)
        self._here = slice(start, start + len(self.vector.low))
        self._cached: tuple[Any, ...] = (None, None)
        self._target: Shape | None = None

    @classmethod
    def find(
        cls,
        space: spaces.Space[Any],
        features: Sequence[Feature],
        shapes: Sequence[Configuration],
        context: FeatureContext,
        layout: Mapping[str, Any],
    ) -> EnvGoal | None:
        """Return the goals of an env with this observation space; None if it has no goals."""
        if not isinstance(space, spaces.Dict) or not has_goals(space):
            return None
        return cls(features, shapes, context, layout, int(np.prod(space["desired_goal"].shape or (0,))))

    def achieved(self, values: Vector) -> Vector:
        """Return the part of the wrapper's feature vector that goals consist of, a new array of shape ``(D,)``."""
        return values[self._here].copy()

    def target(self, goal: npt.ArrayLike, camera: CameraModel) -> Shape:
        """Return the env's goal as the shape that the detector would report, the same object while nothing changes.

        Args:
            goal: Points in metres, base frame, flat or of shape ``(K, 3)``, starting at the anchor.
            camera: The camera with its pose in the base frame.

        Raises:
            ValueError: The points have the wrong number or are not finite, or the camera cannot see them.
        """
        array = np.asarray(goal)
        key = array.tobytes()
        if key != self._cached[0] or camera is not self._cached[1] or self._target is None:
            points = array.astype(np.float64).ravel()
            if points.size != 3 * self._topology.size or not np.all(np.isfinite(points)):
                raise ValueError(
                    f"desired_goal: expected {self._topology.size} finite points (x, y, z) in the base frame, flat, "
                    f"got {array.shape}: {points[:6].tolist()} ..."
                )
            points = resample(camera.from_base(points.reshape(-1, 3)), self._spec, self._topology, camera.intrinsics)
            self._target = shape_at(points, self._spec, camera.intrinsics)
            self._cached = (key, camera)
        return self._target
