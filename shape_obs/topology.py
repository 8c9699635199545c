"""Neighbourhoods of self-organising maps: which nodes hang together, and what smoothing along them does."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Neighbourhood(NamedTuple):
    """Kernel moments for a local-linear update; all (K,K), row k weighs the bins as node k sees them.

    Args:
        weight: h(k,j) = exp(-(j-k)^2 / 2 sigma^2).
        first: h (j-k).
        second: h (j-k)^2.
    """

    weight: Array
    first: Array
    second: Array


@dataclass(frozen=True)
class Chain:
    """An open chain of ``size`` nodes."""

    size: int

    def neighbourhood(self, sigma: float) -> Neighbourhood:
        """The kernel of width ``sigma``, in node units."""
        return _chain_neighbourhood(self.size, sigma)

    def unshrink(self, nodes: Array, sigma: float) -> Array:
        """Undo the pull of averaging towards the inside of a bend, to second order.

        The mean over a unit cell of a curve C is C + C''/24, and the kernel mean over both neighbours adds
        h/(1+2h) C'' with h = exp(-1/2 sigma^2); the second difference stands for C'', at an end its neighbour's.
        """
        h = np.exp(-0.5 / sigma**2)
        bend = nodes[2:] - 2 * nodes[1:-1] + nodes[:-2]
        out = nodes.copy()
        out[1:-1] -= (1 / 24 + h / (1 + 2 * h)) * bend
        out[[0, -1]] -= bend[[0, -1]] / 24
        return out


@lru_cache(maxsize=64)
def _chain_neighbourhood(size: int, sigma: float) -> Neighbourhood:
    offset = np.arange(size)[None, :] - np.arange(size)[:, None].astype(np.float64)
    weight = np.exp(-0.5 * (offset / sigma) ** 2)
    return Neighbourhood(weight, weight * offset, weight * offset**2)
