"""Write and read tables as Parquet files with two kinds of checksums: of each page, and of the whole file.

Page checksums (CRC-32) are part of the format, and other programs such as DuckDB and pyarrow can verify them. They do
not cover the footer, which holds the schema, the offsets of the columns and the metadata. The footer's metadata
therefore also holds the length of the file and the SHA-256 of all its bytes. If another program writes a new file and
copies the metadata, the length differs, and the checksum is ignored.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.utils.documents import parse_json
from shape_obs.utils.errors import install_hint

#: Key, in the metadata of the schema, of the table's metadata as JSON.
METADATA: Final = b"shape_obs"
_CHECKSUM: Final = "shape_obs.checksum"
_DIGITS: Final = 64
_BLANK: Final = f"{0:016d} bytes, sha256 {'0' * _DIGITS}"
_STAMP: Final = re.compile(rb"(\d{16}) bytes, sha256 ([0-9a-f]{64})")

Column = npt.NDArray[Any]


def write_parquet(
    path: Path,
    columns: Mapping[str, Column],
    metadata: Mapping[str, Any],
    absent: Mapping[str, npt.NDArray[np.bool_]] = MappingProxyType({}),
) -> None:
    """Write a table with its checksums; columns with more than one axis become flat lists.

    Args:
        path: The file.
        columns: Arrays with one row for each row of the table.
        metadata: JSON values.
        absent: Rows ``(F,)`` of a column that become null. Lists of such a column have no fixed size in the schema, so
            that files whose rows have other sizes form one dataset with it.

    Raises:
        ImportError: The extra ``parquet`` is missing.
        OSError: The file cannot be written.
    """
    arrow, parquet = need_pyarrow()
    arrays = {}
    for name, column in columns.items():
        flat = np.ascontiguousarray(column)
        width, null = int(np.prod(column.shape[1:])), absent.get(name)
        if column.ndim == 1:
            arrays[name] = arrow.array(flat, mask=null)
        elif null is None:
            arrays[name] = arrow.FixedSizeListArray.from_arrays(arrow.array(flat.ravel()), width)
        else:
            ends = np.concatenate([[0], np.cumsum(np.where(null, 0, width))]).astype(np.int32)
            arrays[name] = arrow.ListArray.from_arrays(
                arrow.array(ends), arrow.array(flat[~null].ravel()), mask=arrow.array(null)
            )
    content = arrow.table(arrays).replace_schema_metadata({METADATA: json.dumps(metadata)})
    with parquet.ParquetWriter(path, content.schema, write_page_checksum=True) as writer:
        writer.write_table(content)
        writer.add_key_value_metadata({_CHECKSUM: _BLANK})
    data = path.read_bytes()
    at = data.rindex(_BLANK.encode())
    sized = _stamped(data, at, f"{len(data):016d} bytes, sha256 {'0' * _DIGITS}")
    path.write_bytes(_stamped(data, at, f"{len(data):016d} bytes, sha256 {hashlib.sha256(sized).hexdigest()}"))


def read_parquet(path: Path) -> tuple[dict[str, Column], dict[str, Any]]:
    """Read a file that ``write_parquet`` wrote, after verifying its checksums.

    Returns:
        The columns, with flat lists as arrays of shape ``(F, W)``, and the metadata.

    Raises:
        ImportError: The extra ``parquet`` is missing.
        OSError: The file cannot be read.
        ValueError: The file is damaged, or is not such a file.
    """
    arrow, parquet = need_pyarrow()
    data = _checked(path)
    try:
        # Not read_table: a thread of its scan may still hold the bytes while the process ends, which then aborts.
        file = parquet.ParquetFile(arrow.BufferReader(data), page_checksum_verification=True)
        content = file.read(use_threads=False)
        metadata = parse_json((content.schema.metadata or {})[METADATA], "metadata")
        columns = {name: _as_array(content[name].combine_chunks()) for name in content.column_names}
    except (arrow.ArrowException, OSError) as error:
        raise ValueError(str(error)) from error
    if not isinstance(metadata, dict):
        raise ValueError(f"expected a mapping as metadata, got {type(metadata).__name__}")
    return columns, metadata


def need_pyarrow() -> tuple[Any, Any]:
    """Return the modules ``pyarrow`` and ``pyarrow.parquet``.

    Raises:
        ImportError: The extra ``parquet`` is missing.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise ImportError(f"Parquet needs pyarrow: {install_hint('parquet')} ({error})") from error
    return pyarrow, pyarrow.parquet


def _checked(path: Path) -> bytes:
    """Return a file's content after verifying its checksum, which files of early versions do not have."""
    data = path.read_bytes()
    *_, stamp = None, *_STAMP.finditer(data)
    if stamp is None or int(stamp[1]) != len(data):
        return data
    blank = _stamped(data, stamp.start(2), "0" * _DIGITS)
    if hashlib.sha256(blank).hexdigest().encode() != stamp[2]:
        raise ValueError("damaged, its checksum differs from the recorded one")
    return data


def _stamped(data: bytes, at: int, text: str) -> bytes:
    return data[:at] + text.encode() + data[at + len(text) :]


def _as_array(column: Any) -> Column:
    if hasattr(column.type, "list_size"):
        return column.flatten().to_numpy(zero_copy_only=False).reshape(len(column), column.type.list_size)
    if hasattr(column.type, "value_type"):
        return _as_rows(column)
    if column.null_count and column.type == "bool":
        column = column.fill_null(False)
    elif column.null_count and column.type == "int64":
        column = column.fill_null(-1)
    return column.to_numpy(zero_copy_only=False)


def _as_rows(column: Any) -> Column:
    """Return lists of floats of one size as rows, NaN where they are null."""
    there = column.is_valid().to_numpy(zero_copy_only=False)
    values = column.flatten().to_numpy(zero_copy_only=False)
    count = int(there.sum())
    rows = np.full((len(column), len(values) // max(count, 1)), np.nan)
    rows[there] = values.reshape(count, rows.shape[1])
    return rows
