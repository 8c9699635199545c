"""Shapes that are a line, open or closed: their points one after another."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shape_obs.topology import Chain, Ring, Topology

Array = npt.NDArray[np.float64]


def closes(layout: Topology, kind: str) -> bool:
    """Whether a line ends where it began.

    Raises:
        ValueError: The layout is no line; ``kind`` is the feature that wants one.
    """
    if not isinstance(layout, (Chain, Ring)):
        raise ValueError(
            f"feature {kind!r} is of a line, a Chain (centerline) or a Ring (contour), got {layout}. Of a lattice "
            "there are 'tangents', 'region_moments', 'centroid' and 'orientation'."
        )
    return isinstance(layout, Ring)


def polyline(values: Array, closed: bool) -> Array:
    """(N,...) along the line, with the first once more at the end where it closes."""
    return np.concatenate([values, values[:1]]) if closed else values
