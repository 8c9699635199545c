"""The self-organising map of a sheet, which evens out the inside of its lattice."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.clustering.som import run_som
from shape_obs.geometry.coons import FINE
from shape_obs.geometry.lattice import FittedLattice
from shape_obs.geometry.observed import Observed
from shape_obs.geometry.topology import Grid

_MAP: Final = Grid(8, 8)  # the nodes of the map
_CELL: Final = 8  # pixels
_SIGMA: Final = 0.5  # width of the map's neighbourhood, node units


def moved_inside(form: FittedLattice, observed: Observed, epochs: int) -> npt.NDArray[np.float64]:
    """Return how some epochs of the map move the points of a lattice: ``(P, D)``, nothing at its border."""
    from scipy.ndimage import map_coordinates  # takes 0.2 s to import

    start = form.evenly(_MAP.rows, _MAP.cols, centers=True)
    nodes = run_som(observed.gather(_CELL), start, _MAP, epochs * (_SIGMA,))
    moved = np.pad(_MAP.lattice(nodes - start), ((1, 1), (1, 1), (0, 0)))
    at = []
    for count, gauge in zip((_MAP.rows, _MAP.cols), form.gauges, strict=True):
        middles = np.interp((np.arange(count) + 0.5) / count * gauge[-1], gauge, np.arange(FINE))
        knots = np.concatenate([[0.0], middles, [FINE - 1.0]])
        at.append(np.interp(np.arange(FINE), knots, np.arange(count + 2)))
    fine = np.stack(np.meshgrid(*at, indexing="ij")).reshape(2, -1)
    return np.stack([map_coordinates(moved[..., d], fine, order=1) for d in range(moved.shape[2])], axis=1)
