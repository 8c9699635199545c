"""What a detector returns: shapes, and the detection that holds them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.crossings import Crossing
from shape_obs.geometry.topology import Topology
from shape_obs.spec import did_you_mean

# Types as NumPy holds them, which compare several times as fast as their classes.
_FLOAT, _FLAG = np.dtype(np.float32), np.dtype(np.bool_)
_ARRAYS: Final = (
    ("points2d", _FLOAT), ("points3d", _FLOAT), ("visible", _FLAG), ("valid", _FLAG), ("sigma", _FLOAT),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Shape:
    """N ordered points on an object. Point i stays the same material point from frame to frame.

    The arrays are read-only and share no memory with the detector or the caller. Copy before you change:
    ``points = shape.points3d.copy()``, or compute a new array: ``shape.points3d - offset``.

    What holds for every shape that a detector returns:

    - ``valid`` is True only where ``visible`` is.
    - ``points3d`` is finite where ``valid`` is True. Elsewhere it holds what ``on_invalid`` asks for, which may be NaN.
    - ``points2d`` is finite if ``ok`` is True. It is NaN if no points are known, and never infinite.
    - ``quality`` and ``age`` are finite. ``reason`` is empty if and only if the points were found in this frame.
    - ``sigma`` is finite, at least 0 and at most 1 m or, in pixels, the diagonal of the image. Of a shape that was not
      found it grows with ``age``; of one that was never found it is at its bound.
    - While ``track_id`` stays the same, point i is the same material point; when it changes, points may be numbered
      from the other end or lie on another object. It is 0 until the shape is found, then 1, and grows by 1 whenever
      the numbering begins again: after more than ``max_age`` seconds without the shape, or where the detector finds
      that the object is another one. A held shape keeps it. ``detector.reset()`` begins again at 0. There are two
      exceptions. If the object is partly hidden when it is first seen, its points spread over the rest once that is
      seen. With ``order="image"`` the numbering is that of the frame, and ``track_id`` identifies the object only.

    Args:
        name: The configuration's name.
        points2d: ``(N, 2)`` float32 pixels (u right, v down), pixel centres at integers; None for a cloud.
        points3d: ``(N, 3)`` float32 metres, camera optical frame; None if found without depth and camera.
        visible: ``(N,)`` bool: whether the mask covers the point.
        valid: ``(N,)`` bool: visible and, in 3D, with measured depth.
        layout: The neighbours of each point: a chain, a ring or a lattice; ``layout.edges()`` lists the pairs.
        ok: Found and passed the quality check in this frame, or held for at most ``max_age`` seconds.
        quality: 0...1, how well the curve explains the mask.
        reason: Why the shape was not found in this frame; empty if it was.
        age: Seconds since the points were found, or since the first frame if they never were; 0 if found in this frame.
        sigma: ``(N,)`` float32, the RMS error per axis that is expected of each point, in metres if the shape has
            ``points3d``, else in pixels. None for points that are exact, such as a goal's, gives zeros.
        track_id: The number of the track that the points belong to; 0 if there is none.
        new: Whether this is the first frame in which the shape was found under its ``track_id``.
        length: Of the object, hidden pieces included, as far as the track remembers it, in metres; None if unknown.
        crossings: All places where the shape lies over or under itself or another one.
    """

    name: str
    points2d: npt.NDArray[np.float32] | Any  # None for a cloud; Any, so that users of images need no check
    points3d: npt.NDArray[np.float32] | None
    visible: npt.NDArray[np.bool_]
    valid: npt.NDArray[np.bool_]
    layout: Topology
    ok: bool = True
    quality: float = 1.0
    reason: str = ""
    age: float = 0.0
    sigma: npt.NDArray[np.float32] | Any = None  # never None in an instance; Any, so that users need no check
    track_id: int = 0
    new: bool = False
    length: float | None = None
    crossings: tuple[Crossing, ...] = ()

    def __post_init__(self) -> None:
        fields = vars(self)
        if fields["sigma"] is None:
            fields["sigma"] = np.zeros(len(self.visible), np.float32)
        for name, dtype in _ARRAYS:
            values = fields[name]
            if values is None:
                continue
            own = isinstance(values, np.ndarray) and values.base is None and values.dtype == dtype
            if own and not values.flags.writeable:
                continue  # such an array may be shared
            fields[name] = values = np.array(values, dtype)
            values.flags.writeable = False

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a pickled or deep-copied shape, whose arrays NumPy returns writable."""
        vars(self).update(state)
        self.__post_init__()

    def __repr__(self) -> str:
        """Summarize the shape in two lines: what was found, and its first and last point."""
        state = "ok" if self.ok else "not ok"
        reason = f", {self.reason}" if self.reason else ""
        points, unit = (self.points2d, "px") if self.points3d is None else (self.points3d, "m")
        first, last = (", ".join(f"{value:.{1 if unit == 'px' else 3}f}" for value in points[i]) for i in (0, -1))
        return (
            f"<Shape {self.name!r}: {state}, quality {self.quality:.2f}{reason}; {len(self)} points, "
            f"{np.count_nonzero(self.visible)} visible, {np.count_nonzero(self.valid)} valid\n"
            f"  {points.shape[1]}D, first ({first}) {unit}, last ({last}) {unit}>"
        )

    def __len__(self) -> int:
        return len(self.visible)

    @property
    def pixels(self) -> npt.NDArray[np.float32]:
        """(N,2) ``points2d``.

        Raises:
            ValueError: The shape was found in a cloud, which has no pixels.
        """
        if self.points2d is None:
            raise ValueError(f"shape {self.name!r} was found in a cloud and has no points2d: use points3d.")
        return self.points2d

    def to_dict(self) -> dict[str, Any]:
        """Return JSON-able values; NaN becomes None."""
        return {
            "name": self.name,
            "ok": self.ok,
            "quality": round(self.quality, 4),
            "reason": self.reason,
            "age": self.age,
            "track_id": self.track_id,
            "new": self.new,
            "length": None if self.length is None else round(self.length, 5),
            "points2d": None if self.points2d is None else _listed(self.points2d, 3),
            "points3d": None if self.points3d is None else _listed(self.points3d, 5),
            "visible": self.visible.tolist(),
            "valid": self.valid.tolist(),
            "sigma": [round(float(value), 5) for value in self.sigma],
        }


