"""The file of a bundle: a zip of members and a manifest with their checksums, written whole or not at all."""

from __future__ import annotations

import hashlib
import io
import json
import os
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from shape_obs.files import write_whole

FORMAT: Final = "shape_obs policy"
VERSION: Final = 1
_MANIFEST: Final = "manifest.json"
#: Equal content gives equal files.
_DATE: Final = (1980, 1, 1, 0, 0, 0)


class BundleError(ValueError):
    """A bundle that cannot be read or does not fit; the message says what was expected, what came and what to do."""


def write_archive(path: str | os.PathLike[str], members: Mapping[str, bytes]) -> None:
    """Write members and their manifest.

    Raises:
        OSError: It cannot be written.
    """
    told = {name: {"sha256": hashlib.sha256(data).hexdigest(), "size": len(data)} for name, data in members.items()}
    manifest = json.dumps({"format": FORMAT, "version": VERSION, "members": told}, indent=2).encode()

    def write(beside: Path) -> None:
        with zipfile.ZipFile(beside, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in {_MANIFEST: manifest, **members}.items():
                archive.writestr(zipfile.ZipInfo(name, _DATE), data, zipfile.ZIP_DEFLATED)

    write_whole(Path(path), write)


def read_archive(path: str | os.PathLike[str]) -> dict[str, bytes]:
    """The members by name, each as it was written.

    Raises:
        FileNotFoundError: There is no such file.
        OSError: It cannot be read.
        BundleError: It is no bundle, of another version, truncated, or a member is missing or was changed.
    """
    if not Path(path).is_file():
        raise FileNotFoundError(f"{path}: no such bundle")
    content = io.BytesIO(Path(path).read_bytes())  # what cannot be read at all is no damaged bundle
    try:
        with zipfile.ZipFile(content) as archive:
            found = {name: archive.read(name) for name in archive.namelist()}
    # A damaged length, method or stream tells itself in many ways.
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, OSError) as error:
        raise BundleError(f"{path}: not a bundle, or a truncated or damaged one: {error}. Copy it again.") from error
    manifest = _manifest(path, found.pop(_MANIFEST, None))
    if manifest.get("version") != VERSION:
        raise BundleError(
            f"{path}: expected a bundle of version {VERSION}, got {manifest.get('version')!r}: it was written by "
            "another shape_obs; use that one, or save the policy again."
        )
    told = manifest["members"]
    for what, names in (("misses", told.keys() - found.keys()), ("has a foreign", found.keys() - told.keys())):
        if names:
            raise BundleError(f"{path}: the bundle {what} member {min(names)!r}. Copy it again.")
    for name, data in found.items():
        size, digest = told[name].get("size"), told[name].get("sha256")
        if len(data) != size or hashlib.sha256(data).hexdigest() != digest:
            raise BundleError(
                f"{path}: member {name!r} was changed: expected {size} bytes with SHA-256 {str(digest)[:12]}..., got "
                f"{len(data)} bytes with {hashlib.sha256(data).hexdigest()[:12]}... Copy it again."
            )
    return found


def _manifest(path: str | os.PathLike[str], data: bytes | None) -> dict[str, Any]:
    try:
        manifest = {} if data is None else json.loads(data)
    except ValueError as error:
        raise BundleError(f"{path}: its manifest cannot be read: {error}. Copy it again.") from error
    members = manifest.get("members") if isinstance(manifest, Mapping) else None
    if not isinstance(members, Mapping) or manifest.get("format") != FORMAT:
        raise BundleError(f"{path}: expected a bundle as save_bundle writes it, got a zip file of something else.")
    return dict(manifest)
