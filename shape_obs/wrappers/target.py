"""Target: a goal shape as a record, from given points or from a detection, and how it is recorded."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraModel
from shape_obs.config.config_file import SCENE_FIELDS, VERSION
from shape_obs.configurations.base import Configuration
from shape_obs.features import FeatureContext
from shape_obs.geometry.topology import Grid
from shape_obs.shape import Shape
from shape_obs.spec import Spec, SpecError
from shape_obs.utils.documents import dump_yaml, read_yaml
from shape_obs.utils.files import write_text
from shape_obs.utils.lengths import warn_unless_metres
from shape_obs.wrappers.goals import find_shapes, goal_topology, resample, shape_at
from shape_obs.wrappers.shape_observation import ShapeObservation

GoalFrame = Literal["base", "camera", "pixels"]

# The fields of a configuration that do not affect the positions of its points.
_FREE: Final = ("name", "order", *SCENE_FIELDS)
_DIGITS: Final = {"base": 6, "camera": 6, "pixels": 3}


@dataclass(frozen=True)
class Target(Spec):
    """A goal shape, which ``to_dict`` and ``from_dict`` convert to and from JSON or YAML.

    Without ``configuration`` there can be any number of points: a curve from end to end or a lattice from border to
    border, starting at the anchor; they are resampled like those of a detection. With ``configuration`` they are the
    points of a recorded shape, which are used unchanged and only for the same configuration.

    Args:
        points: ``(K, 3)`` metres, or ``(K, 2)`` pixels.
        frame: ``"base"``, ``"camera"`` (optical frame: x right, y down, z forward) or ``"pixels"``.
        layout: The layout of the points: ``{"kind": "centerline"}``, ``{"kind": "contour"}`` or ``{"kind": "surface",
            "rows": 5, "cols": 7}``; missing entries are those of the configuration.
        configuration: The configuration of a recorded shape.
        size: (width, height) of the image, for pixels; None for any image.

    Raises:
        SpecError: A field is not understood.
        ValueError: The points are not finite, or do not have the dimension of the frame.

    Example:
        >>> points = [[0.1, 0.0, 0.01], [0.2, 0.02, 0.01], [0.3, 0.0, 0.01]]
        >>> Target(points, layout={"kind": "centerline"}).frame
        'base'
    """

    points: tuple[tuple[float, ...], ...]
    frame: GoalFrame = "base"
    layout: Mapping[str, Any] = field(default_factory=dict)
    configuration: Mapping[str, Any] | None = None
    size: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        wanted = 2 if self.frame == "pixels" else 3
        if not self.points:
            raise ValueError("goal: expected points, got none.")
        if wanted == 3 and self.size is not None:
            raise ValueError(f"goal: size is that of an image, for pixels; leave it out in frame {self.frame!r}.")
        if wanted == 3:
            warn_unless_metres("goal: points", [number for point in self.points for number in point], stacklevel=4)
        for i, point in enumerate(self.points):
            if len(point) != wanted or not np.all(np.isfinite(point)):
                raise ValueError(
                    f"goal: expected {wanted} finite numbers a point in frame {self.frame!r}, point {i} is {point}."
                )

    @classmethod
    def read(cls, goal: Target | Mapping[str, Any] | npt.ArrayLike) -> Target:
        """Return a target from a target, its mapping, or bare points in metres, base frame, ``(K, 3)`` or flat.

        Raises:
            ValueError: The goal is none of these.
        """
        if isinstance(goal, Target):
            return goal
        if isinstance(goal, Mapping):
            return cls.from_dict(goal)
        array = np.asarray(goal, dtype=np.float64)
        if array.ndim not in (1, 2) or array.size == 0 or array.size % 3 or (array.ndim == 2 and array.shape[1] != 3):
            raise ValueError(
                f"goal: expected points (K,3) or flat, metres in the base frame, got an array of shape {array.shape}; "
                "for another frame give Target(points, frame='camera') or Target(points, frame='pixels')."
            )
        return cls(tuple(map(tuple, array.reshape(-1, 3).tolist())))

    @classmethod
    def of(
        cls,
        shape: Shape,
        spec: Configuration,
        context: FeatureContext,
        frame: GoalFrame | None = None,
        *,
        unmeasured: bool = False,
    ) -> Target:
        """Record a detected shape.

        Args:
            shape: The shape.
            spec: Its configuration.
            context: The camera and the size of the image.
            frame: Default: ``"base"`` if the pose of the camera is known, else ``"camera"`` with depth, else
                ``"pixels"``.
            unmeasured: Also record points that were hidden or had no depth, at their estimated positions.

        Raises:
            ValueError: The shape or some of its points were not found, or the frame is not available.
        """
        if shape.reason or not shape.ok:
            raise ValueError(f"shape {shape.name!r} was not found and cannot be a goal: {shape.reason or 'not ok'}.")
        missing = len(shape) - int(np.count_nonzero(shape.valid))
        if missing and not unmeasured:
            raise ValueError(
                f"shape {shape.name!r}: {missing} of {len(shape)} points were hidden or had no depth. Show all of the "
                "object, or record their estimated positions with unmeasured=True."
            )
        posed = context.camera is not None and context.camera.transform_camera_to_base is not None
        if frame is None:
            frame = "pixels" if shape.points3d is None else "base" if posed else "camera"
        if frame == "pixels":
            points, size = shape.pixels, (context.width, context.height)
        elif shape.points3d is None:
            raise ValueError(f"shape {shape.name!r} was found without depth: its frame is 'pixels', not {frame!r}.")
        else:
            points, size = shape.points3d, None
        if frame == "base":
            points = _posed(context.camera).to_base(points)
        rounded = np.asarray(points, dtype=np.float64).round(_DIGITS[frame])
        grid = spec.layout
        lattice = {"rows": grid.rows, "cols": grid.cols} if isinstance(grid, Grid) else {}
        known = {name: value for name, value in spec.to_dict().items() if name not in _FREE}
        return cls(rounded.tolist(), frame, {"kind": spec.kind, **lattice}, known, size)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Target:
        """Read a file that ``save`` wrote.

        Raises:
            FileNotFoundError: There is no such file.
            SpecError: The file is not YAML, has another version, or contains no goal.
        """
        data = read_yaml(path, "goal")
        if not isinstance(data, Mapping) or data.get("version") != VERSION or "goal" not in data:
            raise SpecError(
                f"{path}: expected 'version: {VERSION}' and 'goal', as `shape-obs goal -o` writes them, got "
                f"{sorted(map(str, data)) if isinstance(data, Mapping) else type(data).__name__}."
            )
        try:
            return cls.from_dict(data["goal"])
        except ValueError as error:
            raise SpecError(f"{path}: {error}") from error

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a YAML file, completely or not at all."""
        write_text(Path(path), dump_yaml({"version": VERSION, "goal": self.to_dict()}))

    def shape_for(self, spec: Configuration, context: FeatureContext) -> Shape:
        """Return the target as the shape that the detector would report.

        Args:
            spec: The configuration of the shape.
            context: The camera and the size of the image.

        Raises:
            ValueError: The target is of another kind, was recorded with another configuration, is not in front of the
                camera, or needs something that the context lacks.
        """
        topology = goal_topology(self.layout, spec, len(self.points))
        self._check_recorded(spec)
        points, camera = np.asarray(self.points), context.camera
        intrinsics = None if camera is None else camera.intrinsics
        if self.frame == "pixels":
            if self.size is not None and self.size != (context.width, context.height):
                raise ValueError(
                    f"goal: its pixels belong to an image of {self.size[0]} x {self.size[1]}, this one has "
                    f"{context.width} x {context.height}; give the goal in metres, or record it with this camera."
                )
        elif camera is None:
            raise ValueError(f"goal: frame {self.frame!r} needs a camera: let the env publish it, or pass camera=.")
        elif self.frame == "base":
            points = _posed(camera).from_base(points)
        if self.configuration is None:
            points = resample(points, spec, topology, intrinsics)
        return shape_at(points, spec, intrinsics)

    def _check_recorded(self, spec: Configuration) -> None:
        """Reject points that were recorded with another configuration."""
        if self.configuration is None:
            return
        was, now = (
            {name: value for name, value in known.to_dict().items() if name not in _FREE}
            for known in (Configuration.from_dict(self.configuration), spec)
        )
        other = [name for name in {**was, **now} if was.get(name) != now.get(name)]
        if other:
            before, here = ({name: known.get(name) for name in other} for known in (was, now))
            raise ValueError(
                f"goal: it was recorded with {before}, but shape {spec.name!r} has {here}. Record the goal with this "
                "configuration."
            )


