"""Goal points of any number as the points that a configuration would put on such a shape, index for index."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics
from shape_obs.configurations import Configuration
from shape_obs.geometry.curve import FittedCurve, FittedForm
from shape_obs.geometry.lattice import FittedLattice
from shape_obs.geometry.outline import clockwise
from shape_obs.geometry.polyline import catmull_rom
from shape_obs.geometry.topology import Chain, Grid, Ring, Topology
from shape_obs.shape import Shape
from shape_obs.spec import did_you_mean

Array = npt.NDArray[np.float64]

_LEAST: Final = 3  # points of a curve


def goal_topology(told: Mapping[str, Any], spec: Configuration, count: int) -> Topology:
    """How the points of a goal hang together.

    Args:
        told: What is known of it: ``{"kind": "centerline"}``, ``{"kind": "contour"}`` or ``{"kind": "surface",
            "rows": 5, "cols": 7}``; what is missing is as the configuration's own.
        spec: The configuration whose points the goal is for.
        count: How many points the goal has.

    Raises:
        ValueError: The goal is of another kind than the configuration, or has too few or too many points for it.
    """
    kind, own, told = told.get("kind", spec.kind), spec.layout, dict(told)
    if kind != spec.kind:
        raise ValueError(f"a goal laid out as a {kind!r} is no goal for shape {spec.name!r}, which is a {spec.kind!r}.")
    known = ("kind", "rows", "cols") if isinstance(own, Grid) else ("kind",)
    for name in told:
        if name not in known:
            raise ValueError(f"goal_layout of a {kind!r}: unknown entry {name!r}{did_you_mean(name, known)}")
    if isinstance(own, Grid):
        grid = Grid(int(told.get("rows", own.rows)), int(told.get("cols", own.cols)))
        if grid.size != count or min(grid.rows, grid.cols) < 2:
            raise ValueError(
                f"goal of a {kind!r}: expected {grid.rows} x {grid.cols} points, at least 2 x 2, got {count} points; "
                f'say how they are laid out: {{"kind": {kind!r}, "rows": ..., "cols": ...}}.'
            )
        return grid
    if not isinstance(own, (Chain, Ring)):
        raise ValueError(f"goals can be chains, rings or lattices of points; a {kind!r} is a {type(own).__name__}.")
    if count < _LEAST:
        raise ValueError(f"goal of a {kind!r}: expected at least {_LEAST} points, got {count}.")
    return type(own)(count)


def placed(points: Array, spec: Configuration, topology: Topology, intrinsics: Intrinsics | None) -> Array:
    """Goal points placed anew by the code that places a detector's points.

    A curve goes from end to end, a lattice from border to border, whatever ``ends`` the configuration has. Point 0
    keeps its place; outlines and lattices that run counterclockwise as seen are turned over, since a detector numbers
    all of them clockwise.

    Args:
        points: (K,3) metres, camera frame, or (K,2) pixels.
        spec: The configuration whose points are wanted.
        topology: How the K points hang together.
        intrinsics: The projection; not needed for pixels.

    Returns:
        (N,3) metres, camera frame, or (N,2) pixels.

    Raises:
        ValueError: A point that is not in front of the camera, or pixels for gaps that are to be equal in metres.
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
    """A shape whose points are known: (N,3) metres, camera frame, or (N,2) pixels."""
    pixels = _pixels(places, intrinsics).astype(np.float32)
    points3d = places.astype(np.float32) if places.shape[1] == 3 else None
    known = np.ones(spec.count, bool)
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
    """The smooth form through points (K,D), which the camera sees at (K,2) pixels."""
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
    """(R,C,D) -> (R',C,D): more rows, on smooth curves down the columns."""
    if len(lattice) < _LEAST:
        return lattice
    rows = np.ascontiguousarray(lattice).reshape(len(lattice), -1)
    return catmull_rom(rows, 4, False).reshape(-1, *lattice.shape[1:])
