"""Read and write images and arrays, with limits on their size and one declared error for damaged files."""

from __future__ import annotations

import io
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.utils.files import write_whole
from shape_obs.utils.image_layout import is_depth

#: Largest number of bytes of all arrays in a .npz file.
MOST_BYTES: Final = 4 << 30
#: Largest number of pixels of a PNG image, 8192 x 8192. OpenCV itself rejects other images from 2^30 pixels on.
MOST_PIXELS: Final = 1 << 26

#: Largest list of entries of a ZIP file in bytes: some 10,000 entries.
_LONGEST_LIST: Final = 1 << 20
#: The end of a ZIP file without a comment: signature, number of entries, bytes of the list of entries, length of the
#: comment. Before it there is the signature of ZIP64 if another list counts, of more than 65,535 entries or 4 GiB.
_ZIP_END: Final = struct.Struct("<4s6xHI4xH")
_ZIP_MARK, _ZIP64_MARK, _ZIP64_BYTES = b"PK\5\6", b"PK\6\7", 20
_PNG: Final = b"\x89PNG\r\n\x1a\n"
_PNG_SIZE: Final = struct.Struct(">II")  # width and height, the first fields of the first chunk
_PNG_SIZE_AT: Final = len(_PNG) + 8  # after the length and the name of the chunk

# What NumPy's reader raises for damaged headers and archives.
_DAMAGED: Final = (
    ValueError, TypeError, KeyError, IndexError, SyntaxError, EOFError, OSError, OverflowError, MemoryError,
    RecursionError, NotImplementedError, RuntimeError, struct.error, tokenize.TokenError, zipfile.BadZipFile,
    zlib.error,
)  # fmt: skip


def read_image(path: Path) -> npt.NDArray[np.uint8]:
    """Read an image file as RGB, of shape ``(H, W, 3)``, uint8.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is not an image, is damaged or too large.
    """
    picture = decode_image(_content(path), cv2.IMREAD_COLOR, str(path))
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def read_depth(path: Path) -> npt.NDArray[Any]:
    """Read a depth file: a 16-bit single-channel image in millimetres, or a .npy of 16-bit millimetres or float metres.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file contains something else, or is damaged.
    """
    data = _content(path)
    npy = path.suffix == ".npy"
    depth = decode_npy(data, str(path)) if npy else decode_image(data, cv2.IMREAD_UNCHANGED, str(path))
    if depth.ndim != 2 or not is_depth(depth.dtype):
        raise ValueError(
            f"{path}: expected depth of shape (H, W) as uint16 or int16 millimetres or float metres, "
            f"got shape {depth.shape} of {depth.dtype}."
        )
    return depth


def write_image(path: Path, rgb: npt.NDArray[np.uint8]) -> None:
    """Write an RGB picture of shape ``(H, W, 3)``, completely or not at all.

    Raises:
        ValueError: The suffix is not that of an image format.
        OSError: The file cannot be written.
    """
    try:
        done, data = cv2.imencode(path.suffix, cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
    except cv2.error as error:
        raise ValueError(f"{path}: cannot write an image with the suffix {path.suffix!r}.") from error
    assert done
    write_whole(path, lambda temporary: temporary.write_bytes(data.tobytes()))


def write_gif(path: Path, frames: Sequence[npt.NDArray[np.uint8]], seconds_per_frame: float) -> None:
    """Write RGB frames of shape ``(H, W, 3)`` as an animated GIF, completely or not at all."""
    from PIL import Image

    pictures = [Image.fromarray(frame).quantize(128, dither=Image.Dither.NONE) for frame in frames]
    duration = max(round(1000 * seconds_per_frame), 20)
    write_whole(
        path,
        lambda temporary: pictures[0].save(
            temporary, save_all=True, append_images=pictures[1:], duration=duration, loop=0, optimize=True
        ),
    )


def decode_image(data: bytes, mode: int, where: str) -> npt.NDArray[Any]:
    """Decode an image.

    Args:
        data: The content of the file.
        mode: One of OpenCV's ``IMREAD_`` flags; colours are returned as BGR.
        where: The name of the file, for error messages.

    Raises:
        ValueError: The data are not an image, are damaged or too large.
    """
    # A few bytes of PNG can unpack to gigabytes.
    if data.startswith(_PNG) and len(data) >= _PNG_SIZE_AT + _PNG_SIZE.size:
        width, height = _PNG_SIZE.unpack_from(data, _PNG_SIZE_AT)
        if width * height > MOST_PIXELS:
            raise ValueError(f"{where}: expected an image of at most {MOST_PIXELS} pixels, got {width} x {height}.")
    try:
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), mode) if data else None
    except cv2.error as error:
        raise ValueError(f"{where}: not an image that can be read: {error.err or error}") from error
    if picture is None:
        raise ValueError(f"{where}: not an image that can be read; it may be damaged.")
    return np.asarray(picture)


