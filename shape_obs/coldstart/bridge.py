"""Bridging: the pieces of an interrupted rope, joined end to end."""

from __future__ import annotations

from itertools import product

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def join(pieces: list[Array]) -> Array:
    """Join curves into one, nearest and straightest first.

    Two ends suit each other when they lie close and a straight bridge continues both: the cost of a gap is its length
    times one plus how far either tangent turns away from it.

    Args:
        pieces: (P_i,2) curves, pixels, in no particular direction.

    Returns:
        (P,2) one curve through all of them.
    """
    chains = list(pieces)
    while len(chains) > 1:
        options = [
            (_cost(_directed(chains[i], a)[::-1], _directed(chains[j], b)), i, j, a, b)
            for i in range(len(chains))
            for j in range(i + 1, len(chains))
            for a, b in product((0, 1), (0, 1))
        ]
        _, i, j, a, b = min(options, key=lambda option: option[0])
        joined = np.concatenate([_directed(chains[i], a)[::-1], _directed(chains[j], b)])
        chains = [chain for index, chain in enumerate(chains) if index not in (i, j)] + [joined]
    return chains[0]


def _directed(curve: Array, end: int) -> Array:
    """The curve so that it begins at its first (0) or last (1) point."""
    return curve[::-1] if end else curve


def _cost(before: Array, after: Array) -> float:
    """The price of a straight bridge from the end of ``before`` to the start of ``after``."""
    gap = after[0] - before[-1]
    length = float(np.linalg.norm(gap))
    if length < 1e-9:
        return 0.0
    reach = min(len(before), len(after), 12)
    out, into = before[-1] - before[-reach], after[reach - 1] - after[0]
    cosines = [gap @ t / (length * max(float(np.linalg.norm(t)), 1e-9)) for t in (out, into)]
    return length * (1 + sum(1 - cosine for cosine in cosines))
