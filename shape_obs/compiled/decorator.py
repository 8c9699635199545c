"""The decorator of compiled functions, and their preparation before the first frame."""

from __future__ import annotations

import gc
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any, Final, TypeVar, overload

import numpy as np
from numba.core import config, types
from numba.core.registry import CPUDispatcher
from numba.np.numpy_support import from_dtype

from shape_obs.compiled.cache import DiskCache, cache_folder, code_size, fingerprint
from shape_obs.compiled.linked import LinkedCompiler

F = TypeVar("F", bound=Callable[..., Any])

_OPTIONS: Final[dict[str, Any]] = {"nopython": True, "nogil": True, "no_cfunc_wrapper": True}
# Sums may be taken in any order, so that several terms are added at once: the last of 16 digits differ.
_REASSOCIATE: Final = {"reassoc", "contract", "nsz"}
_NUMBERS: Final = {"float": types.float64, "int": types.int64, "bool": types.boolean}
# Compile time is proportional to the code of a function and of all that it calls, roughly.
_SECONDS_PER_BYTE: Final = 0.3e-3
_WORTH_SAYING: Final = 2.0  # seconds
_PATIENCE: Final = 300.0  # seconds to wait for another process, which may hang
_preparing = threading.RLock()


class _Dispatcher(CPUDispatcher):
    """A compiled function. It is pickled by name, so that another process loads the machine code from disk."""

    def __reduce__(self) -> Any:
        return self.py_func.__qualname__


class _EntryPoint(_Dispatcher):
    """A compiled function before its first use, which loads or compiles it and makes it a plain ``_Dispatcher``.

    The change of class leaves nothing of Python between a caller and the machine code in later calls.
    """

    signatures_declared: tuple[str, ...]

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        compile_now([self])
        return self(*args, **kwargs)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Return the type of a call by another compiled function, which needs this one compiled first."""
        _prepare(self)
        return self.get_call_template(args, kws)


class _Helper(_Dispatcher):
    """A function that compiled functions call: compiled with them for the types that they pass, without a wrapper."""

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        raise TypeError(
            f"{self.py_func.__name__} was compiled to be called by compiled functions: give it a signature to call "
            f"it from Python, or call {self.py_func.__name__}.py_func, which is not compiled."
        )

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Return the type of a call; literal numbers are passed as numbers, or each would be compiled separately."""
        return super().get_call_template(
            tuple(types.unliteral(arg) for arg in args), {name: types.unliteral(arg) for name, arg in kws.items()}
        )


@overload
def compiled(function: F, /) -> F: ...
@overload
def compiled(
    *signatures: str, reassociate: bool = False, inline: bool = False, division: bool = False
) -> Callable[[F], F]: ...
def compiled(*signatures: Any, reassociate: bool = False, inline: bool = False, division: bool = False) -> Any:
    """Compile a function with Numba at its first use, not at import.

    Args:
        signatures: The types of the arguments as Numba writes them, ``"(f8[:,::1], i8)"``, or the names of named
            tuples of numbers and of record types (``numpy.dtype``) that the function's file imports or defines. No
            signature for a function that only compiled functions call.
        reassociate: Whether sums may be taken in any order.
        inline: Copy the function into its callers; for a few lines in an inner loop.
        division: Return infinity or NaN for a division by zero, as NumPy does, and not raise an error.

    Returns:
        The function; ``py_func`` is the Python function.
    """
    if signatures and callable(signatures[0]):
        return _wrapped(signatures[0], (), {})
    options: dict[str, Any] = {"fastmath": _REASSOCIATE} if reassociate else {}
    if inline:
        options["inline"] = "always"
    if division:
        options["error_model"] = "numpy"
    return lambda function: _wrapped(function, signatures, options)


def _wrapped(function: Callable[..., Any], signatures: tuple[str, ...], options: dict[str, Any]) -> Any:
    if getattr(config, "DISABLE_JIT", False):
        return function
    if not signatures:
        options = _OPTIONS | options | {"no_cpython_wrapper": True}
        return _Helper(function, targetoptions=options, pipeline_class=LinkedCompiler)
    entry = _EntryPoint(function, targetoptions=_OPTIONS | options)
    entry.signatures_declared = signatures
    return entry


