"""Write files completely or not at all, and keep paths inside a folder."""

from __future__ import annotations

import errno
import hashlib
import os
import secrets
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Final

# What Windows, macOS, Linux, network storage and archivers leave in folders, besides names that start with a dot.
_LEFTOVERS: Final = {
    "thumbs.db", "ehthumbs.db", "desktop.ini", "$recycle.bin", "system volume information", "icon\r", "__macosx",
    "network trash folder", "temporary items", "lost+found", "@eadir", "#recycle",
}  # fmt: skip


def listing(folder: Path) -> list[Path]:
    """Return the sorted content of a folder without hidden files and what systems and editors leave there.

    These are names that start with a dot (``._0.png``, ``.DS_Store``, temporary files), ``Thumbs.db``, ``desktop.ini``,
    ``__MACOSX`` and the like, and backups of editors (``0.png~``, ``#0.png#``, ``0.bak``).

    Raises:
        OSError: The folder cannot be read.
    """
    return sorted(path for path in folder.iterdir() if not is_leftover(path.name))


def is_leftover(name: str) -> bool:
    """Return whether a file or folder of this name is ignored; see ``listing``."""
    backup = name.endswith(("~", ".bak")) or (name.startswith("#") and name.endswith("#"))
    return name.startswith(".") or backup or name.lower() in _LEFTOVERS


def make_folder(path: Path) -> Path:
    """Create a folder unless it exists, and check that it can be written to.

    Raises:
        OSError: The folder cannot be created or written to.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(f"cannot make the output folder {path}: {error.strerror}") from error
    if not os.access(path, os.W_OK | os.X_OK):
        raise PermissionError(f"cannot write to the output folder {path}: permission denied")
    return path


def inside(folder: Path, name: str) -> Path:
    """Return the path of a file named in a document, which must lie inside a folder.

    Args:
        folder: The folder.
        name: The path of the file inside the folder, with ``/`` between its parts.

    Raises:
        ValueError: The name is absolute, contains ``..``, or leads outside the folder through a symbolic link.
    """
    path = folder / name
    root, found = os.path.realpath(folder), os.path.realpath(path)
    # Also "\\" and ":": a plain name here would lead elsewhere on Windows.
    if ".." in Path(name).parts or any(character in name for character in "\\:") or os.path.isabs(name):
        raise ValueError(f"expected a path inside {folder}, got {name!r}.")
    if os.path.commonpath([root, found]) != root or found == root:
        raise ValueError(f"{path} leads to {found}, outside of {root}.")
    return path


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, completely or not at all; see ``write_whole``."""
    write_whole(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file completely or not at all.

    The content is written to a temporary file in the same folder, flushed to the disk, and then renamed: after a kill
    or a power cut, either the old or the complete new file is there. A process that is killed while it writes leaves
    the temporary file ``.NAME.<random>.SUFFIX``, which can be removed.

    A symbolic link is kept, and the file that it points to is replaced. A new file has the permissions that ``open``
    gives; a replaced file keeps its own.

    Args:
        path: The file.
        write: A function that writes the content to the path it receives, which has the suffix of ``path``.

    Raises:
        OSError: The file cannot be written; an existing file is unchanged.
    """
    temporary = begin_file(path)
    try:
        write(temporary)
        finish_file(temporary, path)
    except OSError as error:
        raise _cannot_write(path, error) from error
    finally:
        temporary.unlink(missing_ok=True)


def begin_file(path: Path) -> Path:
    """Create an empty temporary file that ``finish_file`` will rename to ``path``; see ``write_whole``.

    Returns:
        The temporary file. The caller writes it, and removes it after an error.

    Raises:
        OSError: ``path`` cannot be written.
    """
    try:
        target = _target(path)
        temporary = target.with_name(f".{target.name}.{secrets.token_hex(8)}{target.suffix}")
        # Fails if the file exists, and lets the system apply the umask.
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    except OSError as error:
        raise _cannot_write(path, error) from error
    return temporary


def finish_file(temporary: Path, path: Path) -> None:
    """Flush a temporary file to the disk and rename it to ``path``; see ``write_whole``.

    Raises:
        OSError: The file cannot be renamed; an existing file is unchanged.
    """
    target = _target(path)
    with temporary.open("r+b") as file:
        os.fsync(file.fileno())
    if target.exists():
        temporary.chmod(stat.S_IMODE(target.stat().st_mode))
    temporary.replace(target)
    _sync_folder(target.parent)


def checksum(path: Path) -> str:
    """Return the SHA-256 of a file's content, as hexadecimal digits."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def check_file(path: Path) -> None:
    """Check that ``write_whole`` can write a file or replace it, as far as that is known before.

    Raises:
        OSError: It cannot.
    """
    try:
        _target(path)
    except OSError as error:
        raise _cannot_write(path, error) from error


def _target(path: Path) -> Path:
    """Return the file to replace, which is the target of a symbolic link even if it does not exist yet.

    Raises:
        OSError: The path is a folder, a device or read-only, or its links form a circle.
    """
    target = Path(os.path.realpath(path)) if path.is_symlink() else path
    if target.is_symlink():
        raise OSError(errno.ELOOP, "its symbolic links lead in a circle")
    if target.is_dir():
        raise IsADirectoryError(errno.EISDIR, "expected a file, there is a folder")
    if target.exists():
        if not target.is_file():
            raise OSError(errno.EINVAL, "expected a file, there is a device or a pipe")
        if not os.access(target, os.W_OK):
            raise PermissionError(errno.EACCES, "permission denied: the file is read-only")
    elif not target.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, f"there is no folder {target.parent}")
    return target


def _sync_folder(folder: Path) -> None:
    """Flush the directory entries of a folder to the disk, if the system supports it."""
    if os.name != "posix":
        return
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # not supported by some network file systems
            raise
    finally:
        os.close(number)


def _cannot_write(path: Path, error: OSError) -> OSError:
    return type(error)(f"cannot write {path}: {error.strerror or error}")
