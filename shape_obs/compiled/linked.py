"""Compile helpers to code that is linked into their callers, which optimize it together with their own.

Numba optimizes each function together with all that it calls and makes machine code of both: of a function that is
called by a second one, which a third one calls, three times. Here it does so for the outermost one alone, which takes
about 40 % less time.
"""

from __future__ import annotations

from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler


class LinkedLibrary(JITCodeLibrary):
    """The code of a helper as it was generated, of which no machine code is made."""

    def _optimize_final_module(self) -> None:
        """Leave it to the callers."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Return 0: there is no machine code."""
        self._ensure_finalized()
        return 0

    @property
    def codegen(self) -> Any:
        """The library itself, which takes the environment."""
        return self

    def set_env(self, env_name: str, env: Any) -> None:
        """Ignore the environment, which machine code would need if it had Python objects as constants.

        Raises:
            TypeError: It has some.
        """
        if env.consts:
            raise TypeError(f"{env_name}: a helper may use no Python objects as constants, got {env.consts}.")


class LinkedCompiler(Compiler):
    """Compile a function into a ``LinkedLibrary``."""

    def __init__(self, typingctx: Any, targetctx: Any, library: Any, *rest: Any) -> None:
        library = LinkedLibrary(targetctx.codegen(), "helper") if library is None else library
        super().__init__(typingctx, targetctx, library, *rest)
