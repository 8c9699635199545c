"""Read and write the file of a bundle: a zip of known members, and a manifest with their checksums.

Every size is checked before a member is read. Tensors are stored, not compressed, so that a small file cannot hold
large ones. Files that features were fitted to travel in the bundle as members ``files/<hash>``.
"""

from __future__ import annotations

import hashlib
import os
import re
import stat
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, Any, Final, NamedTuple

from shape_obs.deploy.policy_bundle.documents import BundleError, needs_trust, read_json, write_json
from shape_obs.features import PrincipalComponents
from shape_obs.utils.files import write_whole

FORMAT: Final = "shape_obs policy"
VERSION: Final = 2
#: The version of earlier releases, which holds a pickled model.
PICKLED: Final = 1

PICKLED_MODEL: Final = "model.zip"
PICKLED_STATISTICS: Final = "statistics.npz"
WEIGHTS: Final = "weights.safetensors"
STATISTICS: Final = "statistics.safetensors"
ENV: Final = "env.json"
CONFIG: Final = "config.yaml"
RECORD: Final = "policy.json"
_MANIFEST: Final = "manifest.json"
FOLDER: Final = "files/"
_FITTED: Final = re.compile(r"files/[0-9a-f]{16}(\.[A-Za-z0-9]{1,8})?")

_KIB, _MIB = 2**10, 2**20
_SHARED: Final = {
    _MANIFEST: 64 * _KIB,
    RECORD: 2 * _MIB,
    ENV: 256 * _KIB,
    CONFIG: 32 * _KIB,
    FOLDER: 8 * _MIB,
}
#: Largest size of each member in bytes, by version.
MOST_BYTES: Final = {
    VERSION: {**_SHARED, STATISTICS: 8 * _MIB, WEIGHTS: 1024 * _MIB},
    PICKLED: {**_SHARED, PICKLED_STATISTICS: 8 * _MIB, PICKLED_MODEL: 1024 * _MIB},
}
MOST_FITTED: Final = 8
_STORED: Final = (WEIGHTS, STATISTICS)
_MOST_DIRECTORY: Final = 16 * _KIB
_END: Final = struct.Struct("<4s4H2LH")
_ZIP64_LOCATOR: Final = 20
#: Size in bytes of the header before the name of a member.
_LOCAL_HEADER: Final = 30
#: Exceptions that a damaged length, method or stream raises.
_DAMAGED: Final = (
    zipfile.BadZipFile, zlib.error, struct.error, EOFError, NotImplementedError, RuntimeError, ValueError, OSError,
)  # fmt: skip
# A constant date, so that equal content gives equal files.
_DATE: Final = (1980, 1, 1, 0, 0, 0)


class Archive(NamedTuple):
    """The content of a bundle's file.

    Attributes:
        version: Version of the format.
        members: Members by name, without the manifest.
    """

    version: int
    members: dict[str, bytes]


def write_archive(path: str | os.PathLike[str], members: Mapping[str, bytes], version: int = VERSION) -> None:
    """Write members and their manifest into a file, completely or not at all.

    Raises:
        BundleError: A member is larger than ``read_archive`` accepts.
        OSError: The file cannot be written.
    """
    listed = {name: {"sha256": hashlib.sha256(data).hexdigest(), "size": len(data)} for name, data in members.items()}
    manifest = write_json({"format": FORMAT, "version": version, "members": listed})
    for name, data in members.items():
        _check_size(name, len(data), version)

    def write(temporary: Path) -> None:
        with zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in {_MANIFEST: manifest, **members}.items():
                method = zipfile.ZIP_STORED if name in _STORED else zipfile.ZIP_DEFLATED
                archive.writestr(zipfile.ZipInfo(name, _DATE), data, method)

    write_whole(Path(path), write)


