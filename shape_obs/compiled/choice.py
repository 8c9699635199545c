"""Which backend runs the inner loops."""

from __future__ import annotations

import warnings
from functools import lru_cache
from importlib import import_module
from importlib.util import find_spec
from typing import Literal, cast

from shape_obs.compiled.interface import Kernels

Backend = Literal["auto", "numpy", "numba"]


@lru_cache
def choose(backend: Backend) -> Kernels:
    """The kernels of a backend; ``"auto"`` takes Numba where it is installed and works, and tells where it does not.

    Raises:
        ImportError: Numba was asked for, and is not installed or does not work here.
    """
    if backend == "numpy" or (backend == "auto" and not find_spec("numba")):
        return _load("numpy")
    if not find_spec("numba"):
        raise ImportError(
            "backend='numba' needs Numba: pip install 'shape-obs[fast]', or take backend='auto', which does without."
        )
    try:
        return _load("numba")
    except (ImportError, RuntimeError) as error:  # made for another NumPy, or no folder to keep what was compiled
        reason = f"Numba does not work here: {error}"
        if "cache" in str(error):
            reason += " Set NUMBA_CACHE_DIR to a folder that may be written to."
        if backend == "numba":
            raise ImportError(reason) from error
        warnings.warn(f"{reason} The inner loops run on NumPy; backend='numpy' says so.", RuntimeWarning, stacklevel=2)
        return _load("numpy")


def _load(backend: str) -> Kernels:
    return cast(Kernels, import_module(f"shape_obs.compiled.{backend}_"))
