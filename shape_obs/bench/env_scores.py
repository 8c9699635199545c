"""Found points of a simulated object against the simulator's truth, whatever the object: rope, band or sheet."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial.distance import cdist

from shape_obs.geometry.topology import Chain, Grid, Ring, Topology

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_PLACES_PER_GAP: Final = 50  # places along the truth for each gap between points


class Place(NamedTuple):
    """How far found points are from where they belong.

    Args:
        mm: Mean distance of all points from their true places.
        slip: The farthest that a valid point lies from its own material, in gaps along the curve or the lattice.
        flipped: Another numbering of the same points (from the other end, the other way round, from another corner)
            would be nearer.
    """

    mm: float
    slip: float
    flipped: bool


def place(points: Array, valid: Mask, layout: Topology, simulator: Any) -> Place:
    """Compare found points with what the simulator knows.

    Args:
        points: (N,3) metres, base frame.
        valid: (N,) which of them were measured.
        layout: How they hang together.
        simulator: The environment; ``truth`` gives its points in the same frame.
    """
    if isinstance(layout, Grid):
        true = simulator.truth(layout.rows, layout.cols)
        slips = _off_lattice(layout.lattice(points - true), layout.lattice(true))
    elif isinstance(layout, (Chain, Ring)):
        true = simulator.truth(layout.size)
        slips = _along_curve(points, simulator, isinstance(layout, Ring))
    else:
        raise ValueError(f"expected a chain, a ring or a lattice, got {type(layout).__name__}.")
    distance = np.linalg.norm(points - true, axis=1)
    others = min(float(np.sum((other - true) ** 2)) for other in _renumbered(points, layout))
    slip = float(slips[valid].max(initial=0.0))
    return Place(1e3 * float(distance.mean()), slip, others < float(np.sum(distance**2)))


def _along_curve(points: Array, simulator: Any, closed: bool) -> Array:
    """(N,) how far points lie from their own arc position, along the curve, in gaps."""
    count = len(points)
    if closed:
        at = cdist(points, simulator.truth(_PLACES_PER_GAP * count)).argmin(axis=1) / _PLACES_PER_GAP
        return np.abs((at - np.arange(count) + count / 2) % count - count / 2)
    line = simulator.truth(_PLACES_PER_GAP * (count - 1) + 1)
    # Continued straight beyond its ends, so that points past a tip still have a place.
    beyond = np.arange(1, _PLACES_PER_GAP + 1)[:, None]
    before, behind = line[0] + (line[0] - line[1]) * beyond[::-1], line[-1] + (line[-1] - line[-2]) * beyond
    at = cdist(points, np.concatenate([before, line, behind])).argmin(axis=1) / _PLACES_PER_GAP - 1
    return np.abs(at - np.arange(count))


def _off_lattice(away: Array, true: Array) -> Array:
    """(N,) how far points lie from their places along the sheet, in gaps: the larger of down and across.

    Args:
        away: (rows,cols,3) from the true places to the found ones.
        true: (rows,cols,3) the true places.
    """
    gaps = np.stack([np.gradient(true, axis=0), np.gradient(true, axis=1)], axis=-1)
    off = np.linalg.pinv(gaps) @ away[..., None]
    return np.asarray(np.abs(off).max(axis=(-2, -1)).ravel(), dtype=np.float64)


def _renumbered(points: Array, layout: Topology) -> list[Array]:
    """The same points in each other order that a shape of this layout could have been given."""
    if isinstance(layout, Grid):
        lattice = layout.lattice(points)
        turned = (lattice[::-1], lattice[:, ::-1], lattice[::-1, ::-1])
        return [other.reshape(points.shape) for other in turned]
    backwards = points[::-1]
    return [np.roll(backwards, 1, axis=0) if isinstance(layout, Ring) else backwards]
