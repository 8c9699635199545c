"""On what a measurement ran."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final

_PACKAGES: Final = ("numpy", "scipy", "opencv-python-headless", "opencv-python", "scikit-learn", "numba")


def machine(*more: str) -> dict[str, str]:
    """What of hardware and software decides the speed: name -> what it is.

    Args:
        more: Packages that have a say, beside those that always have.
    """
    found = {
        "processor": _processor(),
        "cores": str(os.cpu_count()),
        "system": f"{platform.system()} {platform.machine()}",
    }
    found["python"] = platform.python_version()
    return found | {package: number for package in (*_PACKAGES, *more) if (number := _version(package))}


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def _processor() -> str:
    table = Path("/proc/cpuinfo")
    if table.is_file():
        for line in table.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or "unknown"