def compile_now(functions: Iterable[Callable[..., Any]]) -> None:
    """Load compiled functions from disk, and compile those that are not there.

    Of several processes that start at once one compiles and the others wait and load; what is to come is announced on
    stderr where it takes more than two seconds.

    Args:
        functions: Functions decorated with ``compiled`` and signatures; others are ignored.
    """
    with _preparing:
        waiting = [function for function in functions if isinstance(function, _EntryPoint)]
        missing = [function for function in waiting if not _load(function)]
        if not missing:
            return
        with _other_processes_waiting():
            # Another process may have compiled them while this one waited.
            missing = [function for function in missing if not _load(function)]
            _announce(missing)
            with _no_garbage_collection():
                for function in missing:
                    _prepare(function)


@contextmanager
def _other_processes_waiting() -> Iterator[None]:
    """Let one process compile at a time; the system releases the lock of a process that is killed.

    Files are written as a whole, so where there are no locks, as on some network file systems, functions are compiled
    more than once and nothing else happens.
    """
    from filelock import FileLock, Timeout  # only a process that compiles needs it

    folder = cache_folder()
    with ExitStack() as stack:
        if folder:
            lock = FileLock(folder / "lock")
            with suppress(OSError, NotImplementedError):  # there are no locks; or ``Timeout``, of a process that hangs
                try:
                    stack.enter_context(lock.acquire(timeout=0))
                except Timeout:
                    _say("waiting for another process that compiles the same functions")
                    stack.enter_context(lock.acquire(timeout=_PATIENCE))
        yield


@contextmanager
def _no_garbage_collection() -> Iterator[None]:
    """Stop looking for cycles among the many objects of a compilation, which takes an eighth of the time."""
    running = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if running:
            gc.enable()


def _load(entry: _EntryPoint) -> bool:
    """Load a function from disk; return whether all of its signatures were there."""
    if not isinstance(entry, _EntryPoint):
        return True  # compiled since, because another function calls it
    cache = _cache(entry)
    for signature in entry.signatures_declared:
        result = cache.load_overload(signature, entry.targetctx)
        if result is None:
            return False
        if result.signature.args not in entry.overloads:
            entry.targetctx.insert_user_function(result.entry_point, result.fndesc, [result.library])
            entry.add_overload(result)
    _finish(entry)
    return True


def _prepare(entry: _EntryPoint) -> None:
    """Compile a function, or load it where it is on disk."""
    if not isinstance(entry, _EntryPoint) or _load(entry):
        return
    cache = _cache(entry)
    setattr(entry, "_cache", cache)  # noqa: B010 - Numba's own attribute, which its stubs lack
    for signature in entry.signatures_declared:
        arguments = _parsed(signature, entry.py_func.__globals__)
        cache.written[arguments] = signature
        entry.compile(arguments)
    _finish(entry)


def _parsed(signature: str, names: dict[str, Any]) -> tuple[types.Type, ...]:
    """Return the types that a signature stands for, by the names of Numba's types and of named tuples."""
    named = {name: _struct(value) for name, value in _structs(signature, names).items()}
    return eval(signature, {}, {**vars(types), **named})


def _structs(signature: str, names: dict[str, Any]) -> dict[str, Any]:
    """Return the named tuples and the types of records that a signature names."""
    return {
        name: value
        for name, value in names.items()
        if name in signature and (hasattr(value, "_fields") or isinstance(value, np.dtype))
    }


def _struct(named: Any) -> types.Type:
    """Return the type of a record, or of a named tuple whose fields are ``float``, ``int`` or ``bool``."""
    if isinstance(named, np.dtype):
        return from_dtype(named)
    kinds = [getattr(kind, "__forward_arg__", kind) for kind in named.__annotations__.values()]
    fields = [_NUMBERS[kind] for kind in kinds]
    if len(set(fields)) == 1:
        return types.NamedUniTuple(fields[0], len(fields), named)
    return types.NamedTuple(fields, named)


def _finish(entry: _EntryPoint) -> None:
    entry.disable_compile()
    object.__setattr__(entry, "__class__", _Dispatcher)


def _cache(entry: _EntryPoint) -> DiskCache:
    names, declared = entry.py_func.__globals__, list(entry.signatures_declared)
    for signature in entry.signatures_declared:
        declared += [str(_struct(value)) for _, value in sorted(_structs(signature, names).items())]
    return DiskCache(entry.py_func, fingerprint(entry, declared))


def _announce(missing: list[_EntryPoint]) -> None:
    """Print what will be compiled and about how long it takes."""
    seconds = _SECONDS_PER_BYTE * code_size(missing)
    if seconds > _WORTH_SAYING:
        folder = cache_folder()
        kept = f"once, kept in {folder}" if folder else "in every process"
        _say(f"compiling {len(missing)} functions for this processor: about {seconds:.0f} s, {kept}")


def _say(text: str) -> None:
    print(f"shape_obs: {text} ...", file=sys.stderr, flush=True)
