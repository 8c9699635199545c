"""Read what users write, JSON, YAML and ``module:Name``, with one declared error and helpful messages.

Files come from other people and other programs. On damaged or hostile text Python's parsers also raise errors that
are not their own: ``RecursionError`` for deep nesting, ``KeyError`` for a YAML tag, ``ValueError`` for a date that does
not exist. YAML can repeat a part with an alias (``*name``): a few lines can stand for billions of values, or for a
value that contains itself. Depth and number of values are therefore bounded here.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, Final

from shape_obs.utils.errors import SpecError, did_you_mean, hint_at_argument

#: Largest nesting of lists and mappings; the files of this package have at most a dozen levels.
DEEPEST: Final = 64
#: Largest number of values in a YAML document, with aliases written out.
MOST_VALUES: Final = 200_000
#: Largest YAML document in bytes: PyYAML reads about 100 kB a second.
LONGEST_YAML: Final = 8 << 20


def read_json(path: str | os.PathLike[str], what: str) -> Any:
    """Read a JSON file.

    Args:
        path: The file, encoded in UTF-8.
        what: The kind of file, for error messages, such as ``"extrinsics"``.

    Raises:
        FileNotFoundError: There is no such file.
        OSError: The file cannot be read.
        SpecError: The file is not JSON, or is nested too deeply.
    """
    return parse_json(_read(path, what), str(path))


def read_yaml(path: str | os.PathLike[str], what: str) -> Any:
    """Read a YAML file.

    Args:
        path: The file, encoded in UTF-8.
        what: The kind of file, for error messages, such as ``"config"``.

    Raises:
        FileNotFoundError: There is no such file.
        OSError: The file cannot be read.
        SpecError: The text is not YAML, too long, nested too deeply, or its aliases stand for too many values.
    """
    return parse_yaml(_read(path, what), str(path))


def parse_json(text: str | bytes, where: str) -> Any:
    """Parse a JSON text.

    Args:
        text: The text; bytes are UTF-8.
        where: The start of error messages: the name of the file, or name and line.

    Raises:
        SpecError: The file is not JSON, has an object with the same name twice, or is nested too deeply.
    """
    try:
        value = json.loads(_decoded(text), object_pairs_hook=_unique)
    except RecursionError as error:
        raise SpecError(f"{where}: {_too_deep()}") from error
    except ValueError as error:
        raise SpecError(f"{where}: not valid JSON: {error}") from error
    _check_bounds(value, where, None)
    return value


def parse_yaml(text: str | bytes, where: str, loader: Any = None) -> Any:
    """Parse a YAML text.

    Args:
        text: The text; bytes are UTF-8.
        where: The start of error messages: the name of the file, or a command-line option.
        loader: A stricter subclass of ``shape_obs.utils.yaml_text.Loader``, which is the default.

    Raises:
        SpecError: The text is not YAML, gives a name twice, is too long or nested too deeply, or its aliases stand for
            too many values.
    """
    import yaml  # takes 20 ms, which commands without a YAML file save

    from shape_obs.utils.yaml_text import Loader

    # What ``yaml.safe_load`` raises besides ``YAMLError``: constructors of tags such as ``!!int`` and ``!!timestamp``.
    yaml_errors = (
        yaml.YAMLError, ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError, RecursionError,
    )  # fmt: skip
    if len(text) > LONGEST_YAML:
        raise SpecError(f"{where}: expected at most {LONGEST_YAML} bytes of YAML, got {len(text)}.")
    try:
        value = yaml.load(_decoded(text), Loader=loader or Loader)
    except RecursionError as error:
        raise SpecError(f"{where}: {_too_deep()}") from error
    except yaml_errors as error:
        reason = str(error) if isinstance(error, (yaml.YAMLError, ValueError)) else repr(error)
        hint = ". Indent with spaces, not with tabs." if "'\\t'" in reason else ""
        raise SpecError(f"{where}: not valid YAML: {reason}{hint}") from error
    _check_bounds(value, where, MOST_VALUES)
    return value


def dump_yaml(value: Any) -> str:
    """Return a value of plain types as YAML, in the order of its names."""
    import yaml

    from shape_obs.utils.yaml_text import Dumper

    return yaml.dump(value, Dumper=Dumper, sort_keys=False)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"the name {next(name for name in names if names.count(name) > 1)!r} is given twice")
    return values


def _read(path: str | os.PathLike[str], what: str) -> bytes:
    try:
        return Path(path).read_bytes()
    except FileNotFoundError as error:
        raise FileNotFoundError(f"{path}: no such {what} file") from error
    except IsADirectoryError as error:
        raise SpecError(f"{path}: expected a {what} file, got a folder.") from error


def _decoded(text: str | bytes) -> str:
    # ``-sig``: editors on Windows start UTF-8 files with a byte order mark.
    return text if isinstance(text, str) else text.decode("utf-8-sig")


def _check_bounds(value: Any, where: str, most: int | None) -> None:
    """Reject values that are nested too deeply or, if ``most`` is given, too many values. Works without recursion."""
    count, level = 0, [value]
    for _ in range(DEEPEST + 1):
        inner: list[Any] = []
        for item in level:
            inside = _inside(item)
            if most is not None:
                # Count before the next level is built: an alias can stand for billions of values.
                count += len(inside)
                if count > most:
                    raise SpecError(
                        f"{where}: it holds more than {most} values: write out the parts that its aliases repeat."
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
    """Return the keys that contain values themselves, as tuples do in YAML."""
    return [key for key in keys if isinstance(key, tuple)]


def _too_deep() -> str:
    return f"it is nested too deeply; expected at most {DEEPEST} levels of lists and mappings."


def load_named(text: str, what: str) -> Any:
    """Return the object that ``module:Name`` refers to.

    Args:
        text: The name, such as ``"my_lab.arm:Arm"``; the module is found as by ``import``.
        what: The setting that holds the name, for error messages, such as ``"--robot"``.

    Raises:
        ValueError: The text does not have this form, or the module has no such name.
        ImportError: There is no such module, or importing it fails.
    """
    module_name, _, name = text.partition(":")
    if not module_name or not name:
        raise ValueError(f"{what}: expected module:Name, such as my_lab.arm:Arm, got {text!r}.")
    try:
        module = import_module(module_name)
    except ImportError as error:
        file = Path(*module_name.split(".")).with_suffix(".py")
        here = f" {file} is in this folder: set PYTHONPATH=. to have modules found there." if file.exists() else ""
        raise ImportError(f"{what}: cannot import {module_name!r}: {error}.{here}") from error
    try:
        return getattr(module, name)
    except AttributeError:
        names = [known for known in dir(module) if not known.startswith("_")]
        raise ValueError(f"{what}: module {module_name!r} has no {name!r}{did_you_mean(name, names)}") from None


def make_named(text: str, what: str, arguments: Mapping[str, Any] | None = None) -> Any:
    """Call the class or function that ``module:Name`` refers to, with keyword arguments.

    Raises:
        ValueError: The object cannot be called, does not take these arguments, or fails without saying more.
    """
    maker = load_named(text, what)
    if not callable(maker):
        raise ValueError(f"{what}: {text} is a {type(maker).__name__}, expected a class or a function.")
    try:
        return maker(**(arguments or {}))
    except TypeError as error:
        hint = hint_at_argument(error, maker)
        raise ValueError(f"{what}: {text} does not take {dict(arguments or {})}: {error}{hint}") from error
    except (ValueError, OSError, ImportError):
        raise
    except Exception as error:
        raise ValueError(f"{what}: {text} cannot be made: {type(error).__name__}: {error}") from error


def is_of_script(path: str) -> bool:
    """Return whether ``module:Name`` is in the script or notebook that runs, where no other program finds it."""
    return path.startswith("__main__:")
