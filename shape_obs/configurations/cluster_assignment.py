"""Put the centres of a clusterer in order along the fitted form: they become the points of the shape.

The form is tracked and validated; the centres are only sorted by it. So an index follows the track, and a point lies
where the clusterer has put it: gaps are uneven, and a centre between two strands may be counted to either.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.clustering.base import Clusterer
from shape_obs.configurations.base import Configuration
from shape_obs.geometry.curve import FittedCurve, FittedForm
from shape_obs.geometry.lattice import FittedLattice
from shape_obs.geometry.observed import Observed
from shape_obs.geometry.polyline import nearest_on
from shape_obs.geometry.topology import Grid
from shape_obs.tracking.predict import Fit

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

_SEED: Final = 0  # of every frame: equal masks give equal points


def assign_centres(found: Fit, observed: Observed, spec: Configuration, clusterer: Clusterer) -> Fit:
    """Return the fit with a clusterer's centres as its points; refused if there are fewer samples than points."""
    samples = spec.clusterer_samples(observed)
    if len(samples) < spec.layout.size:
        available = f"the {observed.noun} has {len(samples)} {observed.sample_unit} to cluster"
        return Fit(reason=f"{available}, {spec.layout.size} points need as many")
    places = clusterer.centres(samples, spec.layout, _SEED).places
    return found._replace(centres=places[order(places, found.form, spec)])


def order(centres: Array, form: FittedForm, spec: Configuration) -> Indices:
    """Return which centre becomes point i, ``(N,)``.

    Args:
        centres: ``(N, D)``.
        form: What they are sorted by: a curve by arc length, a lattice by its two coordinates, any other form by the
            points that the configuration itself would put on it.
        spec: The configuration.
    """
    if isinstance(form, FittedCurve):
        return _around(form, centres) if form.closed else np.argsort(_arcs(form, centres), kind="stable")
    if isinstance(form, FittedLattice) and isinstance(spec.layout, Grid):
        lattice = spec.layout
        return _assigned(_places(form, centres) * (lattice.rows, lattice.cols) - 0.5, lattice.places())
    return _assigned(centres, spec.resample(form, form).places)


def _arcs(curve: FittedCurve, centres: Array) -> Array:
    """Return the arc positions ``(N,)`` of the places on a curve that are nearest to ``(N, D)`` centres."""
    line = np.concatenate([curve.points, curve.points[:1]]) if curve.closed else curve.points
    return nearest_on(line, centres)[0]


def _around(curve: FittedCurve, centres: Array) -> Indices:
    """Return the order along a closed curve that leaves the centres nearest to equal shares from its first point.

    Beginning with the first centre after the curve's first point, all indices would move by one whenever a centre
    passes it.
    """
    share = _arcs(curve, centres) / curve.size
    sorted_ones = np.argsort(share, kind="stable")
    count = len(share)
    off = share[sorted_ones][(np.arange(count)[:, None] + np.arange(count)) % count] - np.arange(count) / count
    off -= np.round(off)
    return np.roll(sorted_ones, -int(np.argmin(np.sum(off**2, axis=1))))


def _places(patch: FittedLattice, centres: Array) -> Array:
    """Return how far down and across a lattice, 0...1, the places nearest to ``(N, D)`` centres lie: ``(N, 2)``."""
    from scipy.spatial.distance import cdist

    lattice = patch.lattice
    row, column = np.divmod(np.argmin(cdist(centres, patch.points), axis=1), lattice.shape[1])
    # From the nearest of the patch's points a step over the plane that touches it there.
    touching = np.stack([np.gradient(lattice, axis=axis)[row, column] for axis in (0, 1)], axis=1)  # (N,2,D)
    gram = np.einsum("nid,njd->nij", touching, touching) + 1e-12 * np.eye(2)
    away = np.einsum("nid,nd->ni", touching, centres - lattice[row, column])
    step = np.clip(np.linalg.solve(gram, away[..., None])[..., 0], -1.0, 1.0)
    found = []
    for at, gauge in zip((np.stack([row, column], axis=1) + step).T, patch.gauges, strict=True):
        found.append(np.interp(at, np.arange(len(gauge)), gauge) / gauge[-1])
    return np.stack(found, axis=1)


def _assigned(centres: Array, places: Array) -> Indices:
    """Return which centre belongs to each place, so that the squared distances are least in sum."""
    from scipy.optimize import linear_sum_assignment
    from scipy.spatial.distance import cdist

    return linear_sum_assignment(cdist(places, centres, "sqeuclidean"))[1]
