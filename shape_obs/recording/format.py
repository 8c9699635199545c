"""The files of a recorded folder, and what stands in them.

``camera.json`` is written first, images next, and a line of ``frames.jsonl`` only after the images it names: whatever
moment a recording is cut at, the lines that are there are whole. The last line says that the recording was ended.

Images of a recording: lossless files with two checksums, one of the file and one of the array.

Moment: a frame with what its source tells beside it; and the one loop that reads sources.
"""

from __future__ import annotations

import dataclasses
import io
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraModel, Intrinsics
from shape_obs.frame import Frame
from shape_obs.source import BadRecording, EndOfSource, RGBDSource
from shape_obs.spec import Spec, SpecError
from shape_obs.utils.arrays import decode_image, decode_npy
from shape_obs.utils.files import inside

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


# Run-length coding: the fastest that is lossless, and on a camera's images also the smallest.
_PNG: Final = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]


def store(folder: Path, kind: str, index: int, image: npt.NDArray[Any]) -> dict[str, Any]:
    """Write an image and return its entry for ``frames.jsonl``.

    Args:
        folder: The recording.
        kind: ``"rgb"`` or ``"depth"``.
        index: Of the frame in the recording.
        image: (H,W,3) uint8 RGB; or depth: (H,W) uint16 millimetres as PNG, floating metres as .npy.

    Returns:
        The fields of an ``ImageEntry``.

    Raises:
        OSError: The file cannot be written; what was written of it is removed.
    """
    if np.issubdtype(image.dtype, np.floating):
        suffix, buffer = "npy", io.BytesIO()
        np.save(buffer, image)
        data = buffer.getvalue()
    else:
        suffix = "png"
        data = cv2.imencode(".png", image if kind == "depth" else cv2.cvtColor(image, cv2.COLOR_RGB2BGR), _PNG)[
            1
        ].tobytes()
    name = f"{kind}/{index:06d}.{suffix}"
    try:
        (folder / name).write_bytes(data)
    except OSError as error:
        (folder / name).unlink(missing_ok=True)
        raise OSError(f"cannot write {folder / name}: {error.strerror or error}") from error
    return {"file": name, "crc32": _crc32(image), "file_crc32": zlib.crc32(data)}


def restore(folder: Path, kind: str, entry: ImageEntry) -> npt.NDArray[Any]:
    """Read the array that ``store`` was given, to the bit.

    Args:
        folder: The recording; nothing outside of it is read.
        kind: ``"rgb"`` or ``"depth"``.
        entry: The image's entry in ``frames.jsonl``.

    Raises:
        BadRecording: The file is missing or damaged, lies outside the recording, or holds something else.
    """
    try:
        path = inside(folder, entry.file)
        if path.exists() and not path.is_file():
            raise ValueError(f"{path}: expected a file, there is a folder or a device.")
        data = path.read_bytes()
    except OSError as error:
        raise BadRecording(
            f"{folder / entry.file}: cannot be read ({error.strerror}), but the recording names it."
        ) from error
    except ValueError as error:
        raise BadRecording(f"{folder}: an image is named that is not one of the recording's: {error}") from error
    # Before decoding, since libpng complains to stderr by itself.
    if zlib.crc32(data) != entry.file_crc32:
        raise BadRecording(f"{path}: damaged, its checksum differs from the one noted when it was written.")
    try:
        image = _decoded(data, kind, path)
    except ValueError as error:
        raise BadRecording(str(error)) from error
    if _crc32(image) != entry.crc32:
        raise BadRecording(f"{path}: it decodes to another image than was recorded.")
    return image


def _decoded(data: bytes, kind: str, path: Path) -> npt.NDArray[Any]:
    """Return the image of a file's content; ValueError for anything that is not an image of this kind."""
    if path.suffix == ".npy":
        image = decode_npy(data, str(path))
    else:
        image = decode_image(data, cv2.IMREAD_UNCHANGED, str(path))
    if kind == "depth":
        right = image.ndim == 2 and (image.dtype == np.uint16 or np.issubdtype(image.dtype, np.floating))
    else:
        right = image.ndim == 3 and image.shape[2] == 3 and image.dtype == np.uint8
    if not right:
        raise ValueError(f"{path}: expected a {kind} image, got shape {image.shape} of {image.dtype}.")
    if path.suffix == ".npy" or kind == "depth":
        return image
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))


def _crc32(image: npt.NDArray[Any]) -> int:
    return zlib.crc32(np.ascontiguousarray(image).data.cast("B"))


class Moment(NamedTuple):
    """What a source told at one instant.

    Attributes:
        frame: What the camera saw.
        anchors: Where the object was held then: name -> base-frame point (x, y, z) in metres, or pixel (u, v). Sources
            that know publish them as ``anchors``, as environments do.
        episode: Counts the stretches between which the scene may have jumped: the episodes of an environment. Sources
            that have any publish it as ``episode``.
    """

    frame: Frame
    anchors: Mapping[str, Sequence[float]] = {}
    episode: int = 0


def read_moment(source: RGBDSource, timeout: float) -> Moment:
    """The next frame of a source, with what it tells beside it; errors as those of ``source.read``."""
    frame = source.read(timeout)
    return Moment(frame, dict(getattr(source, "anchors", {})), getattr(source, "episode", 0))


def read_moments(
    source: RGBDSource, frames: int | None = None, seconds: float | None = None, patience: float = 20.0
) -> Iterator[Moment]:
    """The moments of a source, until it ends.

    Args:
        source: Is connected where it is not.
        frames: How many at most.
        seconds: By the stamps, from the first one; its end is not included.
        patience: Seconds to wait for a frame; longer than a camera that stopped takes to come back.

    Raises:
        ValueError: ``seconds`` of a source whose frames have no stamps, or a limit that is none.
        SourceError: As ``source.connect`` and ``source.read``.
    """
    if frames is not None and frames < 1:
        raise ValueError(f"frames: expected 1 or more, got {frames}.")
    if seconds is not None and not seconds > 0:
        raise ValueError(f"seconds: expected more than 0, got {seconds}.")
    source.connect()
    begin, count = None, 0
    while frames is None or count < frames:
        try:
            moment = read_moment(source, patience)
        except EndOfSource:
            return
        stamp = moment.frame.stamp
        if seconds is not None:
            if stamp is None:
                raise ValueError(f"{source.name}: its frames have no stamps, so seconds mean nothing: give frames.")
            begin = stamp if begin is None else begin
            # Half a millisecond: sums of floating-point steps must not add a frame.
            if stamp - begin > seconds - 5e-4:
                return
        yield moment
        count += 1
