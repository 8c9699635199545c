"""The files of a recorded folder, and what stands in them.

``camera.json`` is written first, images next, and a line of ``frames.jsonl`` only after the images it names: whatever
moment a recording is cut at, the lines that are there are whole. The last line says that the recording was ended.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, TypeVar

import numpy as np

from shape_obs.camera import CameraModel, Intrinsics
from shape_obs.spec import Spec, SpecError

T = TypeVar("T", bound=Spec)

FORMAT: Final = "shape_obs recording"
VERSION: Final = 1
CAMERA_FILE: Final = "camera.json"
FRAMES_FILE: Final = "frames.jsonl"
END: Final = "end"


@dataclass(frozen=True)
class ImageEntry(Spec):
    """An image that a line of ``frames.jsonl`` names.

    Args:
        file: Path in the recording, ``"rgb/000000.png"``.
        crc32: Checksum of the array's bytes.
        file_crc32: Checksum of the file's bytes.
    """

    file: str
    crc32: int
    file_crc32: int


@dataclass(frozen=True)
class FrameLine(Spec):
    """A line of ``frames.jsonl``: a frame.

    Args:
        number: The source's own count; None where it does not count.
        stamp: Seconds of the source's clock.
        received: Seconds of the recording machine's monotonic clock.
        episode: Number of the stretch without jumps.
        anchors: Where the object was held: name -> (x, y, z) metres, or (u, v) pixels.
        camera: The frame's own camera, where it differs from that of ``camera.json``.
        rgb: The colour image.
        depth: The depth image.

    Raises:
        SpecError: A value of the wrong type.
    """

    number: int | None
    stamp: float | None
    received: float | None
    episode: int
    anchors: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    camera: Mapping[str, Any] | None = None
    rgb: ImageEntry | None = None
    depth: ImageEntry | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("number", "episode"):
            if not -(2**63) <= (getattr(self, name) or 0) < 2**63:
                raise SpecError(f"{name}: expected an integer of 64 bits.")
        for name, point in self.anchors.items():
            if len(point) not in (2, 3):
                raise SpecError(f"anchors.{name}: expected (x, y, z) or (u, v), got {point}.")


@dataclass(frozen=True)
class CameraFile(Spec):
    """``camera.json``: what all frames have in common, besides the camera model.

    Args:
        source: ``kind`` and ``name`` of the source that was recorded.
        serial: The camera's serial number, where there was one.
        depth: Whether frames carry depth.

    Raises:
        SpecError: A value of the wrong type.
    """

    source: Mapping[str, str]
    serial: str | None
    depth: bool


def read_known(kind: type[T], content: Mapping[str, Any]) -> T:
    """Build a spec from a mapping that may hold more than its fields: later versions may add some.

    Raises:
        SpecError: A field is missing or of the wrong type.
    """
    names = {each.name for each in dataclasses.fields(kind)}  # type: ignore[arg-type]
    return kind.from_dict({name: value for name, value in content.items() if name in names})


def camera_to_dict(camera: CameraModel | None) -> dict[str, Any]:
    """Turn a camera into JSON-able values; every number comes back to the bit."""
    place = None if camera is None else camera.transform_camera_to_base
    return {
        "intrinsics": None if camera is None else camera.intrinsics.to_dict(),
        "transform_camera_to_base": None if place is None else place.tolist(),
    }


def camera_from_dict(content: Mapping[str, Any]) -> CameraModel | None:
    """Read what ``camera_to_dict`` wrote.

    Raises:
        KeyError: A part is missing.
        TypeError: ``content`` is not a mapping.
        ValueError: A part is not a camera.
    """
    intrinsics, place = content["intrinsics"], content["transform_camera_to_base"]
    if intrinsics is None:
        return None
    try:
        matrix = None if place is None else np.array(place, np.float64)
    except OverflowError as error:
        raise ValueError(f"transform_camera_to_base: {error}") from error
    return CameraModel(Intrinsics.from_dict(intrinsics), matrix)
