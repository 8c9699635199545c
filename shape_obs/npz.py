"""Read ``.npz`` files whose arrays are sized from their headers before they are read."""

from __future__ import annotations

import math
import tokenize
import zipfile
import zlib
from io import BytesIO
from typing import Any, Final

import numpy as np
import numpy.typing as npt

#: Bytes of all arrays of a file together, and how many arrays there may be.
MOST_BYTES: Final = 32 * 2**20
MOST_ARRAYS: Final = 256
#: ``np.save`` writes headers of about 120 bytes.
_MOST_HEADER: Final = 4096
_KINDS: Final = "biufU"


def read_npz(content: bytes, *, most_bytes: int = MOST_BYTES) -> dict[str, npt.NDArray[Any]]:
    """Read the arrays of a ``.npz`` file without running code from it and without reading more than it declares.

    Args:
        content: The file.
        most_bytes: How many bytes all arrays may have together.

    Raises:
        ValueError: The file is damaged, holds objects, or declares too much.
    """
    try:
        with zipfile.ZipFile(BytesIO(content)) as archive:
            infos = archive.infolist()
            if len(infos) > MOST_ARRAYS or sum(info.file_size for info in infos) > most_bytes:
                raise ValueError(f"expected at most {MOST_ARRAYS} arrays of {most_bytes} bytes together, got more.")
            arrays = {info.filename.removesuffix(".npy"): _read(archive, info) for info in infos}
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, OSError) as error:
        raise ValueError(f"not a .npz file, or a damaged one: {error}") from error
    if len(arrays) < len(infos):
        raise ValueError("two arrays have the same name.")
    return arrays


def _read(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> npt.NDArray[Any]:
    """Read one array; ``info.file_size`` bounds what is decompressed."""
    with archive.open(info) as file:
        data = file.read(info.file_size)
    shape, fortran, dtype, start = _header(data, info.filename)
    if dtype.hasobject or dtype.kind not in _KINDS:
        raise ValueError(f"array {info.filename!r}: expected numbers or text, got {dtype}.")
    declared = math.prod(shape) * dtype.itemsize
    if declared != len(data) - start:
        raise ValueError(f"array {info.filename!r}: its header declares {declared} bytes, it has {len(data) - start}.")
    return np.frombuffer(data, dtype, offset=start).reshape(shape, order="F" if fortran else "C").copy()


def _header(data: bytes, name: str) -> tuple[tuple[int, ...], bool, np.dtype[Any], int]:
    """(shape, Fortran order, dtype, where the values start) of a ``.npy`` file."""
    stream = BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        if version not in readers:
            raise ValueError(f"format {version} is not read")
        shape, fortran, dtype = readers[version](stream, max_header_size=_MOST_HEADER)
    except (ValueError, SyntaxError, tokenize.TokenError, TypeError, RecursionError, MemoryError) as error:
        raise ValueError(f"array {name!r}: its header cannot be read: {error}") from error
    if any(side < 0 for side in shape):
        raise ValueError(f"array {name!r}: a side of its shape {shape} is negative.")
    return shape, fortran, dtype, stream.tell()
