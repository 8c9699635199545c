"""Recordings: opened only when the file is what its name says, and whole."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from shape_obs.source import BadRecording
from shape_obs_envs.sources.realsense.driver import librealsense

_SQLITE: Final = b"SQLite format 3\0"
_ROSBAG: Final = b"#ROSBAG V"
_HEADER: Final = 100  # bytes of an SQLite header


def open_recording(path: Path) -> Any:
    """A recording as an ``rs.device``.

    Args:
        path: A .db3 (SQLite), or a .bag (ROS bag) of librealsense before 2.58.

    Raises:
        BadRecording: There is no such file, it is something else, its suffix is another's, or a part is missing.
    """
    if not path.is_file():
        raise BadRecording(f"{path}: there is no such file; expected a recording, .db3 or .bag.")
    _check(path)
    try:
        return librealsense().context().load_device(str(path))
    except RuntimeError as error:
        raise BadRecording(
            f"{path}: librealsense cannot read it, so it is not a recording of a RealSense camera or a part of it is "
            f"missing; copy it again, or take another one. ({error})"
        ) from error


def _check(path: Path) -> None:
    """Look at the first bytes: librealsense goes by the suffix, and some versions write a bag under any."""
    with path.open("rb") as file:
        header = file.read(_HEADER)
    if not header:
        raise BadRecording(f"{path}: the file is empty; the recording was never begun.")
    for magic, suffix, name in ((_SQLITE, ".db3", "a .db3 recording"), (_ROSBAG, ".bag", "a ROS bag")):
        if header.startswith(magic):
            if path.suffix != suffix:
                raise BadRecording(
                    f"{path}: this is {name} by its content, but its suffix is {path.suffix!r}: "
                    f"rename it to {path.with_suffix(suffix).name}."
                )
            break
    else:
        raise BadRecording(f"{path}: expected a recording of a RealSense camera (.db3 or .bag), it is something else.")
    if suffix == ".db3":
        _check_length(path, header)


def _check_length(path: Path, header: bytes) -> None:
    """The header of SQLite tells how many pages there are (https://www.sqlite.org/fileformat.html, 1.3)."""
    page = int.from_bytes(header[16:18], "big")
    expected = (65536 if page == 1 else page) * int.from_bytes(header[28:32], "big")
    size, told = path.stat().st_size, header[24:28] == header[92:96]
    if len(header) < _HEADER or (told and size < expected):
        raise BadRecording(
            f"{path}: a part is missing: {size} bytes of {expected if len(header) == _HEADER else 'an unknown number'}."
            " The copy was cut off; copy it again."
        )
