"""Compiled functions on disk: one file for each signature, named by all that its machine code depends on."""

from __future__ import annotations

import contextlib
import hashlib
import os
import pickle
import stat
import sys
import tempfile
import time
import uuid
import warnings
from collections.abc import Iterable, Iterator
from functools import lru_cache, partial
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any, Final

import llvmlite
import numba
import numpy as np
from llvmlite import binding
from numba.core import config
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher
from numba.core.registry import cpu_target
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps

_FORMAT: Final = 2  # of the files
# Settings of Numba that change what is generated.
_SETTINGS: Final = ("OPT", "BOUNDSCHECK", "DEBUGINFO_DEFAULT", "LOOP_VECTORIZE", "SLP_VECTORIZE")

_FOLDER: Final = "shape_obs"
_KEPT: Final = 30 * 86400.0  # seconds for which versions of a function other than the newest are kept
_DIGEST: Final = 16  # bytes
_REPORT: Final = "Please report this together with the version of Numba."


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
                # A file refers to the functions that its function calls by their places.
                yield f"{function.__module__}.{function.__qualname__}".encode()
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


@lru_cache
def cache_folder() -> Path | None:
    """Return the folder of compiled functions, made where it is missing; None where nothing can be read or written.

    ``NUMBA_CACHE_DIR`` comes first, then the user's folder for caches, then one in the folder for temporary files that
    only this user can write, since its files are code. A folder that was filled when a container was built is read even
    if it cannot be written. The package's own folder is not used: it may be read-only or shared, and what is in it
    survives neither an update nor an uninstall cleanly.
    """
    reasons: list[str] = []
    for find in (_given_folder,) if os.environ.get("NUMBA_CACHE_DIR") else (_user_folder, _temporary_folder):
        try:
            folder = find()
            if any(folder.glob("*.bin")) and not os.access(folder, os.W_OK):
                return folder
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                return folder
        except (OSError, RuntimeError) as error:  # noqa: PERF203 - RuntimeError: no HOME and no entry in passwd
            reasons.append(str(error).rstrip("."))
    _warn("; ".join(reasons), "Set NUMBA_CACHE_DIR to a folder that can be written to.")
    return None


def _given_folder() -> Path:
    return Path(os.environ["NUMBA_CACHE_DIR"]) / _FOLDER


def _user_folder() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local") / _FOLDER / "Cache"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / _FOLDER
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / _FOLDER


def _temporary_folder() -> Path:
    """Return a folder of this user alone; others could put code into any other one."""
    user = os.getuid() if hasattr(os, "getuid") else 0
    folder = Path(tempfile.gettempdir()) / f"{_FOLDER}-{user}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if hasattr(os, "getuid") and (not stat.S_ISDIR(found.st_mode) or found.st_uid != user or found.st_mode & 0o022):
        raise PermissionError(f"{folder} can be written by other users")
    return folder


class DiskCache:
    """The file of one compiled function, as Numba's dispatchers use a cache.

    Args:
        function: The Python function.
        key: Hash of all that its machine code depends on.

    Attributes:
        written: How a signature of types is written, by which its file is found.
    """

    def __init__(self, function: FunctionType, key: str) -> None:
        self._name = f"{function.__module__}.{function.__qualname__}"
        self._key = key
        self.written: dict[Any, str] = {}

    def _path(self, signature: Any) -> Path | None:
        folder, signature = cache_folder(), self.written.get(signature, signature)
        digest = hashlib.blake2b(f"{self._key} {signature}".encode(), digest_size=_DIGEST).hexdigest()
        return folder and folder / f"{self._name}-{digest}.bin"

    def load_overload(self, sig: Any, target_context: Any) -> CompileResult | None:
        """Return a function that was compiled before, None where there is none."""
        path = self._path(sig)
        try:
            if path is None:
                return None
            data = path.read_bytes()
        except OSError:
            return None
        # Numba's cache would import all that a compilation needs first, for 0.15 s. Code that is compiled already
        # needs the functions of C that it calls alone; without one LLVM would end the process.
        rtsys.initialize(target_context)
        try:
            if hashlib.blake2b(data[_DIGEST:], digest_size=_DIGEST).digest() != data[:_DIGEST]:
                return None  # cut short by a power failure: LLVM would end the process
            symbols, bitcode, reduced = pickle.loads(data[_DIGEST:])
            if any(binding.address_of_symbol(symbol) is None for symbol in symbols):
                target_context.refresh()
            result = CompileResult._rebuild(target_context, *reduced)
            # Parsing what only a compilation of its callers needs would double the time.
            result.library._get_module_for_linking = lru_cache(partial(binding.parse_bitcode, bitcode))
            return result
        except Exception as error:  # noqa: BLE001 - internals of Numba: compile again and write it again
            _warn(f"{type(error).__name__}: {error}", _REPORT)
            return None

    def save_overload(self, sig: Any, cres: CompileResult) -> None:
        """Write a compiled function, and delete versions of it that were written long ago."""
        path = self._path(sig)
        if path is None or cres.library.has_dynamic_globals:
            return
        try:
            data = _serialized(cres)
        except Exception as error:  # noqa: BLE001 - internals of Numba: what is compiled works without a file
            _warn(f"{type(error).__name__}: {error}", _REPORT)
            return
        try:
            _write(path, hashlib.blake2b(data, digest_size=_DIGEST).digest() + data)
            _delete_old(path, f"{self._name}-")
        except OSError as error:
            if not path.exists():  # Windows replaces no file that another process has open, and that is as good
                reason = f"{error.strerror}: {path.parent}"
                _warn(reason, "Free some space, or set NUMBA_CACHE_DIR to another folder.")


def _serialized(result: CompileResult) -> bytes:
    """Return a compiled function as bytes: the C symbols that it needs, its bitcode, and what Numba rebuilds."""
    module = result.library._final_module
    symbols = [f.name for f in module.functions if f.is_declaration and not f.name.startswith("llvm.")]
    (name, kind, (code, bitcode)), *rest, environments = result._reduce()
    # Without constants an environment says nothing, but loading it would import the modules of Numba that it is of.
    rest.append(tuple(environment for environment in environments if environment.consts))
    stub = f'define void @"{result.fndesc.llvm_cpython_wrapper_name}"() {{ ret void }}'  # what Python calls
    stub = binding.parse_assembly(stub).as_bitcode()
    return dumps((symbols, bitcode, ((name, kind, (code, stub)), *rest)))


@lru_cache
def _warn(reason: str, advice: str) -> None:
    """Warn that every process compiles the functions again; once for each reason."""
    warnings.warn(
        f"Compiled functions cannot be kept ({reason}), so every process compiles them again, for about half a "
        f"minute. {advice}",
        RuntimeWarning,
        stacklevel=2,
    )


def _write(path: Path, data: bytes) -> None:
    """Write a file as a whole or not at all."""
    draft = path.with_name(f"{path.stem}-{uuid.uuid4().hex}.tmp")
    try:
        draft.write_bytes(data)
        draft.replace(path)
    except OSError:
        draft.unlink(missing_ok=True)
        raise


def _delete_old(newest: Path, prefix: str) -> None:
    for path in newest.parent.iterdir():
        if path.name.startswith(prefix) or path.suffix == ".tmp":
            with contextlib.suppress(OSError):
                if path != newest and time.time() - path.stat().st_mtime > _KEPT:
                    path.unlink()
