"""Check constructor arguments, with errors that suggest a valid value."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any

import numpy as np


def one_of(name: str, value: Any, options: Iterable[Any], also: str = "") -> Any:
    """Return ``value`` if it is one of ``options``; ``also`` describes further values in the message.

    Raises:
        ValueError: It is not; the message lists the options and suggests one for a misspelt string.
    """
    options = list(options)
    if isinstance(value, (str, bool, type(None))) and value in options:
        return value
    words = [option for option in options if isinstance(option, str)]
    close = difflib.get_close_matches(value.lower(), words, 1) if isinstance(value, str) else []
    hint = f" Did you mean {close[0]!r}?" if close else ""
    expected = ", ".join(map(repr, options)) + (f" or {also}" if also else "")
    raise ValueError(f"{name}: expected one of {expected}, got {value!r}.{hint}")


def positive(name: str, value: Any, default: str, what: str = "a distance in metres") -> float:
    """Return ``value`` as a float if it is above 0; ``default`` and ``what`` (the quantity) are for the message.

    Raises:
        ValueError: It is not a finite number above 0.
    """
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not (number and 0 < value < float("inf")):
        raise ValueError(f"{name}: expected {what} above 0, got {value!r}. The default is {default}.")
    return float(value)


def above_zero(name: str, value: Any) -> None:
    """Check that ``value`` is a number above 0, infinity included; None is the default and passes.

    Raises:
        ValueError: It is not.
    """
    if value is not None and not (isinstance(value, (int, float, np.number)) and value > 0):
        raise ValueError(f"{name}: expected more than 0, a number, got {value!r}.")


def count(name: str, value: Any, least: int, most: int | None = None) -> int:
    """Return ``value`` as an int if it is a whole number within its limits.

    Raises:
        ValueError: It is not.
    """
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if not (whole and least <= value and (most is None or value <= most)):
        limits = f"{least} or more" if most is None else f"from {least} to {most}"
        raise ValueError(f"{name}: expected a whole number, {limits}, got {value!r}")
    return int(value)
