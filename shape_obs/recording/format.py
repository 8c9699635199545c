"""Define the files of a recorded folder, and read moments from sources.

``camera.json`` is written first, then images, and a line of ``frames.jsonl`` only after the images that it names, so
that all lines of an interrupted recording are complete. The last line marks the end of a recording. Images are lossless
files with two checksums, one of the file and one of the array.
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

# Run-length coding: the fastest lossless setting, and for camera images also the smallest.
_PNG: Final = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]


@dataclass(frozen=True)
class ImageEntry(Spec):
    """An image file of a frame.

    Args:
        file: Path in the recording, such as ``"rgb/000000.png"``.
        crc32: Checksum of the array's bytes.
        file_crc32: Checksum of the file's bytes.
    """

    file: str
    crc32: int
    file_crc32: int


@dataclass(frozen=True)
class FrameLine(Spec):
    """A line of ``frames.jsonl``, which describes a frame.

    Args:
        number: Frame number of the source; None if it has none.
        stamp: Seconds of the source's clock.
        received: Seconds of the recording machine's monotonic clock.
        episode: Number of the episode.
        anchors: Points at which the object was held, by name: (x, y, z) in metres, or (u, v) in pixels.
        camera: Camera of the frame, if it differs from that in ``camera.json``.
        rgb: Colour image.
        depth: Depth image.

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
    """The content of ``camera.json``, besides the camera model.

    Args:
        source: ``kind`` and ``name`` of the recorded source.
        serial: Serial number of the camera, if known.
        depth: Whether frames carry depth.

    Raises:
        SpecError: A value of the wrong type.
    """

    source: Mapping[str, str]
    serial: str | None
    depth: bool


def read_known(kind: type[T], content: Mapping[str, Any]) -> T:
    """Build a spec from a mapping, ignoring unknown fields, which later versions may have added.

    Raises:
        SpecError: A field is missing or of the wrong type.
    """
    names = {each.name for each in dataclasses.fields(kind)}  # type: ignore[arg-type]
    return kind.from_dict({name: value for name, value in content.items() if name in names})


def camera_to_dict(camera: CameraModel | None) -> dict[str, Any]:
    """Return a camera as JSON values, from which ``camera_from_dict`` restores every number exactly."""
    pose = None if camera is None else camera.transform_camera_to_base
    return {
        "intrinsics": None if camera is None else camera.intrinsics.to_dict(),
        "transform_camera_to_base": None if pose is None else pose.tolist(),
    }


def camera_from_dict(content: Mapping[str, Any]) -> CameraModel | None:
    """Restore a camera from the values of ``camera_to_dict``.

    Raises:
        KeyError: A part is missing.
        TypeError: ``content`` is not a mapping.
        ValueError: A part is not a camera.
    """
    intrinsics, pose = content["intrinsics"], content["transform_camera_to_base"]
    if intrinsics is None:
        return None
    try:
        matrix = None if pose is None else np.array(pose, np.float64)
    except OverflowError as error:
        raise ValueError(f"transform_camera_to_base: {error}") from error
    return CameraModel(Intrinsics.from_dict(intrinsics), matrix)


