"""Centerline: a rope or cable as N points from one end to the other along its axis."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from shape_obs.clustering.som import batch_epochs, run_som
from shape_obs.configurations.base import Configuration, Ends, Points
from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.observed import Observed
from shape_obs.geometry.polyline import arc_length, catmull_rom, equal_chords, equidistant_positions, interpolate
from shape_obs.geometry.topology import Chain, Topology, undo_shrinkage
from shape_obs.image.connected_runs import gather_cells
from shape_obs.image.rope_tip import extend_chain
from shape_obs.initialization.folding import fold_outline, unexplained_share
from shape_obs.initialization.medial_axis import medial_axis
from shape_obs.tracking.occluders import uncover_ends
from shape_obs.tracking.occlusion import match_chain, shown
from shape_obs.tracking.prediction import Fit, Prediction, size_jump
from shape_obs.tracking.validation import MAX_HIDDEN, sample_spread, validate_ribbon

Array = npt.NDArray[np.float64]

# Nodes sit about this many widths apart: closer, and a chain starts to fold across the rope; farther, and it cuts
# corners. N is sampled from the curve afterwards, so it does not matter here.
_NODE_SPACING: Final = 1.4
_NODES: Final = (6, 48)
# Width of the map's neighbourhood in each epoch, node units. If a part of the rope was hidden in the last frame, what
# comes back has no node near it.
_SIGMAS_INITIAL: Final = (0.8, 0.4, 0.4)
_SIGMAS_STEADY: Final = (0.8, 0.4)
_SIGMAS_AREA_CHANGED: Final = (1.2, 0.6, 0.4, 0.4)
# The cost of joining pieces grows with the cube of their number, and a rope does not fall into that many.
_MAX_PIECES: Final = 16
_MIN_ASPECT: Final = 3.0  # length over width; what is stouter has no distinct axis, and a chain would fold up in it


@dataclass(frozen=True)
class Centerline(Configuration, kind="centerline"):
    """A rope's axis.

    Args:
        n: How many points.
        ends: ``"centers"``: the points are centres of N equal pieces, as cluster centres are; ``"tips"``: the first
            and last point lie on the rope's real tips. None takes the detector's.
    """

    n: int = 20
    ends: Ends | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 2 <= self.n <= 1000:
            raise ValueError(f"centerline: n must lie in 2...1000, got {self.n}.")

    @property
    def layout(self) -> Chain:
        """A chain of n points."""
        return Chain(self.n)

    def rejection_reason(self, observed: Observed) -> str:
        """Return why an object cannot be a rope: too many pieces, or less than three times as long as wide."""
        for part in observed.parts:
            if part.pieces > _MAX_PIECES:
                return f"the {part.noun} falls into {part.pieces} pieces, at most {_MAX_PIECES}"
        length, width = observed.length, observed.width
        if length < _MIN_ASPECT * width:
            return f"the {observed.noun} is {length:.4g} x {width:.4g} {observed.unit}: too stout for a rope"
        return ""

    def fit(
        self, observed: Observed, prediction: Prediction | None, target: Array | None, depth: npt.NDArray[Any] | None
    ) -> Fit:
        """Fit a chain of nodes: from where the track expects it, else along an initial axis."""
        known = observed if prediction is None else observed.with_width(prediction.width)
        reason = self.rejection_reason(known)
        if reason:
            return Fit(reason=reason)
        occluders = depth if observed.dimension == 2 else None  # in a cloud a hidden end has no place in the image
        if prediction is None:
            found = self._fit_initial(observed, None, occluders)
        else:
            sigmas = _SIGMAS_STEADY if prediction.steady else _SIGMAS_AREA_CHANGED
            found = self._refine(
                known, prediction.nodes, prediction.topology, sigmas, MAX_HIDDEN, prediction, occluders
            )
            if not found.ok or size_jump(prediction, found.form):
                found = self._fit_initial(observed, prediction, occluders)
            elif _hidden(found) > sum(prediction.hints.hidden) + found.form.hints.slack:
                # Something came over an end, or the chain lost its way there: an initial axis decides.
                again = self._fit_initial(observed, prediction, occluders)
                found = again if again.ok and _hidden(again) < _hidden(found) else found
        if not found.ok:
            return found
        curve: FittedCurve = found.form
        if occluders is not None and _hidden(found) > curve.hints.slack:
            curve = uncover_ends(curve, occluders, observed.width)
        if prediction is None:
            curve = self.apply_index_order(curve, observed.seen(curve.points, target), target)
        assert found.topology is not None
        nodes = interpolate(curve.points, curve.arc, _middles(found.topology.size) * curve.size)
        seen_length = curve.size * (1 - curve.unsupported_fraction)
        width = observed.ribbon_width(seen_length) if observed.dimension == 2 else 0.0
        return found._replace(form=curve, nodes=nodes, width=width)

    def _fit_initial(self, observed: Observed, prediction: Prediction | None, depth: npt.NDArray[Any] | None) -> Fit:
        """Fit from an initial axis, in the predicted rope's direction if there is one."""
        axis = medial_axis(observed)
        if axis.ambiguity:
            return Fit(reason=axis.ambiguity)
        topology: Topology
        if prediction is None:
            topology = Chain(int(np.clip(round(observed.length / (_NODE_SPACING * observed.width)), *_NODES)))
        else:
            axis, topology = match_chain(axis, prediction, depth), prediction.topology
        start = axis.at(_middles(topology.size) * axis.size)
        bridged = axis.unsupported_fraction
        return self._refine(observed, start, topology, _SIGMAS_INITIAL, bridged, prediction, depth)

    def _refine(
        self,
        observed: Observed,
        start: Array,
        topology: Topology,
        sigmas: tuple[float, ...],
        expected_off: float,
        prediction: Prediction | None,
        depth: npt.NDArray[Any] | None,
    ) -> Fit:
        """Run the self-organising map from a start, finish the curve, match it to the track, validate it."""
        samples = observed.samples
        nodes = observed.extend_to_tips(run_som(samples, start, topology, sigmas))
        points = catmull_rom(nodes, 4, False)
        curve = FittedCurve(points, ~observed.carries(points))
        spread = sample_spread(np.ascontiguousarray(samples.points), np.ascontiguousarray(samples.weight), points)
        if prediction is not None:
            curve = match_chain(curve, prediction, depth)  # an end under a hand is put back here
        reason, quality = validate_ribbon(curve, observed, expected_off, spread)
        return Fit(curve, quality, reason, topology=topology, observed=observed)

    def apply_index_order(self, form: FittedCurve, seen: Array, target: Array | None) -> FittedCurve:
        """Return the curve with point 0 at the end nearest the target, else nearest the top left."""
        corner = np.zeros(seen.shape[1]) if target is None else target
        first, last = (float(np.sum((seen[end] - corner) ** 2)) for end in (0, -1))
        return form if first <= last else form.reversed()

    def resample(self, form: FittedCurve, metric: FittedCurve) -> Points:
        """Return points with equal chords, from tip to tip or at the centres of N pieces."""
        if any(form.hints.hidden):
            piece = shown(form)
            same = metric is form
            form = form.cut(piece)
            metric = form if same else metric.cut(piece)
        at = equidistant_positions(metric.points, metric.arc, self.n, centers=self.ends != "tips")
        along = at if metric is form else np.interp(at, metric.arc, form.arc)
        return Points(interpolate(form.points, form.arc, along), metric.interpolated_at(at))

    compiled: ClassVar[tuple[Any, ...]] = (
        arc_length,
        batch_epochs,
        catmull_rom,
        equal_chords,
        extend_chain,
        fold_outline,
        gather_cells,
        interpolate,
        sample_spread,
        undo_shrinkage,
        unexplained_share,
    )


def _hidden(found: Fit) -> float:
    """Return the length of a curve's hidden ends."""
    return sum(found.form.hints.hidden)


@lru_cache
def _middles(count: int) -> Array:
    """Return the middles of ``count`` equal pieces of 1."""
    return (np.arange(count) + 0.5) / count