def _posed(camera: CameraModel | None) -> CameraModel:
    if camera is None or camera.transform_camera_to_base is None:
        raise ValueError(
            "goal: frame 'base' needs the pose of the camera: give camera=CameraModel(intrinsics, "
            "transform_camera_to_base=T), or a goal with frame='camera'."
        )
    return camera


def observing(env: gym.Env[Any, Any]) -> ShapeObservation:
    """Return the outermost ``ShapeObservation`` in an env.

    Raises:
        ValueError: There is none.
    """
    inner: Any = env
    while not isinstance(inner, ShapeObservation):
        if not isinstance(inner, gym.Wrapper):
            raise ValueError(f"expected an env with a ShapeObservation inside, got {env}: wrap it in ShapeObservation.")
        inner = inner.env
    return inner


def record_goal(
    env: gym.Env[Any, Any], shape: str | None = None, frame: GoalFrame | None = None, *, unmeasured: bool = False
) -> Target:
    """Return the shape in the last observation as a goal for ``ShapeGoal``, with the same points index for index.

    Args:
        env: An env that contains a ``ShapeObservation``, after ``reset``.
        shape: The name of the shape; default the first.
        frame: ``"base"``, ``"camera"`` or ``"pixels"``; default the first of these that is available.
        unmeasured: Also record points that were hidden or had no depth, at their estimated positions.

    Raises:
        ValueError: There is no observation yet, the shape or some of its points were not found, or the frame is not
            available.

    Example:
        >>> record_goal(env).to_dict()  # doctest: +SKIP
    """
    first = observing(env).detector.shapes[0].name
    recorded = record_goals(env, first if shape is None else shape, frame, unmeasured=unmeasured)
    if len(recorded) > 1:
        raise ValueError(f"record_goal: {shape!r} has the slots {list(recorded)}: name one, or call record_goals.")
    return next(iter(recorded.values()))


def record_goals(
    env: gym.Env[Any, Any],
    shapes: str | Sequence[str],
    frame: GoalFrame | None = None,
    *,
    unmeasured: bool = False,
) -> dict[str, Target]:
    """Return several shapes in the last observation as the goals of a ``ShapeGoal``, by name.

    Args:
        env: An env that contains a ``ShapeObservation``, after ``reset``.
        shapes: The name of a shape with a ``count``, for all of its slots, or names of shapes.
        frame: As for ``record_goal``.
        unmeasured: As for ``record_goal``.

    Raises:
        ValueError: As for ``record_goal``.
    """
    source = observing(env)
    places = find_shapes(source.detector.config, shapes)
    if source.detection is None:
        raise ValueError("record_goal: nothing has been seen yet; call reset first.")
    found, known = source.detection.shapes, source.detector.shapes
    return {
        known[at].name: Target.of(found[at], known[at], source.contexts[at], frame, unmeasured=unmeasured)
        for at in places
    }
