"""What a detector returns: shapes, and the detection that holds them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.topology import Topology
from shape_obs.spec import did_you_mean

_ARRAYS: Final = (("points2d", np.float32), ("points3d", np.float32), ("visible", np.bool_), ("valid", np.bool_))


@dataclass(frozen=True, eq=False)
class Shape:
    """N ordered points on an object. Point i stays the same material point from frame to frame.

    The four arrays are read-only and share no memory with the detector or the caller. Copy before you change:
    ``points = shape.points3d.copy()``, or compute a new array: ``shape.points3d - offset``.

    What holds for every shape that a detector returns:

    - ``valid`` is True only where ``visible`` is.
    - ``points3d`` is finite where ``valid`` is True. Elsewhere it holds what ``on_invalid`` asks for, which may be NaN.
    - ``points2d`` is finite if ``ok`` is True. It is NaN if no points are known, and never infinite.
    - ``quality`` and ``age`` are finite. ``reason`` is empty if and only if the points were found in this frame.

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

    def __post_init__(self) -> None:
        fields = vars(self)
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
            "points2d": None if self.points2d is None else _listed(self.points2d, 3),
            "points3d": None if self.points3d is None else _listed(self.points3d, 5),
            "visible": self.visible.tolist(),
            "valid": self.valid.tolist(),
        }


@dataclass(frozen=True, eq=False)
class Detection:
    """The shapes of one frame.

    Args:
        shapes: In the order of the detector's configurations; ``detection["name"]`` finds one by name.
        stamp: Seconds.
        timings: Milliseconds by stage, and ``"total"``: ``"roi"`` where it moves, ``"segmentation"`` of an image,
            ``"region"`` of a mask given, ``"cloud"``, ``"fit"``, ``"lift"``.
    """

    shapes: tuple[Shape, ...]
    stamp: float
    timings: Mapping[str, float] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Shape:
        for shape in self.shapes:
            if shape.name == name:
                return shape
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
            "shapes": [shape.to_dict() for shape in self.shapes],
            "timings_ms": {stage: round(time, 3) for stage, time in self.timings.items()},
        }


def _listed(points: npt.NDArray[np.float32], digits: int) -> list[list[float | None]]:
    return [[None if np.isnan(value) else round(float(value), digits) for value in row] for row in points]
