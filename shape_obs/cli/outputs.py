"""Protect the user's files: no command writes over what it reads, or replaces what it did not write itself."""

from __future__ import annotations

import os
import sys
import unicodedata
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Final

from shape_obs.cli.parsing import Option, options_of
from shape_obs.utils.errors import UsageError
from shape_obs.utils.files import check_file, checksum

#: The option ``--overwrite``, which every command that writes files has.
Overwrite = Annotated[bool, Option(group="output")]
#: The manifest of a folder of results: what commands wrote there, as lines that ``sha256sum --check`` reads.
MANIFEST: Final = ".shape_obs.sha256"


def check_outputs(args: Any, *paths: Path | None, hint: str = "") -> None:
    """Check that a command may write files, before it does any work.

    An existing file is replaced with ``--overwrite``, or if the manifest of its folder has its checksum: a command
    wrote it, and it is unchanged since. A file that the command reads, under any name, is never replaced.

    Args:
        args: The arguments of the command. Options outside of the group "output" are what it reads.
        paths: All files that the command will write; None for those that it will not.
        hint: What else can be done about an existing file, for the message.

    Raises:
        UsageError: A file would be written over an input, or twice.
        FileExistsError: A file exists and may not be replaced.
        OSError: An existing file cannot be replaced: it is a folder, a device or read-only.
    """
    files = [path for path in paths if path is not None]
    keys: set[str] = set()
    for path in files:
        if _key(path) in keys:
            raise UsageError(f"{path} would be written twice: choose different names.")
        keys.add(_key(path))
    inputs = {_identity(source): source for source in _inputs(args)}
    folders = [source for source in inputs.values() if os.path.isdir(source)]
    # "new/../a.png" is no file before the folder "new" is made, and then it is "a.png".
    real = {path: Path(os.path.realpath(path)) for path in files}
    existing = [path for path in files if real[path].exists()]
    for path in existing:
        if source := inputs.get(_identity(real[path])):
            raise UsageError(f"{path} would be written over the input {source}: choose another name or folder.")
        for folder in folders:
            if str(real[path]).startswith(os.path.realpath(folder) + os.sep):
                raise UsageError(f"{path} exists in the folder {folder}, which is read: choose another name or folder.")
        check_file(real[path])
    known = {folder: _manifest(folder) for folder in {real[path].parent for path in existing}}
    unchanged = {path: known[at.parent].get(at.name) == checksum(at) for path, at in real.items() if path in existing}
    kept = [path for path in existing if not args.overwrite and not unchanged[path]]
    if kept:
        names = ", ".join(map(str, kept[:3])) + (f" and {len(kept) - 3} more" if len(kept) > 3 else "")
        verb, them, others = ("exist", "them", "other names") if len(kept) > 1 else ("exists", "it", "another name")
        raise FileExistsError(f"{names} {verb}: give --overwrite to replace {them}, or choose {others}{hint}.")


def note_output(path: Path) -> None:
    """Add a file to the manifest of its folder, so that a later run may replace it as long as it is unchanged."""
    with (path.parent / MANIFEST).open("a", encoding="utf-8") as manifest:
        manifest.write(f"{checksum(path)}  {path.name}\n")


def _manifest(folder: Path) -> dict[str, str]:
    """Return the checksum of each file in the manifest of a folder; later lines replace earlier ones."""
    try:
        lines = (folder / MANIFEST).read_text(encoding="utf-8").split("\n")
    except (OSError, ValueError):  # missing or damaged: the files may be anyone's
        return {}
    return {name: digest for digest, _, name in (line.partition("  ") for line in lines)}


def _inputs(args: Any) -> Iterator[str]:
    """Yield the files and folders that the arguments name, without outputs."""
    for name, option in options_of(type(args)).items():
        value = getattr(args, name)
        for each in value if isinstance(value, tuple) else (value,):
            if option.group != "output" and isinstance(each, (str, Path)) and os.path.exists(each):
                yield str(each)


def _key(path: Path) -> str:
    """Return a text that is equal for two names of one file that may not exist yet."""
    key = os.path.realpath(path)
    return unicodedata.normalize("NFC", key).casefold() if sys.platform in ("win32", "darwin") else key


def _identity(path: str | Path) -> tuple[int, int]:
    """Return what all names of a file have in common, also those of links."""
    found = os.stat(path)
    return found.st_dev, found.st_ino
