"""Extrinsics: where a camera stands in the robot's base frame, and the file that says so."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from shape_obs.camera import CameraModel, Intrinsics
from shape_obs.spec import Spec


@dataclass(frozen=True)
class Extrinsics(Spec):
    """A camera's place in the base frame.

    Args:
        T: (4,4) homogeneous transform, row-major, metres: ``p_base = T p_camera``.
    """

    T: tuple[tuple[float, ...], ...]

    @classmethod
    def load(cls, path: str | Path) -> Extrinsics:
        """Read a file that ``save`` wrote."""
        raise NotImplementedError

    def camera(self, intrinsics: Intrinsics, serial: str | None = None) -> CameraModel:
        """The camera model of a stream with these intrinsics."""
        return CameraModel(intrinsics, self.T)  # pyright: ignore[reportArgumentType]
