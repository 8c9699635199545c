"""What a backend offers. Both have the same functions, and agree to 1e-3 px."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Kernels(Protocol):
    """A module with these functions; arrays are C-contiguous float64 where nothing else is said."""

    def best_matching_units(self, points: Array, nodes: Array) -> npt.NDArray[np.intp]:
        """The nearest node of each point: argmax of x.c - |c|^2/2.  (M,D), (K,D) -> (M,)."""
        ...
