"""Reading and writing files: clear errors, and nothing half-written."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import yaml

from shape_obs.spec import SpecError


def read_image(path: Path) -> npt.NDArray[np.uint8]:
    """An image file as (H,W,3) uint8 RGB.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is no image.
    """
    picture = _decode(path, cv2.IMREAD_COLOR)
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def read_depth(path: Path) -> npt.NDArray[Any]:
    """A depth file: a 16-bit single-channel image in millimetres, or a .npy of uint16 millimetres or float metres.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It holds something else.
    """
    if path.suffix == ".npy":
        _check_is_file(path)
        try:
            depth = np.load(path, allow_pickle=False)
        except (ValueError, EOFError) as error:
            raise ValueError(f"{path}: not a NumPy array file: {error}") from error
    else:
        depth = _decode(path, cv2.IMREAD_UNCHANGED)
    if depth.ndim != 2 or not (depth.dtype == np.uint16 or np.issubdtype(depth.dtype, np.floating)):
        raise ValueError(
            f"{path}: expected depth of shape (H, W) as uint16 millimetres or float metres, "
            f"got shape {depth.shape} of {depth.dtype}."
        )
    return depth


def read_yaml(path: str | os.PathLike[str], what: str) -> Any:
    """What a YAML file holds.

    Args:
        path: The file.
        what: What it is, for messages: ``"config"``.

    Raises:
        FileNotFoundError: There is no such file.
        SpecError: It is no YAML.
    """
    try:
        return yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise FileNotFoundError(f"{path}: no such {what} file") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise SpecError(f"{path}: not a YAML file: {error}") from error


def make_folder(path: Path) -> Path:
    """Make a folder that can be written to.

    Raises:
        OSError: It cannot be made or written to.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(f"cannot make the output folder {path}: {error.strerror}") from error
    if not os.access(path, os.W_OK | os.X_OK):
        raise PermissionError(f"cannot write to the output folder {path}: permission denied")
    return path


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file whole or not at all: beside its place, then renamed; the suffix stays, since it tells the format.

    Args:
        path: Where the file belongs.
        write: Writes it to the path that it is given.

    Raises:
        OSError: It cannot be written.
    """
    beside = path.with_name(f".{os.getpid()}.{path.name}")
    try:
        write(beside)
        beside.replace(path)
    except OSError as error:
        raise type(error)(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        beside.unlink(missing_ok=True)


def _decode(path: Path, mode: int) -> npt.NDArray[Any]:
    _check_is_file(path)
    data = np.frombuffer(path.read_bytes(), np.uint8)
    picture = cv2.imdecode(data, mode) if data.size else None
    if picture is None:
        raise ValueError(f"{path}: not an image that can be read; it may be damaged.")
    return np.asarray(picture)


def _check_is_file(path: Path) -> None:
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    if not path.is_file():
        raise ValueError(f"{path}: expected a file, got a folder")
