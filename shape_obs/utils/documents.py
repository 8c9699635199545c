"""Read JSON and YAML: whatever a file holds, the result is plain values or one declared error.

Files come from other people and other programs. On damaged or hostile text Python's parsers also raise errors that
are not their own: ``RecursionError`` when it is nested too deep, ``KeyError`` for a YAML tag, ``ValueError`` for a
date that does not exist. YAML can repeat a part with an alias (``*name``): a few lines then stand for billions of
values, or for a value that contains itself. Depth and number of values are therefore bounded here.

Classes and functions by their names: ``module:Name``.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, Final

import yaml

from shape_obs.spec import SpecError, did_you_mean

#: Levels of lists and mappings in each other; the files of this package have at most a dozen.
DEEPEST: Final = 64

#: Values in a YAML document, aliases written out.
MOST_VALUES: Final = 200_000

#: Bytes of a YAML document: PyYAML reads about 100 kB a second.
LONGEST_YAML: Final = 8 << 20


# What ``yaml.safe_load`` raises besides ``YAMLError``: the constructors of tags such as ``!!int`` and ``!!timestamp``.
_YAML_ERRORS: Final = (
    yaml.YAMLError, ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError, RecursionError,
)  # fmt: skip


def read_json(path: str | os.PathLike[str], what: str) -> Any:
    """Read a JSON file.

    Args:
        path: The file, encoded in UTF-8.
        what: Kind of file, for messages: ``"extrinsics"``.

    Raises:
        FileNotFoundError: There is no such file.
        OSError: The file cannot be read.
        SpecError: It is not JSON, or nested too deep.
    """
    return parse_json(_read(path, what), str(path))


def read_yaml(path: str | os.PathLike[str], what: str) -> Any:
    """Read a YAML file.

    Args:
        path: The file, encoded in UTF-8.
        what: Kind of file, for messages: ``"config"``.

    Raises:
        FileNotFoundError: There is no such file.
        OSError: The file cannot be read.
        SpecError: It is not YAML, too long, nested too deep, or its aliases stand for too many values.
    """
    return parse_yaml(_read(path, what), str(path))


def parse_json(text: str | bytes, where: str) -> Any:
    """Parse a JSON text.

    Args:
        text: The text; bytes are UTF-8.
        where: Begins messages: the file's name, or name and line.

    Raises:
        SpecError: It is not JSON, or nested too deep.
    """
    try:
        value = json.loads(_decoded(text))
    except RecursionError as error:
        raise SpecError(f"{where}: {_too_deep()}") from error
    except ValueError as error:
        raise SpecError(f"{where}: not valid JSON: {error}") from error
    _check_bounds(value, where, None)
    return value


def parse_yaml(text: str | bytes, where: str) -> Any:
    """Parse a YAML text.

    Args:
        text: The text; bytes are UTF-8.
        where: Begins messages: the file's name, or the option of a command.

    Raises:
        SpecError: It is not YAML, too long, nested too deep, or its aliases stand for too many values.
    """
    if len(text) > LONGEST_YAML:
        raise SpecError(f"{where}: expected at most {LONGEST_YAML} bytes of YAML, got {len(text)}.")
    try:
        value = yaml.safe_load(_decoded(text))
    except RecursionError as error:
        raise SpecError(f"{where}: {_too_deep()}") from error
    except _YAML_ERRORS as error:
        reason = str(error) if isinstance(error, (yaml.YAMLError, ValueError)) else repr(error)
        raise SpecError(f"{where}: not valid YAML: {reason}") from error
    _check_bounds(value, where, MOST_VALUES)
    return value


def _read(path: str | os.PathLike[str], what: str) -> bytes:
    try:
        return Path(path).read_bytes()
    except FileNotFoundError as error:
        raise FileNotFoundError(f"{path}: no such {what} file") from error
    except IsADirectoryError as error:
        raise SpecError(f"{path}: expected a {what} file, got a folder.") from error


def _decoded(text: str | bytes) -> str:
    # ``-sig``: editors of Windows begin UTF-8 with a byte order mark.
    return text if isinstance(text, str) else text.decode("utf-8-sig")


def _check_bounds(value: Any, where: str, most: int | None) -> None:
    """Refuse what is nested too deep, or too many values where ``most`` is given; without recursion."""
    count, level = 0, [value]
    for _ in range(DEEPEST + 1):
        inner: list[Any] = []
        for item in level:
            inside = _inside(item)
            if most is not None:
                # Before the next level is made: an alias can stand for billions of values.
                count += len(inside)
                if count > most:
                    raise SpecError(
                        f"{where}: it stands for more than {most} values: write out what its aliases repeat."
                    )
            inner.extend(inside)
        if not inner:
            return
        level = inner
    raise SpecError(f"{where}: {_too_deep()}")


def _inside(item: Any) -> list[Any]:
    if isinstance(item, Mapping):
        return [*_containers(item), *item.values()]
    return list(item) if isinstance(item, (list, tuple, set)) else []


def _containers(keys: Iterable[Any]) -> list[Any]:
    """Keys that contain values themselves, as tuples do in YAML."""
    return [key for key in keys if isinstance(key, tuple)]


def _too_deep() -> str:
    return f"it is nested too deep; expected at most {DEEPEST} levels of lists and mappings."


def load_named(text: str, what: str) -> Any:
    """What ``module:Name`` names.

    Args:
        text: Such as ``"my_lab.arm:Arm"``; the module is looked for as ``import`` does.
        what: What it is for, for messages: ``"--robot"``.

    Raises:
        ValueError: Not of this form, or the module has no such name.
        ImportError: There is no such module, or importing it fails.
    """
    module_name, _, name = text.partition(":")
    if not module_name or not name:
        raise ValueError(f"{what}: expected module:Name, such as my_lab.arm:Arm, got {text!r}.")
    try:
        module = import_module(module_name)
    except ImportError as error:
        raise ImportError(f"{what}: cannot import {module_name!r}: {error}") from error
    try:
        return getattr(module, name)
    except AttributeError:
        names = [known for known in dir(module) if not known.startswith("_")]
        raise ValueError(f"{what}: module {module_name!r} has no {name!r}{did_you_mean(name, names)}") from None


def make_named(text: str, what: str, arguments: Mapping[str, Any] | None = None) -> Any:
    """Call what ``module:Name`` names with keyword arguments.

    Raises:
        ValueError: It cannot be called so.
    """
    maker = load_named(text, what)
    if not callable(maker):
        raise ValueError(f"{what}: {text} is a {type(maker).__name__}, expected a class or a function.")
    try:
        return maker(**(arguments or {}))
    except TypeError as error:
        raise ValueError(f"{what}: {text} does not take {dict(arguments or {})}: {error}") from error
