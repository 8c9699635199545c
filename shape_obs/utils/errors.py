"""The errors about what users write, and hints at what they may have meant or must install."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Final

#: Extras of the libraries whose absence is not reported where they are imported.
_EXTRAS: Final[Mapping[str, str]] = {
    "stable_baselines3": "sb3",
    "torch": "sb3",
    "onnxscript": "sb3",
    "onnx": "deploy",
    "onnxruntime": "deploy",
}


class SpecError(ValueError):
    """A configuration that cannot be understood; the message names the place, the value and what was expected."""

    __module__ = "shape_obs.spec"  # its public path, which tracebacks show


class UsageError(ValueError):
    """A command line that is wrong: an argument is missing, unknown or out of range. ``shape-obs`` exits with 2."""


class Interrupted(KeyboardInterrupt):
    """A signal asked the process to end.

    Args:
        signum: Number of the signal.

    Attributes:
        signum: As given.
        report: Report of the run that was ended; None if there is none.
    """

    __module__ = "shape_obs.deploy"  # its public path, which tracebacks show
    signum: int
    report: Any

    def __init__(self, signum: int) -> None:
        super().__init__(f"interrupted by {signal.Signals(signum).name}")
        self.signum = signum
        self.report = None


def add_later(first: BaseException, later: BaseException) -> None:
    """Add the messages of a later error to the first one, as notes; Python 3.10 has no ``add_note``."""
    for message in _messages(later):
        if message not in _messages(first):
            vars(first).setdefault("__notes__", []).append(message)


def run_last(error: BaseException | None, *steps: Callable[[], object]) -> None:
    """Run the last steps of a block, each even if another one fails, and raise the first error.

    The messages of later errors are added to it as notes, which ``message_of`` returns too.

    Args:
        error: The error that ended the block, which the caller raises; None if there was none.
        steps: What remains to be done.
    """
    first = error
    for step in steps:
        try:
            step()
        except BaseException as later:  # noqa: BLE001, PERF203 - also after Ctrl-C the next steps are needed
            if first is None:
                first = later
            else:
                add_later(first, later)
    if first is not None and error is None:
        raise first


@contextmanager
def ending(*steps: Callable[[], object]) -> Iterator[None]:
    """Run a block and then ``steps``, all of them, and raise the first error; see ``run_last``."""
    error: BaseException | None = None
    try:
        yield
    except BaseException as raised:
        error = raised
        raise
    finally:
        run_last(error, *steps)


def message_of(error: BaseException) -> str:
    """Return the message of an error and of those that followed it, in one line."""
    return " ".join("; then: ".join(_messages(error)).split())


def _messages(error: BaseException) -> list[str]:
    return [str(error) or type(error).__name__, *getattr(error, "__notes__", ())]


def install_hint(extra: str) -> str:
    """Return the end of an error message about a library that is not installed; the package is not on PyPI.

    Args:
        extra: The extra that installs the library, such as ``"rerun"``.
    """
    return f'in a clone of shape_obs, run pip install ".[{extra}]"'


def hint_at_extra(error: Exception) -> str:
    """Return how to install the module that an import did not find, as the end of its message; empty if unknown."""
    extra = _EXTRAS.get((error.name or "").partition(".")[0]) if isinstance(error, ModuleNotFoundError) else None
    return f": {install_hint(extra)}" if extra else ""


def hint_at_argument(error: BaseException, *makers: Any) -> str:
    """Return the arguments that classes or functions take, as the end of an error about an unknown one; else empty.

    Args:
        error: What calling one of them raised.
        makers: The classes, with their base classes, and functions.
    """
    import inspect  # only errors need it
    import re

    unknown = re.search(r"unexpected keyword argument '(\w+)'", str(error))
    if not unknown:
        return ""
    calls = [each for maker in makers for each in (maker.__mro__[:-1] if isinstance(maker, type) else [maker])]
    calls = [vars(each).get("__init__") if isinstance(each, type) else each for each in calls]
    taken = [one for each in calls if callable(each) for one in inspect.signature(each).parameters.values()]
    names = [one.name for one in taken if one.kind in (one.POSITIONAL_OR_KEYWORD, one.KEYWORD_ONLY)]
    return did_you_mean(unknown[1], [name for name in dict.fromkeys(names) if name != "self"])


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return the end of an error message about an unknown name: ``"; did you mean 'x'? Known: ..."``."""
    import difflib  # only errors need it

    names = list(known)
    if not names:
        return "; there are none."
    near = difflib.get_close_matches(str(name), names, n=1, cutoff=0.5)
    hint = f"; did you mean {near[0]!r}?" if near else "."
    return f"{hint} Known: {', '.join(names)}."
