"""A small fault in the source code."""

from __future__ import annotations

from typing import NamedTuple


class Mutant(NamedTuple):
    """A fault as an exact replacement of text.

    Args:
        name: The part of the package, then what is broken.
        file: From the repository's root.
        old: Occurs exactly once in the file.
        new: What stands there instead.
        tests: Fast test files that must notice, those that notice first.
        equivalent: Why no test can notice, for a mutant that behaves as the original does; else empty.
    """

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]
    equivalent: str = ""
