"""Store images losslessly, with two checksums each: one of the file and one of the array."""

from __future__ import annotations

import io
import zlib
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.recording.format import ImageEntry
from shape_obs.source import BadRecording
from shape_obs.utils.arrays import decode_image, decode_npy
from shape_obs.utils.files import inside

# Run-length coding: the fastest lossless setting, and for camera images also the smallest.
_PNG: Final = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]


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
