"""Damage values and bytes at random, as a broken disk, another program or an attacker may leave them in a file.

What becomes of damaged files is counted: refused with a declared error, read, or neither.
"""

from __future__ import annotations

import copy
import logging
import warnings
from collections import Counter
from collections.abc import Callable
from typing import Any, Final, Literal

import numpy as np

Outcome = Literal["refused", "read", "undeclared", "wrong"]

_LOG: Final = logging.getLogger(__name__)
#: Values that a document may hold instead of the right one.
_HOSTILE: Final[tuple[Any, ...]] = (
    None, True, False, 0, -1, 1, 2**31, 2**63, -(2**70), 10**400, 0.5, 1e-320, 1e308, float("inf"), float("-inf"),
    float("nan"), "", "x", "-", "\0", "\ud7ff", "../x", "/", "1e5", "x" * 5000, [], {}, [[]], [None], {"": None},
    ["a", "b"], [0, 0, 0], [1e9] * 40, [[1, 2], [3]], {"kind": []}, {"kind": "x"}, {"a": {"b": {"c": []}}},
)  # fmt: skip
_DEEP: Final = 70
#: Pieces of text that parsers of JSON or YAML stumble over.
_PIECES: Final = (
    b"[", b"]", b"{", b"}", b":", b"\"", b"'", b"\t", b"\n", b"\0", b"\xff", b"\xef\xbb\xbf", b"- ", b"? ", b"&a ",
    b"*a", b"&a [*a, *a]", b"<<: *a", b"!!int ''", b"!!float x", b"!!timestamp x", b"!!bool x", b"!!binary \xc3\xa9",
    b"!!set x", b"!!omap [1]", b"!!pairs [1]", b"!!python/object:os.system x", b"2020-13-45", b"2020-01-01T99:99:99Z",
    b"1:99:99", b"0o9", b"0x", b"9" * 5000, b"1e999", b".nan", b"NaN", b"-Infinity", b"[" * 3000, b'{"a":' * 3000,
    b"- " * 500, b"\\ud800", b"\\u", b"%YAML 9.9\n", b"---\n", b"...\n", b"|", b">", b"#", b"\x85", b"\xe2\x80\xa8",
)  # fmt: skip


def mutate(value: Any, draw: np.random.Generator) -> Any:
    """Return a copy of a JSON-able value in which one to three places, drawn at random, hold something else."""
    changed = [copy.deepcopy(value)]
    for _ in range(draw.integers(1, 4)):
        places = _places(changed)
        holder, key = places[draw.integers(len(places))]
        action = draw.integers(6)
        if action == 0 and holder is not changed:
            del holder[key]
        elif action == 1 and isinstance(holder, dict):
            holder[str(key) + "_"] = holder.pop(key)
        elif action == 2:
            other, at = places[draw.integers(len(places))]
            holder[key] = copy.deepcopy(other[at])
        elif action == 3:
            holder[key] = _nested(holder[key], int(draw.integers(1, _DEEP)))
        else:
            holder[key] = copy.deepcopy(_HOSTILE[draw.integers(len(_HOSTILE))])
    return changed[0]


def mutate_bytes(data: bytes, draw: np.random.Generator) -> bytes:
    """Return bytes with some of them changed, cut off or repeated, or with a piece of hostile text inserted."""
    at, action = int(draw.integers(len(data) + 1)), draw.integers(5)
    length = int(draw.integers(1, 40))
    if action == 0:
        return flip(data, int(draw.integers(8 * len(data)))) if data else data
    if action == 1:
        return data[:at]
    if action == 2:
        return data[:at] + data[at + length :]
    if action == 3:
        return data[:at] + data[at : at + length] * 2 + data[at + length :]
    return data[:at] + _PIECES[draw.integers(len(_PIECES))] + data[at + (length if draw.integers(2) else 0) :]


def flip(data: bytes, bit: int) -> bytes:
    """Return bytes with one bit flipped."""
    changed = bytearray(data)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def _places(value: Any) -> list[tuple[Any, Any]]:
    """Return all places of a nested value: the list or mapping that holds it, and its index or key."""
    found = []
    for key in list(value) if isinstance(value, dict) else range(len(value)):
        found.append((value, key))
        if isinstance(value[key], (dict, list)):
            found += _places(value[key])
    return found


def _nested(value: Any, levels: int) -> Any:
    for _ in range(levels):
        value = [value]
    return value


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
