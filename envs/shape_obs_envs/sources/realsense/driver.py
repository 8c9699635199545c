"""librealsense, loaded when a camera is opened and not before."""

from __future__ import annotations

import ctypes
import functools
import importlib
import importlib.metadata
import sys
from typing import Any, Final

#: From this version on recordings are .db3, before it ROS bags.
_FIRST_DB3: Final = (2, 58)


@functools.cache
def librealsense() -> Any:
    """The module ``pyrealsense2``.

    Raises:
        ImportError: It is not installed, or there is none for this platform.
    """
    if sys.platform == "linux":
        _load_libusb()
    try:
        return importlib.import_module("pyrealsense2")
    except ImportError as error:
        raise ImportError(_advice(error), name="pyrealsense2") from error


def recording_suffix() -> str:
    """The suffix of recordings that the installed librealsense writes: ``".db3"``, or ``".bag"`` before 2.58."""
    librealsense()
    version = tuple(int(part) for part in importlib.metadata.version("pyrealsense2").split(".")[:2])
    return ".db3" if version >= _FIRST_DB3 else ".bag"


def _load_libusb() -> None:
    """The wheels of pyrealsense2 expect libusb on the machine; the package brings one where there is none."""
    try:
        libusb_package = importlib.import_module("libusb_package")
    except ImportError:
        return  # the machine's own then
    path = libusb_package.get_library_path()
    if path is not None:
        ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)


def _advice(error: ImportError) -> str:
    if sys.platform == "darwin":
        return (
            "pyrealsense2 has no packages for macOS: build librealsense with its Python wrapper, or use the camera on "
            f"Linux or Windows. ({error})"
        )
    if sys.version_info >= (3, 14):
        return f"pyrealsense2 has no packages for Python 3.14 yet: use Python 3.10 to 3.13. ({error})"
    return (
        "RealSense cameras and their recordings need librealsense, which is not here: "
        f"pip install 'shape-obs[realsense]'. ({error})"
    )
