"""Count what becomes of damaged files: refused with a declared error, read, or neither."""

from __future__ import annotations

import logging
import os
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, Literal

Outcome = Literal["refused", "read", "undeclared", "wrong"]

_LOG: Final = logging.getLogger(__name__)


class Outcomes:
    """Counts outcomes; every one that must not be is logged as a warning.

    Args:
        declared: The errors that may come out.
    """

    def __init__(self, *declared: type[Exception]) -> None:
        self.counts: Counter[Outcome] = Counter()
        self._declared = declared

    def try_out(self, name: str, read: Callable[[], Any], right: Callable[[Any], bool] = lambda value: True) -> None:
        """Read something and count what comes out.

        Args:
            name: For the log.
            read: Reads it.
            right: Whether what was read is what was written.
        """
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)
                value = read()
        except self._declared:
            self.counts["refused"] += 1
        except Exception as error:  # noqa: BLE001 - undeclared exceptions are what is looked for
            self.counts["undeclared"] += 1
            _LOG.warning("%s: undeclared %r", name, error, exc_info=True)
        else:
            good = right(value)
            self.counts["read" if good else "wrong"] += 1
            if not good:
                _LOG.warning("%s: read as something else", name)


class _Watch:
    """The files that this process opened in a folder, by an audit hook of the interpreter; hooks cannot be removed."""

    def __init__(self) -> None:
        self.folder = ""
        self.opened: list[str] = []
        self._hooked = False

    def begin(self, folder: Path) -> None:
        if not self._hooked:
            sys.addaudithook(self._hook)
            self._hooked = True
        self.folder, self.opened = os.path.realpath(folder), []

    def _hook(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.folder or event != "open" or not isinstance(arguments[0], (str, os.PathLike)):
            return
        path = os.fspath(arguments[0])
        if isinstance(path, str) and "\0" not in path:
            found = os.path.realpath(path)
            if found.startswith(self.folder + os.sep):
                self.opened.append(found)


_WATCH: Final = _Watch()


@contextmanager
def opened_in(folder: Path) -> Iterator[list[str]]:
    """Record which files in a folder this process opens, under any path."""
    _WATCH.begin(folder)
    try:
        yield _WATCH.opened
    finally:
        _WATCH.folder = ""
