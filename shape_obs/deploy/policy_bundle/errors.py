"""Errors of bundles, and what a damaged or hostile value raises in the libraries that are given it."""

from __future__ import annotations

from typing import Final

import cv2

#: What Python, NumPy, OpenCV, PyTorch and Gymnasium raise for values that they cannot use.
MALFORMED: Final = (
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    AttributeError,
    AssertionError,
    ArithmeticError,
    RuntimeError,
    cv2.error,
)
_ADVICE: Final = "Load it with trust=True (--trust on the command line) only if you trust who made the file."


class BundleError(ValueError):
    """A bundle that cannot be read or does not fit; the message says what was expected, what came and what to do."""


def needs_trust(what: str) -> BundleError:
    """Return the error for something that is not read without ``trust=True``: it names code, or has no known bound."""
    return BundleError(f"{what}. {_ADVICE}")
