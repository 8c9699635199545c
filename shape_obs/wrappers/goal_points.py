"""Resample goal points to the points of a configuration, index for index."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics
from shape_obs.configurations.base import Configuration
from shape_obs.geometry.curve import FittedCurve, FittedForm
from shape_obs.geometry.lattice import FittedLattice
from shape_obs.geometry.outline import clockwise
from shape_obs.geometry.polyline import catmull_rom
from shape_obs.geometry.topology import Chain, Grid, Ring, Topology
from shape_obs.shape import Shape
from shape_obs.spec import did_you_mean

Array = npt.NDArray[np.float64]

_LEAST: Final = 3  # smallest number of points of a curve


def goal_topology(layout: Mapping[str, Any], spec: Configuration, count: int) -> Topology:
    """Return the topology of the points of a goal.

    Args:
        layout: ``{"kind": "centerline"}``, ``{"kind": "contour"}`` or ``{"kind": "surface", "rows": 5, "cols": 7}``;
            missing entries are those of the configuration.
        spec: The configuration of the shape that has the goal.
        count: Number of points of the goal.

    Raises:
        ValueError: The goal is of another kind than the configuration, or has the wrong number of points.
    """
    kind, own = layout.get("kind", spec.kind), spec.layout
    if kind != spec.kind:
        raise ValueError(f"a goal of kind {kind!r} does not fit shape {spec.name!r}, which is a {spec.kind!r}.")
    known = ("kind", "rows", "cols") if isinstance(own, Grid) else ("kind",)
    for name in layout:
        if name not in known:
            raise ValueError(f"goal_layout of a {kind!r}: unknown entry {name!r}{did_you_mean(name, known)}")
    if isinstance(own, Grid):
        grid = Grid(int(layout.get("rows", own.rows)), int(layout.get("cols", own.cols)))
        if grid.size != count or min(grid.rows, grid.cols) < 2:
            raise ValueError(
                f"goal of a {kind!r}: expected {grid.rows} x {grid.cols} points, at least 2 x 2, got {count} points; "
                f'give their layout: {{"kind": {kind!r}, "rows": ..., "cols": ...}}.'
            )
        return grid
    if not isinstance(own, (Chain, Ring)):
        raise ValueError(f"goals can be chains, rings or lattices of points; a {kind!r} is a {type(own).__name__}.")
    if count < _LEAST:
        raise ValueError(f"goal of a {kind!r}: expected at least {_LEAST} points, got {count}.")
    return type(own)(count)


def resample(points: Array, spec: Configuration, topology: Topology, intrinsics: Intrinsics | None) -> Array:
    """Resample goal points with the code that resamples the points of a detection.

    A curve extends from end to end and a lattice from border to border, for any ``ends`` of the configuration. Point 0
    keeps its position; outlines and lattices that run counterclockwise in the image are reversed, since detections
    always run clockwise.

    Args:
        points: ``(K, 3)`` metres, camera frame, or ``(K, 2)`` pixels.
        spec: The configuration that the points are resampled for.
        topology: The topology of the K points.
        intrinsics: The intrinsics of the camera; not needed for pixels.

    Returns:
        Points of shape ``(N, 3)`` in metres, camera frame, or ``(N, 2)`` in pixels.

    Raises:
        ValueError: A point is not in front of the camera, or the gaps must be equal in metres but points are pixels.
    """
    form = _form(points, _pixels(points, intrinsics), topology)
    if spec.spacing == "m" or spec.lift == "cloud":
        if points.shape[1] == 2:
            raise ValueError(
                f"shape {spec.name!r} has equal gaps in metres: give its goal in metres too, not in pixels."
            )
        metric = form
    else:
        metric = form.with_points(_pixels(form.points, intrinsics))
    return spec.resample(form, metric).places


def shape_at(places: Array, spec: Configuration, intrinsics: Intrinsics | None) -> Shape:
    """Return a shape with all points known: ``(N, 3)`` metres, camera frame, or ``(N, 2)`` pixels."""
    pixels = _pixels(places, intrinsics).astype(np.float32)
    points3d = places.astype(np.float32) if places.shape[1] == 3 else None
    known = np.ones(spec.layout.size, bool)
    return Shape(spec.name, pixels, points3d, known, known.copy(), spec.layout)


def _pixels(points: Array, intrinsics: Intrinsics | None) -> Array:
    if points.shape[1] == 2:
        return points
    assert intrinsics is not None
    pixels = intrinsics.project(points)
    if not np.all(np.isfinite(pixels)):
        worst = points[np.argmin(points[:, 2])].round(3).tolist()
        raise ValueError(f"the goal must lie in front of the camera, got {worst} metres in the camera's frame.")
    return pixels


def _form(points: Array, seen: Array, topology: Topology) -> FittedForm:
    """Return the smooth curve or lattice through points ``(K, D)`` that the camera sees at pixels ``(K, 2)``."""
    if isinstance(topology, Grid):
        lattice, seen = topology.lattice(points), topology.lattice(seen)
        border = np.concatenate([seen[0, :-1], seen[:-1, -1], seen[-1, :0:-1], seen[:0:-1, 0]])
        if not clockwise(border):
            lattice = lattice.swapaxes(0, 1)
        fine = _finer(_finer(lattice).swapaxes(0, 1)).swapaxes(0, 1)
        drawn = np.ascontiguousarray(fine).reshape(-1, points.shape[1])
        return FittedLattice.over(drawn, np.zeros(len(drawn), bool), len(fine))
    closed = isinstance(topology, Ring)
    if closed and not clockwise(seen):
        points = np.roll(points[::-1], 1, axis=0)
    drawn = catmull_rom(np.ascontiguousarray(points), 4, closed)
    return FittedCurve.through(drawn, np.zeros(len(drawn), bool), closed)


def _finer(lattice: Array) -> Array:
    """Add rows to a lattice on smooth curves down its columns: ``(R, C, D)`` -> ``(R', C, D)``."""
    if len(lattice) < _LEAST:
        return lattice
    rows = np.ascontiguousarray(lattice).reshape(len(lattice), -1)
    return catmull_rom(rows, 4, False).reshape(-1, *lattice.shape[1:])
