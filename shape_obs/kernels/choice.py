"""Which backend runs the inner loops."""

from __future__ import annotations

from functools import lru_cache
from importlib import import_module
from importlib.util import find_spec
from typing import Literal, cast

from shape_obs.kernels.interface import Kernels

Backend = Literal["auto", "numpy", "numba"]


@lru_cache
def choose(backend: Backend) -> Kernels:
    """The kernels of a backend; ``"auto"`` takes Numba where it is installed.

    Raises:
        ImportError: Numba was asked for and is not installed.
    """
    if backend == "auto":
        backend = "numba" if find_spec("numba") else "numpy"
    if backend == "numba" and not find_spec("numba"):
        raise ImportError(
            "backend='numba' needs Numba: pip install 'shape-obs[fast]', or take backend='auto', which does without."
        )
    return cast(Kernels, import_module(f"shape_obs.kernels.{backend}_"))