def store(folder: Path, kind: str, index: int, image: npt.NDArray[Any]) -> dict[str, Any]:
    """Write an image and return its entry for ``frames.jsonl``.

    Args:
        folder: The recording.
        kind: ``"rgb"`` or ``"depth"``.
        index: Index of the frame in the recording.
        image: RGB of shape ``(H, W, 3)`` uint8; or depth of shape ``(H, W)``, stored as PNG if uint16 millimetres, and
            as .npy if floating-point metres.

    Returns:
        The fields of an ``ImageEntry``.

    Raises:
        OSError: The file cannot be written; a partly written file is removed.
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
    """Read exactly the array that ``store`` was given.

    Args:
        folder: The recording; files outside of it are never read.
        kind: ``"rgb"`` or ``"depth"``.
        entry: The image's entry in ``frames.jsonl``.

    Raises:
        BadRecording: The file is missing or damaged, lies outside the recording, or holds something else.
    """
    try:
        path = inside(folder, entry.file)
        if path.exists() and not path.is_file():
            raise ValueError(f"{path}: expected a file, got a folder or a device.")
        data = path.read_bytes()
    except OSError as error:
        raise BadRecording(
            f"{folder / entry.file}: cannot be read ({error.strerror}), but the recording names it."
        ) from error
    except ValueError as error:
        raise BadRecording(f"{folder}: it names an image outside of the recording: {error}") from error
    # Checked before decoding, since libpng writes errors to stderr.
    if zlib.crc32(data) != entry.file_crc32:
        raise BadRecording(f"{path}: damaged, its checksum differs from the recorded one.")
    try:
        image = _decoded(data, kind, path)
    except ValueError as error:
        raise BadRecording(str(error)) from error
    if _crc32(image) != entry.crc32:
        raise BadRecording(f"{path}: it decodes to another image than was recorded.")
    return image


def _decoded(data: bytes, kind: str, path: Path) -> npt.NDArray[Any]:
    """Decode the image in a file's content; raise ``ValueError`` if it is not an image of this kind."""
    if path.suffix == ".npy":
        image = decode_npy(data, str(path))
    else:
        image = decode_image(data, cv2.IMREAD_UNCHANGED, str(path))
    if kind == "depth":
        valid = image.ndim == 2 and (image.dtype == np.uint16 or np.issubdtype(image.dtype, np.floating))
    else:
        valid = image.ndim == 3 and image.shape[2] == 3 and image.dtype == np.uint8
    if not valid:
        raise ValueError(f"{path}: expected a {kind} image, got shape {image.shape} of {image.dtype}.")
    if path.suffix == ".npy" or kind == "depth":
        return image
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))


def _crc32(image: npt.NDArray[Any]) -> int:
    return zlib.crc32(np.ascontiguousarray(image).data.cast("B"))


class Moment(NamedTuple):
    """A frame with anchors and episode at the same instant.

    Attributes:
        frame: Frame of the camera.
        anchors: Points at which the object was held, by name: (x, y, z) in metres in the base frame, or pixel (u, v).
            Sources publish them in the attribute ``anchors``.
        episode: Number of the episode; between two episodes the scene may jump. Sources publish it in the attribute
            ``episode``.
    """

    frame: Frame
    anchors: Mapping[str, Sequence[float]] = {}
    episode: int = 0


def read_moment(source: RGBDSource, timeout: float) -> Moment:
    """Read the next frame of a source with its anchors and episode; raise as ``source.read`` does.

    Raises:
        TypeError: The source, of a user's own class, returned something else.
    """
    frame = source.read(timeout)
    if not isinstance(frame, Frame):
        raise TypeError(f"{source.name}: read() returned a {type(frame).__name__}, expected a shape_obs.Frame.")
    return Moment(frame, dict(getattr(source, "anchors", {})), getattr(source, "episode", 0))


def read_moments(
    source: RGBDSource, frames: int | None = None, seconds: float | None = None, patience: float = 20.0
) -> Iterator[Moment]:
    """Yield the moments of a source until it ends.

    Args:
        source: The source; it is connected if necessary.
        frames: Largest number of frames.
        seconds: Largest duration by the stamps, from the first one; the end is not included.
        patience: Seconds to wait for a frame; longer than a camera needs to recover after it stopped.

    Raises:
        ValueError: A limit is out of range, or ``seconds`` is given for a source without stamps.
        SourceError: ``source.connect`` or ``source.read`` fails.
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
                raise ValueError(f"{source.name}: its frames have no stamps: give frames in place of seconds.")
            begin = stamp if begin is None else begin
            # Half a millisecond of tolerance, so that rounding errors do not add a frame.
            if stamp - begin > seconds - 5e-4:
                return
        yield moment
        count += 1
