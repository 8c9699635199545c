"""Files that features were fitted to: they travel within the bundle."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from shape_obs.features import PrincipalComponents

FOLDER: Final = "files/"


def pack(value: Any, files: dict[str, bytes]) -> Any:
    """JSON values with the fitted files of features named by their members, which are added to ``files``.

    Raises:
        OSError: One of them cannot be read.
    """

    def name(path: str) -> str:
        data = Path(path).read_bytes()
        member = f"{FOLDER}{hashlib.sha256(data).hexdigest()[:16]}{Path(path).suffix}"
        files[member] = data
        return member

    return _renamed(value, name)


def unpack(value: Any, folder: Path) -> Any:
    """JSON values with members named by where ``extract`` has put them."""
    return _renamed(value, lambda member: str(folder / member.removeprefix(FOLDER)))


def extract(members: Mapping[str, bytes], folder: Path) -> None:
    """Write the fitted files into a folder."""
    for name, data in members.items():
        if name.startswith(FOLDER):
            (folder / Path(name).name).write_bytes(data)


def _renamed(value: Any, rename: Callable[[str], str]) -> Any:
    if isinstance(value, Mapping):
        inner = {key: _renamed(item, rename) for key, item in value.items()}
        fitted = inner.get("kind") == PrincipalComponents.kind and isinstance(inner.get("file"), str)
        return {**inner, "file": rename(inner["file"])} if fitted else inner
    return [_renamed(item, rename) for item in value] if isinstance(value, list) else value
