"""Read the arguments of a command: groups and metavars in its ``--help``, ranges of values, wrong usage.

A command describes its arguments in a frozen dataclass, with an :class:`Option` in the annotation of each field and the
help text as a docstring below it. tyro reads the command line.
"""

from __future__ import annotations

import ast
import inspect
import re
import shutil
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, Field, dataclass, field, fields, make_dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar, get_args, get_origin, get_type_hints

import docstring_parser
import tyro

from shape_obs.utils.errors import UsageError, did_you_mean

T = TypeVar("T")
_OPTION: Final = re.compile(r"--(?!tyro-)[a-z][a-z0-9-]*")
_NO_DEFAULT: Final = ("", "None", "False")  # what tyro would print as "(default: None)"


@dataclass(frozen=True)
class Option:
    """How a command shows an argument in its ``--help``, and which values it accepts.

    Args:
        metavar: What stands for the value, such as ``"FILE"``; by default its type. Flags and choices need none.
        group: The box of ``--help`` that lists the option: ``"output"`` gives "output options".
        short: A second name, such as ``"-o"``.
        least: Smallest value; each value of a tuple is compared.
        most: Largest value.
        above: The value must be larger than this.
        existing: What the file is called by the error that reports that there is none, such as ``"config file"``.
            Empty: the file need not exist.
        positional: Whether the value is given without the name of the option.
        check: Called with the value and the name of the option; raises an error if the value is not well-formed.
    """

    metavar: str | None = None
    group: str = ""
    short: str = ""
    least: float | None = None
    most: float | None = None
    above: float | None = None
    existing: str = ""
    positional: bool = False
    check: Callable[[Any, str], object] | None = None

    def check_value(self, name: str, value: Any) -> None:
        """Check a value that the user gave.

        Args:
            name: The option as the user types it, such as ``"--frames"``.
            value: Its value; None and values without limits pass.

        Raises:
            UsageError: It is out of range.
        """
        if self.check is not None and value is not None:
            self.check(value, name)
        for each in value if isinstance(value, tuple) else (value,):
            if each is None:
                continue
            if isinstance(each, (int, float)) and not self._holds(each):
                raise UsageError(f"{name}: expected {self._range()}, got {each}.")

    def check_file(self, path: Path | None) -> None:
        """Raise FileNotFoundError if the file must exist and does not."""
        if self.existing and path is not None and not path.is_file():
            raise FileNotFoundError(f"{path}: no such {self.existing}")

    def _holds(self, value: float) -> bool:
        return (
            (self.least is None or value >= self.least)
            and (self.most is None or value <= self.most)
            and (self.above is None or value > self.above)
        )

    def _range(self) -> str:
        if self.above is not None:
            return f"a number above {self.above:g}" + ("" if self.most is None else f", at most {self.most:g}")
        if self.least is not None and self.most is not None:
            return f"{self.least:g}...{self.most:g}"
        return f"at least {self.least:g}" if self.least is not None else f"at most {self.most:g}"


def parse(arguments: type[T], argv: Sequence[str], prog: str, check: Callable[[T], object] = lambda args: None) -> T:
    """Return the arguments that ``argv`` gives, after checking them: their values, how they combine, their files.

    ``--help`` and wrong usage end the process, with exit code 0 and 2.

    Args:
        arguments: A dataclass whose fields have an :class:`Option` in their annotation.
        argv: The words after the command.
        prog: The command, such as ``"shape-obs detect"``.
        check: Raises UsageError for arguments that do not go together.

    Raises:
        UsageError: An option is unknown, a value is out of range, or a list that needs a value is empty.
        FileNotFoundError: A file that must exist does not.
    """
    options = options_of(arguments)
    _check_names(arguments, options, argv)
    parser, paths = _parser(arguments, options)
    found = tyro.cli(
        parser,
        args=list(argv),
        prog=prog,
        description=_wrapped(_docstring(arguments)),
        config=(tyro.conf.OmitArgPrefixes, tyro.conf.DisallowNone),
    )
    values = {name: getattr(getattr(found, group) if group else found, name) for name, group in paths.items()}
    for each in fields(arguments):  # pyright: ignore[reportArgumentType]
        value, option = values[each.name], options[each.name]
        if value == () and _is_required(each):  # tyro accepts an empty list of positional arguments
            raise UsageError(f"expected at least one {(option.metavar or each.name).split()[0]}.")
        option.check_value(option.metavar or each.name if option.positional else f"--{_name(each)}", value)
    args = arguments(**values)
    check(args)
    for name, option in options.items():
        option.check_file(values[name])
    return args


def _check_names(arguments: type, options: Mapping[str, Option], argv: Sequence[str]) -> None:
    """Report an unknown option by name; tyro lists its values and what follows as unknown too."""
    names = [f"--{_name(each)}" for each in fields(arguments) if not options[each.name].positional]
    also = [option.short for option in options.values()] + [f"--no-{name[2:]}" for name in names]
    for word in argv:
        name = word.partition("=")[0].replace("_", "-")
        if _OPTION.fullmatch(name) and name not in (*names, *also, "--help"):
            raise UsageError(f"unknown option {name}{did_you_mean(name, names)}")


