"""Extrinsics: the pose of a camera in the robot's base frame, and its file."""

from __future__ import annotations

import json
import math
import warnings
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraLike, CameraModel, Intrinsics, as_intrinsics, rigid_transform
from shape_obs.spec import Spec, SpecError
from shape_obs.utils.documents import read_json
from shape_obs.utils.files import write_text

CONVENTION: Final = "p_base = T p_camera; T row-major, metres; camera: optical frame, x right, y down, z forward"
# Largest change of intrinsics that count as the same, relative to the focal length, and to the image width for the
# principal point.
_SAME: Final = 0.01
_SECONDS_A_DAY: Final = 86400.0


class ExtrinsicsWarning(UserWarning):
    """The pose of a camera may differ from the one in its file."""


def now() -> str:
    """Return the current time in UTC, ISO 8601."""
    return datetime.now(timezone.utc).isoformat(timespec="seconds")


@dataclass(frozen=True)
class Extrinsics(Spec):
    """The pose of a camera in the base frame, as ``shape-obs calibrate base`` measures it.

    Args:
        T: ``(4, 4)`` rigid transform, row-major, metres: ``p_base = T p_camera``.
        intrinsics: Intrinsics of the camera at the time of the measurement; None if unknown.
        serial: Serial number of the camera; None if unknown.
        rms: Root mean square residual of the measured points in metres; None if unknown.
        created: Time of the measurement, ISO 8601 with a time zone.
        max_age_days: Number of days after which the pose counts as old.
        parent: The frame that T leads to.
        child: The frame that T starts from.
        convention: The convention in words, for readers of the file.

    Raises:
        SpecError: T is not a rigid transform, or the time is not ISO 8601.
    """

    T: tuple[tuple[float, ...], ...]
    intrinsics: Intrinsics | None = None
    serial: str | None = None
    rms: float | None = None
    created: str = field(default_factory=now)
    max_age_days: float = 30.0
    parent: str = "base"
    child: str = "camera"
    convention: str = CONVENTION

    def __post_init__(self) -> None:
        super().__post_init__()
        rigid_transform(self.T, "Extrinsics.T")
        if (self.parent, self.child) != ("base", "camera"):
            raise SpecError(
                f"Extrinsics: expected parent 'base' and child 'camera', got {self.parent!r} and {self.child!r}; "
                "invert T if it leads the other way."
            )
        if not self.max_age_days > 0:
            raise SpecError(f"Extrinsics.max_age_days: expected a positive number, got {self.max_age_days}.")
        self._when()

    @property
    def matrix(self) -> npt.NDArray[np.float64]:
        """``T`` as an array ``(4, 4)``."""
        return np.array(self.T, np.float64)

    @property
    def age_days(self) -> float:
        """Days since the measurement."""
        return (datetime.now(timezone.utc) - self._when()).total_seconds() / _SECONDS_A_DAY

    @classmethod
    def load(cls, path: str | Path) -> Extrinsics:
        """Read a file that ``save`` wrote.

        Raises:
            FileNotFoundError: There is no such file.
            SpecError: The file is not JSON, an entry is missing, or ``T`` is not a rigid transform.
        """
        data = read_json(path, "extrinsics")
        try:
            if isinstance(data, dict):
                missing = [key for key in ("parent", "child", "T", "created") if key not in data]
                if missing:
                    raise SpecError(f"missing {', '.join(missing)}; `shape-obs calibrate base` writes such files.")
            return cls.from_dict(data)
        except ValueError as error:
            raise SpecError(f"{path}: {error}") from error

    def save(self, path: str | Path) -> None:
        """Write the pose as JSON, completely or not at all.

        Raises:
            OSError: The file cannot be written.
        """
        write_text(Path(path), json.dumps(self.to_dict(), indent=2) + "\n")

    def doubts(self, intrinsics: Intrinsics | None = None, serial: str | None = None) -> list[str]:
        """Return the reasons, one sentence each, why this may not be the pose of a camera; empty if there are none.

        Args:
            intrinsics: Intrinsics of the stream; None skips the comparison.
            serial: Serial number of the camera; None skips the comparison.
        """
        found = []
        if self.age_days > self.max_age_days:
            found.append(
                f"the pose of the camera was measured {self.age_days:.0f} days ago, which is more than "
                f"{self.max_age_days:g}: measure it again with `shape-obs calibrate base`."
            )
        if serial is not None and self.serial is not None and serial != self.serial:
            found.append(f"the pose is that of camera {self.serial}, but this is camera {serial}.")
        if intrinsics is not None and self.intrinsics is not None:
            difference = _difference(intrinsics, self.intrinsics)
            if difference > _SAME:
                found.append(
                    f"the pose was measured with other intrinsics ({_describe(self.intrinsics)}) than those of this "
                    f"stream ({_describe(intrinsics)}): they differ by {100 * difference:.1f} %."
                )
        return found

    def camera(self, intrinsics: CameraLike, serial: str | None = None) -> CameraModel:
        """Return the camera model of a stream.

        Args:
            intrinsics: Intrinsics of the stream, in any form that ``as_camera_model`` reads.
            serial: Serial number of the camera; None if it has none.

        Warns:
            ExtrinsicsWarning: The pose is old, belongs to another camera, or was measured with other intrinsics. It is
                shown once for each stream.
        """
        made: dict[tuple[Intrinsics, str | None], CameraModel] = self.__dict__.setdefault("_made", {})
        intrinsics = as_intrinsics(intrinsics)
        if (intrinsics, serial) not in made:
            for doubt in self.doubts(intrinsics, serial):
                warnings.warn(doubt, ExtrinsicsWarning, stacklevel=2)
            made[intrinsics, serial] = CameraModel(intrinsics, self.matrix)
        return made[intrinsics, serial]

    def _when(self) -> datetime:
        try:
            when = datetime.fromisoformat(self.created.replace("Z", "+00:00"))  # Python 3.10 does not parse Z
        except ValueError as error:
            raise SpecError(f"Extrinsics.created: expected a time such as {now()}, got {self.created!r}.") from error
        return when if when.tzinfo else when.replace(tzinfo=timezone.utc)


def _difference(one: Intrinsics, other: Intrinsics) -> float:
    """Return the largest relative change of the view; images of one camera in two sizes have the same view."""
    scale = one.width / other.width
    if not math.isclose(one.height / other.height, scale, rel_tol=0.01):
        return abs(one.height / other.height / scale - 1)
    return max(
        abs(one.fx / (scale * other.fx) - 1),
        abs(one.fy / (scale * other.fy) - 1),
        abs(one.cx - scale * other.cx) / one.width,
        abs(one.cy - scale * other.cy) / one.width,
    )


def _describe(intrinsics: Intrinsics) -> str:
    focal = f"fx {intrinsics.fx:.1f}, fy {intrinsics.fy:.1f}, cx {intrinsics.cx:.1f}, cy {intrinsics.cy:.1f}"
    return f"{intrinsics.width} x {intrinsics.height}, {focal}"