@dataclass(frozen=True, eq=False)
class Detection:
    """The shapes of one frame.

    Args:
        shapes: In the order of the detector's configurations; ``detection["name"]`` finds one by name.
        stamp: Seconds.
        timings: Milliseconds by stage, and ``"total"``: ``"roi"`` where it moves, ``"segmentation"`` of an image,
            ``"region"`` of a mask given, ``"cloud"``, ``"fit"``, ``"lift"``.
        warning: What is wrong with the frame though its shapes may be found: a stamp that stands still, runs back or
            jumps by more than a day. Empty if nothing is. The ``reason`` of a shape that was not found repeats it.
        more: By name, how many objects were found beyond the ``count`` of a configuration; empty if there were none.
        crossings: Where ropes lie over themselves and each other.
    """

    shapes: tuple[Shape, ...]
    stamp: float
    timings: Mapping[str, float] = field(default_factory=dict)
    warning: str = ""
    more: Mapping[str, int] = field(default_factory=dict)
    crossings: tuple[Crossing, ...] = ()

    def __repr__(self) -> str:
        """Summarize the shapes, two lines each."""
        warning = f", {self.warning}" if self.warning else ""
        lines = [f"<Detection: {len(self)} shapes, {'ok' if self.ok else 'not ok'}{warning}>", *map(repr, self.shapes)]
        return "\n".join(lines)

    def __getitem__(self, name: str) -> Shape:
        if not isinstance(name, str):
            raise TypeError(f"detection[...] takes the name of a shape, not {name!r}; use detection.shapes[{name!r}].")
        for shape in self.shapes:
            if shape.name == name:
                return shape
        slots = [
            shape.name for shape in self.shapes if shape.name[len(name) :].isdigit() and shape.name.startswith(name)
        ]
        if slots:
            raise KeyError(f"{name!r} has a count; its slots are {', '.join(map(repr, slots))}.")
        raise KeyError(f"no shape named {name!r}{did_you_mean(name, [shape.name for shape in self.shapes])}")

    def __iter__(self) -> Iterator[Shape]:
        return iter(self.shapes)

    def __len__(self) -> int:
        return len(self.shapes)

    @property
    def ok(self) -> bool:
        """Whether every shape is ok."""
        return all(shape.ok for shape in self.shapes)

    def to_dict(self) -> dict[str, Any]:
        """Return JSON-able values."""
        return {
            "ok": self.ok,
            "stamp": self.stamp,
            "warning": self.warning,
            "more": dict(self.more),
            "crossings": [each._asdict() for each in self.crossings],
            "shapes": [shape.to_dict() for shape in self.shapes],
            "timings_ms": {stage: round(time, 3) for stage, time in self.timings.items()},
        }


def _listed(points: npt.NDArray[np.float32], digits: int) -> list[list[float | None]]:
    return [[None if np.isnan(value) else round(float(value), digits) for value in row] for row in points]
