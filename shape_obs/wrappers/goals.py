"""Goals in feature space: the features of the detected shapes and the same features of their targets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from shape_obs.camera import CameraModel, Intrinsics
from shape_obs.config.detector_config import DetectorConfig
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
from shape_obs.geometry.curve import FittedCurve, FittedForm
from shape_obs.geometry.lattice import FittedLattice
from shape_obs.geometry.outline import clockwise
from shape_obs.geometry.polyline import catmull_rom
from shape_obs.geometry.topology import Chain, Grid, Ring, Topology
from shape_obs.shape import Shape
from shape_obs.spec import did_you_mean
from shape_obs.utils.lengths import warn_unless_metres
from shape_obs.wrappers.env_protocol import has_goals

Array = npt.NDArray[np.float64]

_LEAST: Final = 3  # smallest number of points of a curve

Vector = npt.NDArray[np.float32]

#: Features that describe the reliability of a shape, not its position.
STATUS: Final = (Ok, Age, Valid)
# The number of coordinates of a point, and their unit.
_POINTS: Final = {Points3D: (3, "m"), Points2D: (2, "px"), Points2DNormalized: (2, "of half the image")}


def goal_topology(layout: Mapping[str, Any], spec: Configuration, count: int) -> Topology:
    """Return the topology of the points of a goal.

    Args:
        layout: ``{"kind": "centerline"}``, ``{"kind": "contour"}`` or ``{"kind": "surface", "rows": 5, "cols": 7}``;
            missing entries are those of the configuration.
        spec: The configuration of the shape that has the goal.
        count: Number of points of the goal.

    Raises:
        ValueError: The goal is of another kind than the configuration, or has the wrong number of points.
    """
    kind, own = layout.get("kind", spec.kind), spec.layout
    if kind != spec.kind:
        raise ValueError(f"a goal of kind {kind!r} does not fit shape {spec.name!r}, which is a {spec.kind!r}.")
    known = ("kind", "rows", "cols") if isinstance(own, Grid) else ("kind",)
    for name in layout:
        if name not in known:
            raise ValueError(f"goal_layout of a {kind!r}: unknown entry {name!r}{did_you_mean(name, known)}")
    if isinstance(own, Grid):
        grid = Grid(int(layout.get("rows", own.rows)), int(layout.get("cols", own.cols)))
        if grid.size != count or min(grid.rows, grid.cols) < 2:
            raise ValueError(
                f"goal of a {kind!r}: expected {grid.rows} x {grid.cols} points, at least 2 x 2, got {count} points; "
                f'give their layout: {{"kind": {kind!r}, "rows": ..., "cols": ...}}.'
            )
        return grid
    if not isinstance(own, (Chain, Ring)):
        raise ValueError(f"goals can be chains, rings or lattices of points; a {kind!r} is a {type(own).__name__}.")
    if count < _LEAST:
        raise ValueError(f"goal of a {kind!r}: expected at least {_LEAST} points, got {count}.")
    return type(own)(count)


def resample(points: Array, spec: Configuration, topology: Topology, intrinsics: Intrinsics | None) -> Array:
    """Resample goal points with the code that resamples the points of a detection.

    A curve extends from end to end and a lattice from border to border, for any ``ends`` of the configuration. Point 0
    keeps its position; outlines and lattices that run counterclockwise in the image are reversed, since detections
    always run clockwise.

    Args:
        points: ``(K, 3)`` metres, camera frame, or ``(K, 2)`` pixels.
        spec: The configuration that the points are resampled for.
        topology: The topology of the K points.
        intrinsics: The intrinsics of the camera; not needed for pixels.

    Returns:
        Points of shape ``(N, 3)`` in metres, camera frame, or ``(N, 2)`` in pixels.

    Raises:
        ValueError: A point is not in front of the camera, or the gaps must be equal in metres but points are pixels.
    """
    form = _form(points, _pixels(points, intrinsics), topology)
    if spec.spacing == "m" or spec.lift == "cloud":
        if points.shape[1] == 2:
            raise ValueError(
                f"shape {spec.name!r} has equal gaps in metres: give its goal in metres too, not in pixels."
            )
        metric = form
    else:
        metric = form.with_points(_pixels(form.points, intrinsics))
    return spec.resample(form, metric).places


def shape_at(places: Array, spec: Configuration, intrinsics: Intrinsics | None) -> Shape:
    """Return a shape with all points known: ``(N, 3)`` metres, camera frame, or ``(N, 2)`` pixels."""
    pixels = _pixels(places, intrinsics).astype(np.float32)
    points3d = places.astype(np.float32) if places.shape[1] == 3 else None
    known = np.ones(spec.layout.size, bool)
    return Shape(spec.name, pixels, points3d, known, known.copy(), spec.layout)


def _pixels(points: Array, intrinsics: Intrinsics | None) -> Array:
    if points.shape[1] == 2:
        return points
    assert intrinsics is not None
    pixels = intrinsics.project(points)
    if not np.all(np.isfinite(pixels)):
        worst = points[np.argmin(points[:, 2])].round(3).tolist()
        raise ValueError(f"the goal must lie in front of the camera, got {worst} metres in the camera's frame.")
    return pixels


def _form(points: Array, seen: Array, topology: Topology) -> FittedForm:
    """Return the smooth curve or lattice through points ``(K, D)`` that the camera sees at pixels ``(K, 2)``."""
    if isinstance(topology, Grid):
        lattice, seen = topology.lattice(points), topology.lattice(seen)
        border = np.concatenate([seen[0, :-1], seen[:-1, -1], seen[-1, :0:-1], seen[:0:-1, 0]])
        if not clockwise(border):
            lattice = lattice.swapaxes(0, 1)
        fine = _finer(_finer(lattice).swapaxes(0, 1)).swapaxes(0, 1)
        drawn = np.ascontiguousarray(fine).reshape(-1, points.shape[1])
        return FittedLattice.over(drawn, np.zeros(len(drawn), bool), len(fine))
    closed = isinstance(topology, Ring)
    if closed and not clockwise(seen):
        points = np.roll(points[::-1], 1, axis=0)
    drawn = catmull_rom(np.ascontiguousarray(points), 4, closed)
    return FittedCurve.through(drawn, np.zeros(len(drawn), bool), closed)


def _finer(lattice: Array) -> Array:
    """Add rows to a lattice on smooth curves down its columns: ``(R, C, D)`` -> ``(R', C, D)``."""
    if len(lattice) < _LEAST:
        return lattice
    rows = np.ascontiguousarray(lattice).reshape(len(lattice), -1)
    return catmull_rom(rows, 4, False).reshape(-1, *lattice.shape[1:])


class GoalVector:
    """Compute the features of detected shapes and of their targets, shape by shape.

    Those of the targets are cached until a target, the camera or an anchor changes, which is rare within an episode.

    Args:
        features: The features of each shape, in the order of the vector.
        specs: The configurations of the shapes that have a goal.
        context: The context that determines the bounds.

    Attributes:
        low: ``(D,)`` float32 lowest values.
        high: ``(D,)`` float32 highest values.
        features: The features.
        unit: Unit of ``distance``: ``"m"``, ``"px"``, ``"of half the image"`` or ``"of the range"``.
    """

    def __init__(self, features: Sequence[Feature], specs: Sequence[Configuration], context: FeatureContext) -> None:
        self._vector = FeatureVector(features, specs, context)
        self.features, self.low, self.high = self._vector.features, self._vector.low, self._vector.high
        kinds = {type(feature) for feature in self.features}
        self._coordinates, self.unit = _POINTS.get(kinds.pop(), (0, "")) if len(kinds) == 1 else (0, "")
        self.unit = self.unit or "of the range"
        self._cached: tuple[Any, ...] = ((), None, None)
        self._desired: Vector = self.low

    def pair(
        self, seen: Sequence[Shape], targets: Sequence[Shape], contexts: Sequence[FeatureContext]
    ) -> tuple[Vector, Vector]:
        """Return the achieved and the desired values, new arrays of shape ``(D,)`` each."""
        return self._vector.compute(seen, contexts), self.desired(targets, contexts)

    def measured(self, seen: Sequence[Shape]) -> npt.NDArray[np.bool_]:
        """Return which achieved values were measured in this frame and not filled in, of shape ``(D,)``."""
        return self._vector.measured(seen)

    def desired(self, targets: Sequence[Shape], contexts: Sequence[FeatureContext]) -> Vector:
        """Return the values of the targets, a new array of shape ``(D,)``.

        Args:
            targets: The target of each shape; the same objects while nothing changes.
            contexts: The context of each shape, with one camera for all.
        """
        shapes, camera, before = self._cached
        # The anchors move in every step, but most features do not depend on them.
        anchors = [(each.anchor, each.anchors) for each in contexts] if self._vector.anchored else None
        same = len(shapes) == len(targets) and all(a is b for a, b in zip(shapes, targets, strict=True))
        if not same or camera is not contexts[0].camera or before != anchors:
            self._desired = self._vector.compute(targets, contexts)
            self._cached = (tuple(targets), contexts[0].camera, anchors)
        return self._desired.copy()

    def distance(self, achieved: Any, desired: Any) -> npt.NDArray[np.float64]:
        """Return the distance between goals: ``(..., D)``, ``(..., D)`` -> ``(...,)``.

        For points of one kind it is the mean distance of corresponding points, ``mean_i |a_i - d_i|``, in their unit,
        over the points of all shapes.
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
    """The goals of a goal-conditioned env: the first ``points3d`` of the first shapes and of the env's own targets.

    The env has a goal for the first shape, or for as many shapes as the ``count`` of its ``goal_layout``, one after the
    other.

    Args:
        features: The features of the wrapper.
        shapes: The configurations of the wrapper.
        context: The context that determines the bounds.
        layout: The goal layout that the env publishes.
        count: Number of values in a goal of the env.

    Attributes:
        vector: The features of goals.
        shapes: The configurations of the shapes that have a goal.

    Raises:
        ValueError: The features, the shapes or the camera cannot express the env's goals.
    """

    def __init__(
        self,
        features: Sequence[Feature],
        shapes: Sequence[Configuration],
        context: FeatureContext,
        layout: Mapping[str, Any],
        count: int,
    ) -> None:
        metric = [feature for feature in features if isinstance(feature, Points3D)]
        goals, own = layout.get("count", 1), {name: value for name, value in layout.items() if name != "count"}
        if type(goals) is not int or goals < 1:
            raise ValueError(f"goal_layout: count: expected the number of shapes that have a goal, got {goals!r}.")
        if len(shapes) < goals:
            raise ValueError(
                f"this env has goals of {goals} shapes: expected at least {goals} shapes or slots, got "
                f"{[spec.name for spec in shapes]}; give the first of shapes count={goals}."
            )
        self.shapes = tuple(shapes[:goals])
        for spec in self.shapes:
            if layout.get("kind", spec.kind) != spec.kind:
                where = "the first of shapes" if goals == 1 else f"shape {spec.name!r}"
                raise ValueError(
                    f"this env has goals of the layout {layout['kind']!r}: {where} must be a "
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
        if count % (3 * goals):
            of = "" if goals == 1 else f", equally many for each of {goals} shapes"
            raise ValueError(f"this env's goals must be flat (x, y, z) points{of}, got {count} numbers.")
        self._topologies = [goal_topology(own, spec, count // (3 * goals)) for spec in self.shapes]
        self.vector = GoalVector(metric[:1], self.shapes, context)
        blocks = FeatureVector(features, self.shapes, context).blocks[features.index(metric[0]) :: len(features)]
        self._here = np.concatenate([np.arange(block.place.start, block.place.stop) for block in blocks])
        self._cached: tuple[Any, ...] = (None, None)
        self._targets: tuple[Shape, ...] = ()

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

    def targets(self, goal: npt.ArrayLike, camera: CameraModel) -> tuple[Shape, ...]:
        """Return the env's goals as the shapes that the detector would report, the same object while nothing changes.

        Args:
            goal: Points in metres, base frame, flat or of shape ``(K, 3)``, each shape starting at its anchor.
            camera: The camera with its pose in the base frame.

        Raises:
            ValueError: The points have the wrong number or are not finite, or the camera cannot see them.
        """
        array = np.asarray(goal)
        key = array.tobytes()
        if key != self._cached[0] or camera is not self._cached[1] or not self._targets:
            points = array.astype(np.float64).ravel()
            size = sum(topology.size for topology in self._topologies)
            if points.size != 3 * size or not np.all(np.isfinite(points)):
                raise ValueError(
                    f"desired_goal: expected {size} finite points (x, y, z) in the base frame, flat, "
                    f"got {array.shape}: {points[:6].tolist()} ..."
                )
            if not self._targets:  # the first goal: others are in the same unit
                warn_unless_metres("desired_goal", points)
            parts = np.split(camera.from_base(points.reshape(-1, 3)), len(self.shapes))
            known = camera.intrinsics
            self._targets = tuple(
                shape_at(resample(part, spec, topology, known), spec, known)
                for part, spec, topology in zip(parts, self.shapes, self._topologies, strict=True)
            )
            self._cached = (key, camera)
        return self._targets


def find_shapes(config: DetectorConfig, asked: str | Sequence[str]) -> tuple[int, ...]:
    """Return the indices of shapes among the detector's slots.

    Args:
        config: The configuration of the detector.
        asked: The name of a shape or slot, of a shape with a count for all of its slots, or several names.

    Raises:
        ValueError: A name is unknown or occurs twice, or there is none.
    """
    slots = {spec.name: [slot.name for slot in spec.slots()] for spec in config.shapes}
    names = [name for some in slots.values() for name in some]
    found: list[int] = []
    for name in [asked] if isinstance(asked, str) else asked:
        if name not in names and name not in slots:
            raise ValueError(f"no shape named {name!r}{did_you_mean(name, [*slots, *names])}")
        found += [names.index(slot) for slot in ([name] if name in names else slots[name])]
    if not found or len(set(found)) < len(found):
        raise ValueError(f"shape: expected names of shapes, each once, got {asked!r}; there are {names}.")
    return tuple(found)
