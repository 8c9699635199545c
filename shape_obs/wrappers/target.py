"""Target: a goal as a plain record, from points that somebody gives or from what the camera sees now."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt
import yaml

from shape_obs.camera import CameraModel
from shape_obs.config import VERSION
from shape_obs.configurations import Configuration
from shape_obs.features import FeatureContext
from shape_obs.geometry.topology import Grid
from shape_obs.shape import Shape
from shape_obs.spec import Spec, SpecError
from shape_obs.utils.documents import read_yaml
from shape_obs.utils.files import write_text
from shape_obs.wrappers.goal_points import goal_topology, placed, shape_at

GoalFrame = Literal["base", "camera", "pixels"]

# Of a configuration: what has no say in where its points lie.
_FREE: Final = ("name", "segmentation", "order")
_DIGITS: Final = {"base": 6, "camera": 6, "pixels": 3}


@dataclass(frozen=True)
class Target(Spec):
    """A goal shape; ``to_dict`` and ``from_dict`` make it JSON or YAML and back.

    Without ``configuration`` the points may be any number: a curve runs from end to end and a lattice from border to
    border, the first point belongs to the anchor's material, and they are placed anew as the detector would. With it
    they are a recorded shape's own points, taken as they are, and another configuration refuses them.

    Args:
        points: (K,3) metres, or (K,2) pixels.
        frame: ``"base"``, ``"camera"`` (optical frame: x right, y down, z forward) or ``"pixels"``.
        layout: How the points hang together: ``{"kind": "centerline"}``, ``{"kind": "contour"}`` or ``{"kind":
            "surface", "rows": 5, "cols": 7}``; what is missing is as the configuration's own.
        configuration: Of a recorded shape: what it was found as.
        size: (width, height) of the image, for pixels; None for any.

    Raises:
        SpecError: A field that is not understood.
        ValueError: Points that are not finite, or not of the frame's dimension.

    Example:
        >>> Target([[0.1, 0.0, 0.01], [0.2, 0.02, 0.01], [0.3, 0.0, 0.01]], layout={"kind": "centerline"}).frame
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
        for i, point in enumerate(self.points):
            if len(point) != wanted or not np.all(np.isfinite(point)):
                raise ValueError(
                    f"goal: expected {wanted} finite numbers a point in frame {self.frame!r}, point {i} is {point}."
                )

    @classmethod
    def read(cls, goal: Target | Mapping[str, Any] | npt.ArrayLike) -> Target:
        """A target from a record, its mapping, or bare points: (K,3) or flat metres, base frame.

        Raises:
            ValueError: None of these.
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
        """Record a shape that was found.

        Args:
            shape: What was found.
            spec: What it was found as.
            context: Camera and size of the image.
            frame: Default: ``"base"`` where the camera's place is known, else ``"camera"`` with depth, else
                ``"pixels"``.
            unmeasured: Record points that were hidden or had no depth too, where they were taken to be.

        Raises:
            ValueError: The shape was not found in this frame, or not all of it, or the frame cannot be had.
        """
        if shape.reason or not shape.ok:
            raise ValueError(f"shape {shape.name!r} was not found, so it is no goal: {shape.reason or 'not ok'}.")
        missing = len(shape) - int(np.count_nonzero(shape.valid))
        if missing and not unmeasured:
            raise ValueError(
                f"shape {shape.name!r}: {missing} of {len(shape)} points were hidden or had no depth, so they are no "
                "goal. Show all of it, or record them where they were taken to be with unmeasured=True."
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
            SpecError: It is no YAML, of another version, or holds no goal.
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
        """Write a YAML file, whole or not at all."""
        write_text(Path(path), yaml.safe_dump({"version": VERSION, "goal": self.to_dict()}, sort_keys=False))

    def shape_for(self, spec: Configuration, context: FeatureContext) -> Shape:
        """The target as the shape that the detector would report of it.

        Args:
            spec: The configuration whose points are wanted.
            context: Camera and size of the image.

        Raises:
            ValueError: The target is of another kind, was recorded as something else, is out of the camera's sight, or
                the frame asks for what the context does not have; the message says what.
        """
        topology = goal_topology(self.layout, spec, len(self.points))
        self._check_recorded(spec)
        points, camera = np.asarray(self.points), context.camera
        intrinsics = None if camera is None else camera.intrinsics
        if self.frame == "pixels":
            if self.size is not None and self.size != (context.width, context.height):
                raise ValueError(
                    f"goal: its pixels are of an image of {self.size[0]} x {self.size[1]}, this one has "
                    f"{context.width} x {context.height}; give the goal in metres, or record it with this camera."
                )
        elif camera is None:
            raise ValueError(f"goal: frame {self.frame!r} needs a camera: let the env publish it, or pass camera=.")
        elif self.frame == "base":
            points = _posed(camera).from_base(points)
        if self.configuration is None:
            points = placed(points, spec, topology, intrinsics)
        return shape_at(points, spec, intrinsics)

    def _check_recorded(self, spec: Configuration) -> None:
        """Refuse points that were found as something else than what is looked for now."""
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
                f"goal: it was recorded with {before}, shape {spec.name!r} has {here}: its points are others. Record "
                "the goal with this configuration."
            )


def _posed(camera: CameraModel | None) -> CameraModel:
    if camera is None or camera.transform_camera_to_base is None:
        raise ValueError(
            "goal: frame 'base' needs the camera's place there: give camera=CameraModel(intrinsics, "
            "transform_camera_to_base=T), or a goal with frame='camera'."
        )
    return camera
