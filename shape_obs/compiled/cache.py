"""Compiled functions on disk: one file for each signature, in the user's folder for caches."""

from __future__ import annotations

import contextlib
import hashlib
import os
import pickle
import sys
import tempfile
import time
import uuid
import warnings
from functools import lru_cache, partial
from pathlib import Path
from types import FunctionType
from typing import Any, Final

from llvmlite import binding
from numba.core.compiler import CompileResult
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps

_FOLDER: Final = "shape_obs"
_KEPT: Final = 30 * 86400.0  # seconds for which versions of a function other than the newest are kept
_DIGEST: Final = 16  # bytes
_REPORT: Final = "Please report this together with the version of Numba."


@lru_cache
def cache_folder() -> Path | None:
    """Return the folder of compiled functions, made where it is missing; None where nothing can be written.

    ``NUMBA_CACHE_DIR`` comes first, then the user's folder for caches. The package's own folder is not used: it may be
    read-only or shared, and what is in it survives neither an update nor an uninstall cleanly.
    """
    folder = _user_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError as error:
        _warn(str(error), "Set NUMBA_CACHE_DIR to a folder that can be written to.")
        return None


def _user_folder() -> Path:
    if given := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(given) / _FOLDER
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local") / _FOLDER / "Cache"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / _FOLDER
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / _FOLDER


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
