"""The decorator of compiled functions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, TypeVar, overload

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])

# Sums may be taken in any order, so that they run four abreast: the last digits of 16 differ.
_REASSOCIATE: Final = {"reassoc", "contract", "nsz"}


@overload
def compiled(function: F, /) -> F: ...
@overload
def compiled(*, reassociate: bool = False, inline: bool = False) -> Callable[[F], F]: ...
def compiled(function: Any = None, /, *, reassociate: bool = False, inline: bool = False) -> Any:
    """Compile a function with Numba when it is first needed, and keep the machine code on disk."""

    def decorate(plain: Any) -> Any:
        fast = _REASSOCIATE if reassociate else False
        return njit(cache=True, nogil=True, fastmath=fast, inline="always" if inline else "never")(plain)

    return decorate if function is None else decorate(function)
