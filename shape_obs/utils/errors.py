"""The errors about what users write, and hints at what they may have meant or must install."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

#: Extras of the libraries whose absence is not reported where they are imported.
_EXTRAS: Final[Mapping[str, str]] = {"stable_baselines3": "sb3", "torch": "sb3", "safetensors": "sb3"}


class SpecError(ValueError):
    """A configuration that cannot be understood; the message names the place, the value and what was expected."""

    __module__ = "shape_obs.spec"  # its public path, which tracebacks show


class UsageError(ValueError):
    """A command line that is wrong: an argument is missing, unknown or out of range. ``shape-obs`` exits with 2."""


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


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return the end of an error message about an unknown name: ``"; did you mean 'x'? Known: ..."``."""
    import difflib  # only errors need it

    names = list(known)
    if not names:
        return "; there are none."
    near = difflib.get_close_matches(str(name), names, n=1, cutoff=0.5)
    hint = f"; did you mean {near[0]!r}?" if near else "."
    return f"{hint} Known: {', '.join(names)}."
