"""Centerline: a rope or cable as N points from one end to the other along its axis."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np
import numpy.typing as npt

from shape_obs.clustering.som import batch_epochs, run_som
from shape_obs.compiled import compiled
from shape_obs.configurations.base import Configuration, Ends, Points, Scene
from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.observed import Observed
from shape_obs.geometry.polyline import MAX_SHIFT, arc_length, catmull_rom, equal_chords, even_points, interpolate
from shape_obs.geometry.topology import Chain, Topology, neighbourhoods, shrinkage, undo_shrinkage
from shape_obs.image.connected_runs import gather_cells, near_mask
from shape_obs.image.region import Region
from shape_obs.image.rope_tip import extend_chain
from shape_obs.initialization.folding import closest_sides, sharp_bends, unexplained_share
from shape_obs.initialization.medial_axis import medial_axis
from shape_obs.tracking.occluders import uncover_ends
from shape_obs.tracking.occlusion import match_chain, shown
from shape_obs.tracking.prediction import MAX_SIZE_CHANGE, Fit, Prediction
from shape_obs.tracking.validation import MAX_HIDDEN, sample_spread, validate_ribbon

if TYPE_CHECKING:
    from shape_obs.point_cloud.cloud import Cloud

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.uint8]
Moments = tuple[Array, Array]

# Nodes sit about this many widths apart: closer, and a chain starts to fold across the rope; farther, and it cuts
# corners. N is sampled from the curve afterwards, so it does not matter here.
_NODE_SPACING: Final = 1.4
_NODES: Final = (6, 48)
# Width of the map's neighbourhood in each epoch, node units. If a part of the rope was hidden in the last frame, what
# comes back has no node near it.
_SIGMAS_INITIAL: Final = (0.8, 0.4, 0.4)
_SIGMAS_STEADY: Final = (0.8, 0.4)
_SIGMAS_AREA_CHANGED: Final = (1.2, 0.6, 0.4, 0.4)
_MAX_CELL: Final = 24  # pixels
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

    @cached_property
    def layout(self) -> Chain:
        """A chain of n points."""
        return Chain(self.n)

    def fit(self, observed: Observed, prediction: Prediction | None, target: Array | None, scene: Scene) -> Fit:
        """Fit a chain of nodes: from where the track expects it, else along an initial axis."""
        width = prediction.width if prediction is not None and prediction.width else observed.width
        reason = _rejection_reason(observed, width)
        if reason:
            return Fit(reason=reason)
        # In a cloud a hidden end has no place in the image.
        occluders = scene.depth if observed.dimension == 2 else None
        if prediction is None:
            found = self._fit_initial(observed, None, occluders)
        else:
            sigmas = _SIGMAS_STEADY if prediction.steady else _SIGMAS_AREA_CHANGED
            start = prediction.nodes, prediction.topology
            found = self._refine(observed, *start, sigmas, width, MAX_HIDDEN, prediction, occluders)
            curve: FittedCurve = found.form
            if found.reason or abs(curve.arc[-1] / prediction.size - 1) > MAX_SIZE_CHANGE:
                found = self._fit_initial(observed, prediction, occluders)
            elif sum(curve.hints.hidden) > sum(prediction.hints.hidden) + curve.hints.slack:
                # Something came over an end, or the chain lost its way there: an initial axis decides.
                again = self._fit_initial(observed, prediction, occluders)
                found = again if not again.reason and _hidden(again) < _hidden(found) else found
        if found.reason:
            return found
        curve = found.form
        if occluders is not None and _hidden(found) > curve.hints.slack:
            curve = uncover_ends(curve, occluders, observed.width)
        if prediction is None:
            curve = self.apply_index_order(curve, observed.seen(curve.points, target), target)
        assert found.nodes is not None
        nodes = _nodes_on(curve.points, curve.arc, len(found.nodes))
        seen_width = max(observed.area / max(_seen_length(curve), 1e-9), 1.0) if observed.dimension == 2 else 0.0
        size = curve.hints.size or float(curve.arc[-1])
        return found._replace(form=curve, nodes=nodes, size=size, width=seen_width)

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
        start, bridged = _nodes_on(axis.points, axis.arc, topology.size), axis.unsupported_fraction
        return self._refine(observed, start, topology, _SIGMAS_INITIAL, observed.width, bridged, prediction, depth)

    def _refine(
        self,
        observed: Observed,
        start: Array,
        topology: Topology,
        sigmas: tuple[float, ...],
        width: float,
        expected_off: float,
        prediction: Prediction | None,
        depth: npt.NDArray[Any] | None,
    ) -> Fit:
        """Run the self-organising map from a start, finish the curve, match it to the track, validate it."""
        if isinstance(observed, Region):
            cell = max(int(min(width / 3, _MAX_CELL)), 1)  # thin ropes keep their pixels
            (first, second), pull = neighbourhoods(topology, sigmas), shrinkage(sigmas[-1])
            points, arc, on_object, spread = fit_chain_in_mask(
                observed.runs, cell, start, (first, second), pull, observed.mask, observed.window[:2], width
            )
            square, area = spread + min(cell, width) ** 2 / 12, observed.area
        else:
            cloud = cast("Cloud", observed)
            samples = cloud.samples
            nodes = cloud.extend_to_tips(run_som(samples, start, topology, sigmas))
            points = catmull_rom(nodes, 4, False)
            arc, on_object = arc_length(points), cloud.carries(points)
            spread = sample_spread(np.ascontiguousarray(samples.points), np.ascontiguousarray(samples.weight), points)
            square = spread + cloud.hidden_variance
            width, area = cloud.ribbon_width, 0
        curve = FittedCurve(points, ~on_object, arc)
        if prediction is not None:
            curve = match_chain(curve, prediction, depth)  # an end under a hand is put back here
        reason, quality = validate_ribbon(curve, observed.noun, expected_off, square, width, area)
        return Fit(curve, quality, reason, start, topology, observed=observed, object_width=width)

    def apply_index_order(self, form: FittedCurve, seen: Array, target: Array | None) -> FittedCurve:
        """Return the curve with point 0 at the end nearest the target, else nearest the top left."""
        corner = np.zeros(seen.shape[1]) if target is None else target
        first, last = (float(np.sum((seen[end] - corner) ** 2)) for end in (0, -1))
        return form if first <= last else form.reversed()

    def resample(self, form: FittedCurve, metric: FittedCurve) -> Points:
        """Return points with equal chords, from tip to tip or at the centres of N pieces."""
        if any(form.hints.hidden):
            piece, same = shown(form), metric is form
            form = form.cut(piece)
            metric = form if same else metric.cut(piece)
        margin = 0.0 if self.ends == "tips" else metric.arc[-1] / (2 * self.n)
        places, at = _points_on(form.points, form.arc, metric.points, metric.arc, self.n, margin)
        interpolated = metric.interpolated_at(at) if metric.interpolated.any() else np.zeros(self.n, bool)
        return Points(places, interpolated)

    @property
    def compiled_functions(self) -> tuple[Any, ...]:
        """The compiled functions that a fit may call."""
        masks = fit_chain_in_mask, _points_on, _nodes_on, closest_sides, sharp_bends, unexplained_share
        clouds = arc_length, batch_epochs, catmull_rom, interpolate, sample_spread, undo_shrinkage
        return masks + clouds


def _rejection_reason(observed: Observed, width: float) -> str:
    """Return why an object cannot be a rope: too many pieces, or less than three times as long as wide."""
    for part in (observed,) if observed.dimension == 2 else observed.parts:
        if part.pieces > _MAX_PIECES:
            return f"the {part.noun} falls into {part.pieces} pieces, at most {_MAX_PIECES}"
    length = observed.area / width if observed.dimension == 2 else observed.length
    if length < _MIN_ASPECT * width:
        return f"the {observed.noun} is {length:.4g} x {width:.4g} {observed.unit}: too stout for a rope"
    return ""


@compiled("(i8[:,::1], i8, f8[:,::1], Tuple((f8[:,:,:,::1], f8[:,:,:,:,::1])), f8, u1[:,::1], UniTuple(i8, 2), f8)")
def fit_chain_in_mask(
    runs: Indices, cell: int, start: Array, moments: Moments, pull: float, mask: Mask, at: tuple[int, int], width: float
) -> tuple[Array, Array, npt.NDArray[np.bool_], float]:
    """Run the self-organising map of a chain in a mask and finish its curve, all in one call.

    Args:
        runs: ``(R, 3)`` the mask's runs.
        cell: Edge of the squares that pixels are gathered into, pixels.
        start: ``(K, 2)`` nodes.
        moments: Of the neighbourhood, see ``topology.Neighbourhoods``.
        pull: How far averaging pulls the nodes, see ``topology.shrinkage``.
        mask: ``(h, w)`` uint8, C-contiguous.
        at: Image column and row of its first pixel.
        width: The rope's width, pixels.

    Returns:
        ``(P, 2)`` the curve from tip to tip, pixels; its arc length ``(P,)``; whether the mask has a pixel there
        ``(P,)``; the mean square distance of the pixels from it.
    """
    (left, top), (points, weight) = at, gather_cells(runs, cell)
    nodes = undo_shrinkage(batch_epochs(points, weight, start, moments[0], moments[1]), pull, False)
    curve = catmull_rom(extend_chain(nodes, mask, left, top, width), 4, False)
    return curve, arc_length(curve), near_mask(mask, left, top, curve, 1), sample_spread(points, weight, curve)


@compiled("(f8[:,::1], f8[::1], f8[:,::1], f8[::1], i8, f8)")
def _points_on(
    points: Array, arc: Array, metric: Array, metric_arc: Array, count: int, margin: float
) -> tuple[Array, Array]:
    """Return ``count`` points of a curve with equal chords in a metric, and their arc positions there."""
    return equal_chords(points, arc, metric, metric_arc, count, margin, MAX_SHIFT)


@compiled("(f8[:,::1], f8[::1], i8)")
def _nodes_on(points: Array, arc: Array, count: int) -> Array:
    """Return the middles of ``count`` equal pieces of a curve."""
    return even_points(points, arc, count, True)


def _hidden(found: Fit) -> float:
    """Return the length of a curve's hidden ends."""
    return sum(found.form.hints.hidden)


def _seen_length(curve: FittedCurve) -> float:
    """Return the arc length of a curve without what is interpolated."""
    missing = curve.unsupported_fraction if curve.interpolated.any() else 0.0
    return float(curve.arc[-1]) * (1 - missing)
