"""Where a polyline is nearest to points: for clusterers and metrics, in any dimension."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.polyline import arc_length

Array = npt.NDArray[np.float64]

_BLOCK: Final = 250_000  # pairs of a point and a piece of a polyline in one pass: 4 MB in the plane


def nearest_on(curve: Array, points: Array) -> tuple[Array, Array]:
    """Return where a polyline is nearest to each point: ``(P, D)``, ``(N, D)`` -> arc positions, distances ``(N,)``."""
    curve = np.ascontiguousarray(curve, dtype=np.float64)
    start, side = curve[:-1], np.diff(curve, axis=0)
    square = np.einsum("pd,pd->p", side, side)
    length = np.sqrt(square)
    begins = arc_length(curve)[:-1]
    arc, distance = np.empty(len(points)), np.empty(len(points))
    rows = max(_BLOCK // len(start), 1)
    for first in range(0, len(points), rows):
        block = slice(first, first + rows)
        away = points[block, None, :] - start
        share = np.clip(np.einsum("npd,pd->np", away, side) / np.maximum(square, 1e-300), 0.0, 1.0)
        away -= share[..., None] * side
        off = np.einsum("npd,npd->np", away, away)
        best = np.argmin(off, axis=1)
        row = np.arange(len(best))
        arc[block] = begins[best] + share[row, best] * length[best]
        distance[block] = np.sqrt(off[row, best])
    return arc, distance