def read_archive(path: str | os.PathLike[str], *, trust: bool = False) -> Archive:
    """Read all members of a bundle's file and verify their checksums.

    Args:
        path: The file.
        trust: Whether to read files of version 1, which hold a pickled model.

    Raises:
        FileNotFoundError: There is no such file.
        OSError: The file cannot be read.
        BundleError: The file is not a bundle, has another version, is truncated or too large, or a member is missing
            or was changed.
    """
    if not Path(path).is_file():
        raise FileNotFoundError(f"{path}: no such bundle")
    with Path(path).open("rb") as file:
        try:
            return _read(file, trust)
        except BundleError:
            raise
        except _DAMAGED as error:
            raise BundleError(f"not a bundle, or a truncated or damaged one: {error}. Copy it again.") from error


def _read(file: IO[bytes], trust: bool) -> Archive:
    start = _directory(file)
    with zipfile.ZipFile(file) as archive:
        infos = archive.infolist()
        if _MANIFEST not in archive.namelist():
            raise BundleError("expected a bundle as save_bundle writes it, got a zip file of something else.")
        _check_entries(infos, start)
        known = {info.filename: info for info in infos}
        _check_size(_MANIFEST, known[_MANIFEST].file_size, VERSION)
        manifest = _manifest(_content(archive, known.pop(_MANIFEST)))
        version = manifest["version"]
        if version == PICKLED and not trust:
            raise needs_trust(
                "it is a bundle of version 1, which holds a pickled model; reading it runs code from the file. "
                "You can also save the policy again with this version of shape_obs"
            )
        if type(version) is not int or version not in MOST_BYTES:
            raise BundleError(
                f"expected a bundle of version {VERSION}, got {version!r}: another version of shape_obs wrote it; use "
                "that one, or save the policy again."
            )
        for info in infos:
            _check_size(info.filename, info.file_size, version)
        listed = manifest["members"]
        for what, names in (
            ("lacks the", listed.keys() - known.keys()),
            ("has an unexpected", known.keys() - listed.keys()),
        ):
            if names:
                raise BundleError(f"the bundle {what} member {min(names)!r}. Copy it again.")
        return Archive(
            version, {name: _verified(_content(archive, info), name, listed) for name, info in known.items()}
        )


def _directory(file: IO[bytes]) -> int:
    """Return the offset of the zip's directory; refuse one that is large or not where ``write_archive`` puts it.

    ``zipfile`` creates an object for each entry in the directory, so the size of the directory is checked first.
    """
    size = file.seek(0, os.SEEK_END)
    file.seek(max(size - _END.size - _ZIP64_LOCATOR, 0))
    tail = file.read()
    if len(tail) < _END.size or tail[-_END.size :][:4] != b"PK\x05\x06":
        raise zipfile.BadZipFile("it does not end as a bundle does")
    _, _, _, _, count, length, start, comment = _END.unpack(tail[-_END.size :])
    if comment or start + length + _END.size != size or tail[:4] == b"PK\x06\x07":
        raise zipfile.BadZipFile("its directory is not where a bundle has it")
    if length > _MOST_DIRECTORY:
        raise BundleError(f"expected a directory of at most {_MOST_DIRECTORY} bytes, got {length} for {count} members.")
    return start


def _check_entries(infos: list[zipfile.ZipInfo], directory: int) -> None:
    """Refuse members that are not regular files, that occur twice, or that overlap."""
    names = [info.filename for info in infos]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise BundleError(f"the bundle has two members {twice[0]!r}.")
    if sum(name.startswith(FOLDER) for name in names) > MOST_FITTED:
        raise BundleError(f"expected at most {MOST_FITTED} fitted files, got more.")
    end = 0
    for info in sorted(infos, key=lambda info: info.header_offset):
        name = info.filename
        kind = stat.S_IFMT(info.external_attr >> 16)
        if info.flag_bits or kind not in (0, stat.S_IFREG):
            raise BundleError(f"member {name!r} is not a regular file.")
        stored = info.compress_type == zipfile.ZIP_STORED
        if not stored and (name in _STORED or info.compress_type != zipfile.ZIP_DEFLATED):
            raise BundleError(f"member {name!r} is compressed in a way that bundles do not use.")
        if stored and info.compress_size != info.file_size:
            raise BundleError(f"member {name!r} declares {info.file_size} bytes and has {info.compress_size}.")
        if info.header_offset != end:
            raise BundleError(f"member {name!r} overlaps another one, or there is a gap between them.")
        end += _LOCAL_HEADER + len(name.encode()) + info.compress_size
    if end != directory:
        raise BundleError("there is a gap between the members and their directory.")


