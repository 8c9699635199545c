"""Goals as a policy sees them: features of the seen shape beside the same features of its target."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from shape_obs.camera import CameraModel
from shape_obs.configurations import Configuration
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
from shape_obs.wrappers.goal_points import goal_topology, placed, shape_at

Vector = npt.NDArray[np.float32]

#: Features that tell how far a shape can be trusted, and nothing of where it is.
STATUS: Final = (Ok, Age, Valid)
# Coordinates of a point, and their unit.
_POINTS: Final = {Points3D: (3, "m"), Points2D: (2, "px"), Points2DNormalized: (2, "of half the image")}


class GoalVector:
    """Features of one seen shape and of its target.

    The target's are kept until the target, the camera or the anchor is another one: they seldom change within an
    episode.

    Args:
        features: In the order of the vector.
        spec: The configuration of the shape.
        context: What the bounds are made from.

    Attributes:
        low: (D,) float32 lowest values.
        high: (D,) float32 highest values.
        features: As given.
        unit: Of ``distance``: ``"m"``, ``"px"``, ``"of half the image"`` or ``"of the range"``.
    """

    def __init__(self, features: Sequence[Feature], spec: Configuration, context: FeatureContext) -> None:
        self._vector = FeatureVector(features, [spec], context)
        self.features, self.low, self.high = self._vector.features, self._vector.low, self._vector.high
        kinds = {type(feature) for feature in self.features}
        self._coordinates, self.unit = _POINTS.get(kinds.pop(), (0, "")) if len(kinds) == 1 else (0, "")
        self.unit = self.unit or "of the range"
        # A gripper moves in every step, and most features do not care.
        self._anchored = any(feature.anchored for feature in self.features)
        self._known: tuple[Any, ...] = (None, None, None)
        self._desired: Vector = self.low

    def pair(self, seen: Shape, target: Shape, context: FeatureContext) -> tuple[Vector, Vector]:
        """((D,), (D,)): what was achieved and what is desired, fresh arrays."""
        return self._vector.compute([seen], [context]), self.desired(target, context)

    def measured(self, seen: Shape) -> npt.NDArray[np.bool_]:
        """(D,) which of the achieved values were measured in this frame, not filled in."""
        return self._vector.measured([seen])

    def desired(self, target: Shape, context: FeatureContext) -> Vector:
        """(D,) of the target, a fresh array."""
        shape, camera, before = self._known
        anchor = (context.anchor, context.anchors) if self._anchored else None
        if shape is not target or camera is not context.camera or before != anchor:
            self._desired = self._vector.compute([target], [context])
            self._known = (target, context.camera, anchor)
        return self._desired.copy()

    def distance(self, achieved: Any, desired: Any) -> npt.NDArray[np.float64]:
        """How far goals are apart: (..., D), (..., D) -> (...,).

        Between points of one kind it is the mean distance of corresponding points, ``mean_i |a_i - d_i|``, in their
        unit. Any other features are the root mean square of their differences, each as a share of its range:
        ``sqrt(mean_j ((a_j - d_j) / (high_j - low_j))^2)``.

        Raises:
            ValueError: Goals of another size.
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
    """The goals of a goal-conditioned env: the first ``points3d`` of the first shape, and of the env's own target.

    Args:
        features: Of the wrapper.
        shapes: Of the wrapper.
        context: What the bounds are made from.
        layout: What the env says of its goals' layout.
        count: How many numbers a goal of the env has.

    Attributes:
        vector: What goals are given in.

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
                f"this env has goals that are laid out as a {layout['kind']!r}: the first of shapes must be a "
                f"{layout['kind']!r}, got {spec.kind!r}."
            )
        if not metric:
            raise ValueError(
                "this env has goals, which are scored in metres: add 'points3d' to features, "
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
        self._known: tuple[Any, ...] = (None, None)
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
        """The goals of an env with this observation space; None where it has none."""
        if not isinstance(space, spaces.Dict) or not has_goals(space):
            return None
        return cls(features, shapes, context, layout, int(np.prod(space["desired_goal"].shape or (0,))))

    def achieved(self, values: Vector) -> Vector:
        """(D,) what was achieved, a fresh array: of all the wrapper's features those that goals are given in."""
        return values[self._here].copy()

    def target(self, goal: npt.ArrayLike, camera: CameraModel) -> Shape:
        """The env's goal as the shape that the detector would report of it; the same object while nothing changes.

        Args:
            goal: Flat or (K,3) metres, base frame, from the anchor's point on.
            camera: With its place in the base frame.

        Raises:
            ValueError: No such points, or points that the camera cannot see.
        """
        array = np.asarray(goal)
        key = array.tobytes()
        if key != self._known[0] or camera is not self._known[1] or self._target is None:
            points = array.astype(np.float64).ravel()
            if points.size != 3 * self._topology.size or not np.all(np.isfinite(points)):
                raise ValueError(
                    f"desired_goal: expected {self._topology.size} finite points (x, y, z) in the base frame, flat, "
                    f"got {array.shape}: {points[:6].tolist()} ..."
                )
            places = placed(camera.from_base(points.reshape(-1, 3)), self._spec, self._topology, camera.intrinsics)
            self._target = shape_at(places, self._spec, camera.intrinsics)
            self._known = (key, camera)
        return self._target
