"""Commands of several parts, such as ``bench claims``. Only the part that runs is imported."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module

from shape_obs.spec import did_you_mean


def run_part(command: str, noun: str, parts: Mapping[str, str], argv: Sequence[str]) -> int:
    """Run the part that comes first in ``argv``, or say which there are; returns the exit code.

    Args:
        command: ``"bench"``: its parts are modules of ``shape_obs.cli.bench``.
        noun: What a part is called in messages.
        parts: Name -> what it does.
        argv: The part's name and its arguments.

    Raises:
        ValueError: There is no such part.
    """
    if not argv or argv[0] in ("-h", "--help"):
        width = max(map(len, parts))
        print(f"usage: shape-obs {command} {{{','.join(parts)}}} [OPTIONS]\n")
        print("\n".join(f"  {name:<{width}} {what}" for name, what in parts.items()))
        return 0
    name, *rest = argv
    if name not in parts:
        raise ValueError(f"unknown {noun} {name!r}{did_you_mean(name, parts)}")
    return int(import_module(f"shape_obs.cli.{command}.{name}").main(rest))
