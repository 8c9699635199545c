"""Files that features were fitted to: they travel within the bundle."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from shape_obs.deploy.policy_bundle.errors import needs_trust
from shape_obs.features import PrincipalComponents

FOLDER: Final = "files/"


def pack(value: Any, files: dict[str, bytes]) -> Any:
    """Return JSON values in which features name members in place of their fitted files, which ``files`` gains.

    Raises:
        OSError: One of them cannot be read.
    """

    def name(path: str) -> str:
        data = Path(path).read_bytes()
        member = f"{FOLDER}{hashlib.sha256(data).hexdigest()[:16]}{Path(path).suffix}"
        files[member] = data
        return member

    return _renamed(value, name)


def unpack(value: Any, members: Mapping[str, bytes], folder: Path | None, *, trust: bool) -> Any:
    """Return JSON values in which features name files in ``folder`` in place of members.

    Raises:
        BundleError: A feature names any other file, and the bundle is not trusted.
    """

    def path(member: str) -> str:
        if folder is not None and member.startswith(FOLDER) and member in members:
            return str(folder / member.removeprefix(FOLDER))
        if trust:
            return member
        raise needs_trust(f"a feature reads the file {member!r:.100}, which the bundle does not hold")

    return _renamed(value, path)


def extract(members: Mapping[str, bytes], folder: Path) -> None:
    """Write the fitted files into a folder; the archive has checked their names."""
    for name, data in members.items():
        if name.startswith(FOLDER):
            (folder / name.removeprefix(FOLDER)).write_bytes(data)


def _renamed(value: Any, rename: Callable[[str], str]) -> Any:
    if isinstance(value, Mapping):
        inner = {key: _renamed(item, rename) for key, item in value.items()}
        fitted = inner.get("kind") == PrincipalComponents.kind and isinstance(inner.get("file"), str)
        return {**inner, "file": rename(inner["file"])} if fitted else inner
    return [_renamed(item, rename) for item in value] if isinstance(value, list) else value