@contextmanager
def wrong_usage() -> Iterator[None]:
    """Turn a ValueError of the library, about values that are all from the command line, into a UsageError."""
    try:
        yield
    except ValueError as error:
        raise UsageError(str(error)) from error


def options_of(arguments: type) -> dict[str, Option]:
    """Return the option of each field of a dataclass of arguments."""
    hints = get_type_hints(arguments, include_extras=True)
    return {each.name: _split(hints[each.name])[1] for each in fields(arguments)}


def _parser(arguments: type, options: Mapping[str, Option]) -> tuple[type, dict[str, str]]:
    """Return the class that tyro reads, with a nested class for each group, and the group's field for each argument."""
    hints, texts = get_type_hints(arguments, include_extras=True), _help_texts(arguments)
    titles = {title: f"group{number}" for number, title in enumerate(dict.fromkeys(o.group for o in options.values()))}
    titles[""] = ""
    members: dict[str, list[Any]] = {"": []}
    paths = {}
    for each in fields(arguments):
        option = options[each.name]
        annotation = _annotation(hints[each.name], option, each, texts.get(each.name, ""))
        default = {key: getattr(each, key) for key in ("default", "default_factory")}
        paths[each.name] = titles[option.group]
        members.setdefault(option.group, []).append((each.name, annotation, field(kw_only=True, **default)))
    root = members.pop("")
    for title, inside in members.items():
        group = make_dataclass(titles[title], inside, frozen=True)
        root.append((titles[title], Annotated[group, tyro.conf.arg(name=title, help="")], field(kw_only=True)))
    return make_dataclass(arguments.__name__, root, frozen=True), paths


def _annotation(hint: Any, option: Option, each: Field[Any], text: str) -> Any:
    """Return what tyro reads of an argument: its type, markers, metavar and help text."""
    base, _, markers = _split(hint)
    if base is bool and each.default is False:
        markers = (*markers, tyro.conf.FlagCreatePairsOff)
    if option.positional:
        markers = (*markers, tyro.conf.Positional)
    shown = tyro.conf.arg(
        name=_name(each),
        metavar=option.metavar or _choices(base),
        help=text,
        aliases=(option.short,) if option.short else None,
        help_behavior_hint=lambda default: "" if default in _NO_DEFAULT else f"(default: {default})",
    )
    for extra in (*markers, shown):
        base = Annotated[base, extra]
    return base


def _name(each: Field[Any]) -> str:
    """Return the option of a field, without dashes: ``not_`` is ``not``, which Python does not allow as a name."""
    return each.name.rstrip("_").replace("_", "-")


def _choices(base: Any) -> str | None:
    """Return the metavar of a list of choices, ``"{a,b} ..."``; None for other types."""
    if get_origin(base) is tuple and get_origin(get_args(base)[0]) is Literal:
        return f"{{{','.join(get_args(get_args(base)[0]))}}} ..."
    return None


def _split(hint: Any) -> tuple[Any, Option, tuple[Any, ...]]:
    """Return the type, the option and the further markers of an annotation."""
    if get_origin(hint) is not Annotated:
        return hint, Option(), ()
    base, *extras = get_args(hint)
    option = next((extra for extra in extras if isinstance(extra, Option)), Option())
    return base, option, tuple(extra for extra in extras if not isinstance(extra, Option))


def _docstring(cls: type) -> str:
    """Return the docstring of a class from its source, which has it with ``python -OO`` too."""
    try:
        (definition,) = ast.parse(textwrap.dedent(inspect.getsource(cls))).body
        assert isinstance(definition, ast.ClassDef)
        return ast.get_docstring(definition) or ""
    except (OSError, SyntaxError):  # there is no source
        return inspect.getdoc(cls) or ""


def _help_texts(arguments: type) -> dict[str, str]:
    """Return the docstring below each field, those of inherited fields included, each on one line."""
    texts = {}
    for cls in reversed(arguments.__mro__[:-1]):
        for found in docstring_parser.parse_from_object(cls).params:
            texts[found.arg_name] = " ".join((found.description or "").split())
    return texts


def _is_required(each: Field[Any]) -> bool:
    return each.default is MISSING and each.default_factory is MISSING


def _wrapped(description: str) -> str:
    """Return paragraphs wrapped to the terminal and indented; tyro joins lines that are not indented."""
    width = max(40, shutil.get_terminal_size().columns)
    paragraphs = (" ".join(paragraph.split()) for paragraph in description.split("\n\n"))
    return "\n".join(
        textwrap.fill(paragraph, width, initial_indent="  ", subsequent_indent="  ") for paragraph in paragraphs
    )
