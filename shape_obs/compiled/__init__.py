"""The inner loops, twice: on NumPy, the readable reference, and on Numba, which is used where it is installed."""

from typing import Final

from shape_obs.compiled.choice import Backend, choose
from shape_obs.compiled.interface import Kernels

NUMPY: Final = choose("numpy")

__all__ = ["NUMPY", "Backend", "Kernels", "choose"]