def decode_npy(data: bytes, where: str) -> npt.NDArray[Any]:
    """Decode the content of a .npy file.

    Args:
        data: The content of the file.
        where: The name of the file, for error messages.

    Raises:
        ValueError: The data are not a .npy file, are damaged, or contain Python objects.
    """
    stream = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read_header(stream)
        # NumPy allocates the size in the header before it reads any data.
        wanted, left = dtype.itemsize * int(np.prod(shape, dtype=object)), len(data) - stream.tell()
        if wanted != left or min(shape, default=0) < 0:
            raise ValueError(f"its header announces {wanted} bytes, {left} follow")
        return np.load(io.BytesIO(data), allow_pickle=False)
    except _DAMAGED as error:
        raise ValueError(f"{where}: not a NumPy array file, or a damaged one: {error}") from error


def decode_npz(data: bytes, where: str, *, most_bytes: int = MOST_BYTES) -> dict[str, npt.NDArray[Any]]:
    """Decode the content of a .npz file as arrays by name, after checking their checksums.

    Args:
        data: The content of the file.
        where: The name of the file, for error messages.
        most_bytes: Largest total number of bytes of all arrays.

    Raises:
        ValueError: The data are not a .npz file, are damaged or too large, or contain Python objects.
    """
    arrays: dict[str, npt.NDArray[Any]] = {}
    try:
        with open_zip(io.BytesIO(data)) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > most_bytes:
                raise ValueError(f"expected at most {most_bytes} bytes when unpacked")
            for name in archive.namelist():
                if not name.endswith(".npy") or name[:-4] in arrays:
                    raise ValueError(f"unexpected entry {name!r}")
                arrays[name[:-4]] = decode_npy(archive.read(name), name)
    except _DAMAGED as error:
        raise ValueError(f"{where}: not a file of NumPy arrays, or a damaged one: {error}") from error
    return arrays


def open_zip(file: BinaryIO) -> zipfile.ZipFile:
    """Open a ZIP file after checking its list of entries, which ``zipfile`` reads without a limit.

    Args:
        file: The open file.

    Raises:
        zipfile.BadZipFile: The file is damaged, has a comment, more than some 10,000 entries or 4 GiB, or another kind
            of compression than NumPy's.
    """
    tail = min(_ZIP64_BYTES + _ZIP_END.size, file.seek(0, io.SEEK_END))
    file.seek(-tail, io.SEEK_END)
    end = file.read(tail)
    if len(end) < _ZIP_END.size:
        raise zipfile.BadZipFile("it is too short for a ZIP file")
    mark, count, size, comment = _ZIP_END.unpack(end[-_ZIP_END.size :])
    if mark != _ZIP_MARK or comment or end.startswith(_ZIP64_MARK) or size > _LONGEST_LIST:
        raise zipfile.BadZipFile(f"its end is missing, has a comment, or a list of more than {_LONGEST_LIST} bytes")
    archive = zipfile.ZipFile(file)
    entries = archive.infolist()
    if count != len(entries):  # a damaged length in the list of entries hides those that follow
        raise zipfile.BadZipFile(f"expected {count} entries, found {len(entries)}")
    if any(entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for entry in entries):
        raise zipfile.BadZipFile("expected entries that are stored or deflated")
    return archive


def _content(path: Path) -> bytes:
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    if not path.is_file():
        raise ValueError(f"{path}: expected a file, got a folder")
    return path.read_bytes()