def _check_size(name: str, size: int, version: int) -> None:
    kind, most = FOLDER if _FITTED.fullmatch(name) else name, MOST_BYTES[version]
    if kind not in most or name == FOLDER:
        raise BundleError(f"a bundle of version {version} has no member {name[:80]!r}.")
    if size > most[kind]:
        raise BundleError(f"member {name!r}: expected at most {most[kind]} bytes, got {size}.")


def _content(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> bytes:
    """Read a member, up to the size that it declares."""
    with archive.open(info) as member:
        return member.read(info.file_size)


def _verified(data: bytes, name: str, listed: Mapping[str, Any]) -> bytes:
    entry = listed[name] if isinstance(listed[name], Mapping) else {}
    size, digest, found = entry.get("size"), str(entry.get("sha256")), hashlib.sha256(data).hexdigest()
    if len(data) != size or found != digest:
        raise BundleError(
            f"member {name!r} was changed: expected {size!r} bytes with SHA-256 {digest[:12]}..., got {len(data)} "
            f"bytes with {found[:12]}... Copy it again."
        )
    return data


def _manifest(data: bytes) -> dict[str, Any]:
    manifest = read_json(data, _MANIFEST)
    if manifest.get("format") != FORMAT or not isinstance(manifest.get("members"), Mapping):
        raise BundleError("expected a bundle as save_bundle writes it, got a zip file of something else.")
    return {"version": manifest.get("version"), "members": manifest["members"]}


# ---- Files that features were fitted to


def pack(value: Any, files: dict[str, bytes]) -> Any:
    """Replace the paths of fitted files in JSON values by names of members.

    Args:
        value: JSON values with the specs of features.
        files: Gets the content of each fitted file, by the name of its member.

    Raises:
        OSError: A file cannot be read.
    """

    def name(path: str) -> str:
        data = Path(path).read_bytes()
        member = f"{FOLDER}{hashlib.sha256(data).hexdigest()[:16]}{Path(path).suffix}"
        files[member] = data
        return member

    return _renamed(value, name)


def unpack(value: Any, members: Mapping[str, bytes], folder: Path | None, *, trust: bool) -> Any:
    """Replace the names of members in JSON values by paths of the files in ``folder``.

    Raises:
        BundleError: A feature names another file, and the bundle is not trusted.
    """

    def path(member: str) -> str:
        if folder is not None and member.startswith(FOLDER) and member in members:
            return str(folder / member.removeprefix(FOLDER))
        if trust:
            return member
        raise needs_trust(f"a feature reads the file {member!r:.100}, which is not in the bundle")

    return _renamed(value, path)


def extract(members: Mapping[str, bytes], folder: Path) -> None:
    """Write the fitted files into a folder; ``read_archive`` has checked their names."""
    for name, data in members.items():
        if name.startswith(FOLDER):
            (folder / name.removeprefix(FOLDER)).write_bytes(data)


def _renamed(value: Any, rename: Callable[[str], str]) -> Any:
    if isinstance(value, Mapping):
        inner = {key: _renamed(item, rename) for key, item in value.items()}
        fitted = inner.get("kind") == PrincipalComponents.kind and isinstance(inner.get("file"), str)
        return {**inner, "file": rename(inner["file"])} if fitted else inner
    return [_renamed(item, rename) for item in value] if isinstance(value, list) else value
