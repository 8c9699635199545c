"""Count what becomes of damaged files: refused with a declared error, read, or neither."""

from __future__ import annotations

import logging
import warnings
from collections import Counter
from collections.abc import Callable
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
