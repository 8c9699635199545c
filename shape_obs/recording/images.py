"""Images of a recording: lossless files with two checksums, one of the file and one of the array."""

from __future__ import annotations

import io
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.source import BadRecording

# Run-length coding: the fastest that is lossless, and on a camera's images also the smallest.
_PNG: Final = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]


def store(folder: Path, kind: str, index: int, image: npt.NDArray[Any]) -> dict[str, Any]:
    """Write an image and tell what a later reader needs.

    Args:
        folder: The recording.
        kind: ``"rgb"`` or ``"depth"``.
        index: Of the frame in the recording.
        image: (H,W,3) uint8 RGB; or depth: (H,W) uint16 millimetres as PNG, floating metres as .npy.

    Returns:
        ``file`` in the recording, ``crc32`` of the array's bytes, ``file_crc32`` of the file's.

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


def restore(folder: Path, kind: str, entry: Mapping[str, Any]) -> npt.NDArray[Any]:
    """The array that ``store`` was given, to the bit.

    Raises:
        BadRecording: The file is missing or damaged.
    """
    path = folder / entry["file"]
    try:
        data = path.read_bytes()
    except OSError as error:
        raise BadRecording(f"{path}: cannot be read ({error.strerror}), but the recording names it.") from error
    # Before decoding, since libpng complains to stderr by itself.
    if zlib.crc32(data) != entry["file_crc32"]:
        raise BadRecording(f"{path}: damaged, its checksum differs from the one noted when it was written.")
    if path.suffix == ".npy":
        image = np.load(io.BytesIO(data), allow_pickle=False)
    else:
        image = np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED))
        image = image if kind == "depth" else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
    if _crc32(image) != entry["crc32"]:
        raise BadRecording(f"{path}: it decodes to another image than was recorded.")
    return image


def _crc32(image: npt.NDArray[Any]) -> int:
    return zlib.crc32(np.ascontiguousarray(image).data.cast("B"))
