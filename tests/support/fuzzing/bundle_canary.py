"""A package, in a folder on the path, whose code leaves a mark when an attack runs it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

#: The name of the module, and of the environment variable with the path of the file that it makes.
MODULE: Final = "bundle_canary"
VARIABLE: Final = "BUNDLE_CANARY"
_CODE: Final = f"""
import os, pathlib
pathlib.Path(os.environ["{VARIABLE}"]).touch()

def __getattr__(name):
    raise AttributeError(name)
"""
#: As a plugin of features, segmentations and all other families, so that an unknown kind would load it.
_FAMILIES: Final = ("feature", "segmentation", "configuration", "roi", "clustering")


def write_canary(folder: Path) -> None:
    """Write the module, and the metadata of a distribution with a plugin of each family."""
    (folder / f"{MODULE}.py").write_text(_CODE)
    installed = folder / f"{MODULE}-1.0.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {MODULE}\nVersion: 1.0\n")
    entries = "".join(f"[shape_obs.{family}]\ncanary = {MODULE}:Kind\n" for family in _FAMILIES)
    (installed / "entry_points.txt").write_text(entries)


class Touch:
    """An object that makes the canary's file when it is unpickled."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        """Name a function of the operating system, as a hostile pickle does."""
        return os.system, (f'touch "${VARIABLE}"',)
