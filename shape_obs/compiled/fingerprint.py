"""What a compiled function depends on: its code, its constants, and those of all functions that it calls."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterable, Iterator
from functools import lru_cache
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any, Final

import llvmlite
import numba
import numpy as np
from numba.core import config
from numba.core.dispatcher import Dispatcher
from numba.core.registry import cpu_target

_FORMAT: Final = 1  # of the files
# Settings of Numba that change what is generated.
_SETTINGS: Final = ("OPT", "BOUNDSCHECK", "DEBUGINFO_DEFAULT", "LOOP_VECTORIZE", "SLP_VECTORIZE")


def fingerprint(dispatcher: Dispatcher, signatures: Iterable[str]) -> str:
    """Return a hash of everything that the machine code of a function depends on.

    Numba's own cache looks only at the file of the function, so that it misses an edit of a function or constant in
    another file. Here comments and docstrings may change without compiling anything.
    """
    digest = hashlib.sha256(repr((_environment(), tuple(signatures))).encode())
    for part in _parts(dispatcher, set()):
        digest.update(part)
        digest.update(b"\0")
    return digest.hexdigest()[:24]


def code_size(dispatchers: Iterable[Dispatcher]) -> int:
    """Return the bytes of Python's bytecode in functions and in all that they call, each counted once."""
    seen: set[int] = set()
    return sum(len(part) for dispatcher in dispatchers for part in _parts(dispatcher, seen, constants=False))


@lru_cache
def _environment() -> tuple[Any, ...]:
    """Return the versions, the processor and the settings for which code is generated."""
    target: Any = cpu_target.target_context
    settings = tuple((name, str(getattr(config, name, None))) for name in _SETTINGS)
    versions = numba.__version__, llvmlite.__version__, np.__version__, sys.implementation.cache_tag
    return _FORMAT, versions, target.codegen().magic_tuple(), settings


def _parts(value: Any, seen: set[int], constants: bool = True) -> Iterator[bytes]:
    """Walk through a value that compiled code refers to."""
    if isinstance(value, (Dispatcher, FunctionType)):
        if id(value) in seen:
            return
        seen.add(id(value))
        function: Any = value
        if isinstance(value, Dispatcher):
            function = value.py_func
            if constants:
                yield repr(sorted((name, _plain(option)) for name, option in value.targetoptions.items())).encode()
        yield from _of_code(function.__code__, function, seen, constants)
    elif isinstance(value, np.ndarray):
        if constants:
            yield repr((value.dtype.str, value.shape)).encode() + value.tobytes()
    elif isinstance(value, (ModuleType, type, BuiltinFunctionType, np.ufunc)):
        if constants:
            yield f"{getattr(value, '__module__', '')}.{value.__name__}{_fields(value)}".encode()
    elif constants:
        yield repr(_plain(value)).encode()


def _of_code(code: CodeType, function: FunctionType, seen: set[int], constants: bool) -> Iterator[bytes]:
    yield code.co_code
    if constants:
        yield repr((code.co_names, code.co_varnames, code.co_cellvars, code.co_freevars)).encode()
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _of_code(constant, function, seen, constants)
        elif constants and constant != function.__doc__:
            yield repr(sorted(map(repr, constant)) if isinstance(constant, frozenset) else constant).encode()
    for name in code.co_names:
        if name in function.__globals__:
            value = function.__globals__[name]
            if isinstance(value, ModuleType) and value.__name__.split(".")[0] == function.__module__.split(".")[0]:
                raise TypeError(f"{function.__name__} refers to {value.__name__}: import the names that it uses.")
            yield from _parts(value, seen, constants)
    for cell in function.__closure__ or ():
        yield from _parts(cell.cell_contents, seen, constants)


def _fields(value: Any) -> str:
    """Return the fields of a named tuple and their types, in words; empty for anything else."""
    return repr(value.__annotations__) if hasattr(value, "_fields") else ""


def _plain(value: Any) -> Any:
    """Return a value whose ``repr`` is the same in every process."""
    if isinstance(value, (set, frozenset)):
        return sorted(value)
    if value is None or isinstance(value, (bool, int, float, complex, str, bytes, tuple, np.generic)):
        return value
    raise TypeError(f"A compiled function may not refer to {value!r}: use numbers, tuples, arrays and functions.")
