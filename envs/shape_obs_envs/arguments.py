"""Checks of constructor arguments, with errors that say what to write instead."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any


def one_of(name: str, value: Any, options: Iterable[Any], also: str = "") -> Any:
    """Return `value` if it is one of `options`; `also` words what else the argument takes.

    Raises:
        ValueError: It is not; names the options and, for a misspelt string, the likely one.
    """
    options = list(options)
    if isinstance(value, (str, type(None))) and value in options:
        return value
    words = [option for option in options if isinstance(option, str)]
    close = difflib.get_close_matches(value.lower(), words, 1) if isinstance(value, str) else []
    hint = f" Did you mean {close[0]!r}?" if close else ""
    expected = ", ".join(map(repr, options)) + (f" or {also}" if also else "")
    raise ValueError(f"{name}: expected one of {expected}, got {value!r}.{hint}")
