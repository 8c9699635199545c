"""A figure that was asked for beside the one that was seen."""

from __future__ import annotations

from typing import Any


def at_least(what: str, asked: float, seen: float | None, unit: str = "x") -> dict[str, Any]:
    """A row for a figure that must not be smaller; ``seen`` is None where it was not measured."""
    return _row(what, f">= {asked:g}{unit}", seen, seen is not None and seen >= asked)


def at_most(what: str, asked: float, seen: float | None, unit: str = "x") -> dict[str, Any]:
    """A row for a figure that must not be larger; ``seen`` is None where it was not measured."""
    return _row(what, f"<= {asked:g}{unit}", seen, seen is not None and seen <= asked)


def _row(what: str, asked: str, seen: float | None, reached: bool) -> dict[str, Any]:
    return {
        "what": what,
        "asked": asked,
        "seen": None if seen is None else float(seen),
        "reached": "not measured" if seen is None else "yes" if reached else "no",
    }
