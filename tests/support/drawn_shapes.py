"""Plane shapes for tests of features, and the features of each layout."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from shape_obs import CameraModel, Intrinsics, Shape
from shape_obs.features import (
    Centroid,
    ContourMoments,
    Curvature,
    FeatureContext,
    Length,
    Orientation,
    RegionMoments,
    Tangents,
    TurningAngles,
)
from shape_obs.geometry.topology import Chain, Grid, Ring, Topology

OVERHEAD = CameraModel(
    Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5),
    np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 1], [0, 0, 0, 1]]),
)
VIEW = FeatureContext(320, 240, OVERHEAD, ((-0.5, -0.4, -0.1), (0.5, 0.4, 0.3)))
LINES = [TurningAngles, Curvature, ContourMoments, Length]
ANY = [Tangents, Centroid, Orientation, lambda **rest: Orientation(axis="principal", **rest)]
ORDER3 = [lambda **rest: ContourMoments(order=3, **rest)], [lambda **rest: RegionMoments(order=3, **rest)]
OF: list[tuple[Topology, list[Any]]] = [
    (Chain(20), [*ANY, *LINES, *ORDER3[0]]),
    (Ring(32), [*ANY, *LINES, RegionMoments, *ORDER3[0], *ORDER3[1]]),
    (Grid(4, 8), [*ANY, RegionMoments, *ORDER3[1]]),
]
PAIRS = [pytest.param(layout, make, id=f"{make().kind}-{layout}") for layout, makes in OF for make in makes]


def shape(points: Any, layout: Topology, unknown: Any = (), filled: Any = ()) -> Shape:
    """Return a shape of points (N, 2), one metre from the camera or in pixels, or of (N, 3) metres."""
    points = np.array(points, np.float32)
    in_space = np.column_stack([points, np.ones(len(points))]) if points.shape[1] == 2 else points
    in_image, in_space = points[:, :2].copy(), in_space.astype(np.float32)
    seen = np.ones(len(points), bool)
    seen[list(unknown)] = seen[list(filled)] = False
    in_image[list(unknown)] = in_space[list(unknown)] = np.nan
    return Shape("rope", in_image, in_space, seen, seen.copy(), layout)


def circle(n: int, radius: float = 0.1, arc: float = 2 * np.pi, closed: bool = True) -> np.ndarray:
    """Return points on an arc from the first axis towards the second, (N, 2)."""
    at = np.linspace(0, arc, n, endpoint=not closed)
    return radius * np.stack([np.cos(at), np.sin(at)], axis=1)


def rectangle(width: float, height: float, each: int = 5) -> np.ndarray:
    """Return 4 * each points around a rectangle with a corner at (0, 0)."""
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height], [0, 0]])
    share = np.arange(each)[:, None] / each
    return np.concatenate([a + share * (b - a) for a, b in pairwise(corners)])


def turned(points: np.ndarray, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s], [-s, c]])


bends = hnp.arrays(np.float64, 4, elements=st.floats(-1.2, 1.2))
angles = st.floats(-np.pi, np.pi)


def drawn(layout: Topology, bend: np.ndarray) -> np.ndarray:
    """Return a smooth shape, about half a metre in size."""
    if isinstance(layout, Chain):
        at = np.linspace(0, np.pi, layout.size - 1)
        heading = bend @ np.stack([np.cos(at), np.sin(at), np.cos(2 * at), np.sin(2 * at)])
        steps = 0.02 * np.stack([np.cos(heading), np.sin(heading)], axis=1)
        return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    if isinstance(layout, Ring):
        at = 2 * np.pi * np.arange(layout.size) / layout.size
        wave = 1 + 0.15 * bend @ np.stack([np.cos(2 * at), np.sin(2 * at), np.cos(3 * at), np.sin(3 * at)])
        return circle(layout.size, 0.15) * wave[:, None]
    assert isinstance(layout, Grid)
    row, column = layout.places().T
    x, y = 0.04 * column, 0.05 * row
    return np.stack([x + 0.02 * bend[0] * np.sin(9 * y), y + 0.02 * bend[1] * np.sin(9 * x)], axis=1)
