"""Centerline: a rope or cable as N points from one end to the other along its axis."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Final, cast

import numpy as np
import numpy.typing as npt

from shape_obs.clustering.som import batch_epochs, run_som
from shape_obs.compiled import compiled
from shape_obs.configurations.base import Configuration, Ends, Points, Scene
from shape_obs.configurations.chain_in_mask import (
    fit_chain_in_mask,
    gather_lifted_cells,
    lifted_samples,
    measured_curve,
    rims_of,
)
from shape_obs.geometry.curve import FittedCurve, Length, TrackHints, local_stretch, nearest_along
from shape_obs.geometry.observed import Observed
from shape_obs.geometry.polyline import MAX_SHIFT, arc_length, catmull_rom, equal_chords, even_points, interpolate
from shape_obs.geometry.topology import Chain, Topology, neighbourhoods, shrinkage, undo_shrinkage
from shape_obs.image.connected_runs import gather_cells
from shape_obs.image.outline_tracing import fill_holes
from shape_obs.image.region import Region
from shape_obs.initialization.folding import closest_sides, sharp_bends, unexplained_share
from shape_obs.initialization.gaps import cheapest_order
from shape_obs.initialization.medial_axis import medial_axis
from shape_obs.initialization.skeleton import thinned, trace_skeleton
from shape_obs.point_cloud.chain_length import lift_chain, strand_gap
from shape_obs.point_cloud.lifting import nearest_expected
from shape_obs.tracking.occluders import blended_tips, chain_evidence, likelier_cut
from shape_obs.tracking.occlusion import evened, is_whole, match_chain, shown, surprise
from shape_obs.tracking.predicted_rope import disagreements, visible_nodes
from shape_obs.tracking.prediction import MAX_SIZE_CHANGE, Fit, Prediction
from shape_obs.tracking.rope_length import learnt
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
_NODES: Final = (6, 128)
# Width of the map's neighbourhood in each epoch, node units. If a part of the rope was hidden in the last frame, what
# comes back has no node near it.
_SIGMAS_INITIAL: Final = (0.8, 0.4, 0.4)
_SIGMAS_STEADY: Final = (0.8, 0.4)
_SIGMAS_AREA_CHANGED: Final = (1.2, 0.6, 0.4, 0.4)
_MAX_CELL: Final = 24  # pixels
_MAX_CELLS: Final = 4096  # about; more change nothing and cost time
# The cost of joining pieces grows with the cube of their number, and a rope does not fall into that many.
_MAX_PIECES: Final = 16
_MIN_STRETCH: Final = 0.97  # a curve that became longer than the rope follows something else
_MIN_SEEN: Final = 0.3  # of a rope's length: what has to be in sight to report it, and below, to follow it
_MIN_IN_PIECES: Final = 0.45  # around a gap of a tenth of it: a piece behind a long gap may be anywhere
_GAP: Final = 0.1
_MIN_BETWEEN: Final = 0.6  # while both ends are hidden
_ADRIFT: Final = 0.02  # of its length: by so much a rope may have slid along itself unseen
_MIN_FOLLOWED: Final = 0.15
# With depth: how much longer the free tip may be in space than in the image, or another piece by this share of it, so
# that the length in sight shows how much lies beyond a hidden end; and by how many measuring errors a rope with free
# ends may be too short. Chosen from 4,800 frames of swung ropes and 7,900 under shadows, exact depth and a D455's.
_ASLANT: Final = 2.7
_ELSEWHERE: Final = 0.45
_SHORTER: Final = 1.4
_SHORT: Final = 2.5  # standard deviations of its length, at least: a far rope with noise varies more
_END_ON: Final = 4.0  # a rope is this much longer in space than in the image: its points cannot be told apart there
_MIN_ASPECT: Final = 3.0  # length over width; what is stouter has no distinct axis, and a chain would fold up in it


@dataclass(frozen=True)
class Centerline(Configuration, kind="centerline"):
    """A rope's axis.

    Args:
        n: How many points.
        ends: ``"centers"``: the points are centres of N equal pieces, as cluster centres are; ``"tips"``: the first
            and last point lie on the rope's real tips. None takes the detector's.
        length: The rope's length in metres, from tip to tip, if it is known; None lets the track learn it. It belongs
            to the scene: it is not hashed, and a policy takes a rope of another length.
    """

    resumes: ClassVar[bool] = True

    n: int = 20
    ends: Ends | None = None
    length: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 2 <= self.n <= 1000:
            raise ValueError(f"centerline: n must lie in 2...1000, got {self.n}.")
        if self.length is not None and not 0 < self.length < np.inf:
            raise ValueError(f"centerline: length must be above 0 metres, or None if unknown, got {self.length}.")

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
        if prediction is None:
            found = self._fit_initial(observed, None, scene)
        else:
            sigmas = _SIGMAS_STEADY if prediction.steady else _SIGMAS_AREA_CHANGED
            start = visible_nodes(prediction)
            found = self._refine(observed, start, Chain(len(start)), sigmas, width, MAX_HIDDEN, prediction, scene)
            off = np.inf if found.reason else surprise(found.form, prediction)
            if off > MAX_SIZE_CHANGE:  # of another length, or the chain lost its way: an initial axis decides
                again = self._fit_initial(observed, prediction, scene)
                better = not again.reason and (surprise(again.form, prediction) <= off or is_whole(again.form))
                found = again if better else found
        if found.reason:
            return found
        curve: FittedCurve = found.form
        if _begins_again(curve, prediction):
            curve = self.apply_index_order(curve, observed.seen(curve.points, target), target)
        topology = found.topology if prediction is None else prediction.topology
        assert topology is not None
        nodes = _nodes_on(curve.lifted, curve.stations, topology.size)
        nodes, relief = (nodes, None) if curve.relief is None else (nodes[:, :2].copy(), nodes[:, 2].copy())
        seen_width = max(observed.area / max(_seen_length(curve), 1e-9), 1.0) if observed.dimension == 2 else 0.0
        seen = 1 - curve.unsupported_fraction
        least = _MIN_IN_PIECES if 1 - seen - sum(curve.hints.hidden) > _GAP else _MIN_SEEN
        reason = "" if seen >= least else f"{seen:.0%} of the rope is in sight (at least {least:.0%})"
        if not reason and seen < _MIN_BETWEEN and all(curve.hints.covered):
            reason = f"both ends are hidden, and {seen:.0%} of the rope is in sight (at least {_MIN_BETWEEN:.0%})"
        if not reason and curve.hints.adrift > _ADRIFT:
            reason = f"a piece without an end in sight may have slid by {curve.hints.adrift:.1%} of the rope's length"
        follow, steep = seen >= _MIN_FOLLOWED, arc_length(curve.lifted)[-1] / max(curve.size, 1e-9)
        if not reason and steep > _END_ON:
            reason, follow = f"it is seen end-on, {steep:.2g} times as long as in the image (at most {_END_ON})", False
        if not reason and curve.metres is not None:
            reason = _doubt_in_space(curve, found.object_width)
        fit = found._replace(form=curve, nodes=nodes, topology=topology, size=float(curve.arc[-1]), width=seen_width)
        fit = fit._replace(relief=relief, length=curve.hints.length.metres or fit.length)
        return fit._replace(reason=reason, follow=follow)

    def _fit_initial(self, observed: Observed, prediction: Prediction | None, scene: Scene) -> Fit:
        """Fit from an initial axis."""
        axis = medial_axis(observed)
        if axis.ambiguity:
            return Fit(reason=axis.ambiguity)
        topology = Chain(int(np.clip(round(observed.length / (_NODE_SPACING * observed.width)), *_NODES)))
        start = _nodes_on(axis.points, axis.arc, topology.size)
        off = axis.unsupported_fraction if prediction is None else MAX_HIDDEN
        return self._refine(observed, start, topology, _SIGMAS_INITIAL, observed.width, off, prediction, scene)

    def _refine(
        self,
        observed: Observed,
        start: Array,
        topology: Topology,
        sigmas: tuple[float, ...],
        width: float,
        expected_off: float,
        prediction: Prediction | None,
        scene: Scene,
    ) -> Fit:
        """Run the self-organising map from a start, finish the curve, match it to the track, validate it."""
        if isinstance(observed, Region):
            cell = max(
                int(min(width / 3, _MAX_CELL)), math.isqrt(observed.area // _MAX_CELLS), 1
            )  # thin ropes keep theirs
            (first, second), pull = neighbourhoods(topology, sigmas), shrinkage(sigmas[-1])
            start, samples = lifted_samples(observed, start, cell, width, scene)
            lifted, arc, on_object, spread = fit_chain_in_mask(
                *samples, start, (first, second), pull, observed.mask, observed.window[:2], width
            )
            points, relief = (lifted, None) if start.shape[1] == 2 else (lifted[:, :2].copy(), lifted[:, 2].copy())
            square, area = spread + min(cell, width) ** 2 / 12, observed.area
        else:
            cloud = cast("Cloud", observed)
            samples = cloud.samples
            nodes = cloud.extend_to_tips(run_som(samples, start, topology, sigmas))
            points = catmull_rom(nodes, 4, False)
            arc, on_object = arc_length(points), cloud.carries(points)
            spread = sample_spread(np.ascontiguousarray(samples.points), np.ascontiguousarray(samples.weight), points)
            square = spread + cloud.hidden_variance
            width, area, relief = cloud.ribbon_width, 0, None
        before = TrackHints() if prediction is None else prediction.hints
        curve = FittedCurve(points, ~on_object, arc, relief=relief)
        curve, tips = measured_curve(curve, observed, width, scene)  # depth enters
        if prediction is None:
            known = learnt(Length(metres=self.length or 0.0), curve, tips.known)
            curve = replace(curve, hints=TrackHints(length=known, tips=tips.remembered(None, 0)))
        else:
            curve = match_chain(curve, prediction, tips)  # an end under a hand is put back here
        reason, quality = validate_ribbon(curve, observed.noun, expected_off, square, width, area)
        stretch = max(curve.hints.stretch, 1e-9)
        grown = curve.metres is not None and curve.hints.measured * _MIN_STRETCH > before.measured > 0
        if not reason and grown and stretch < _MIN_STRETCH:
            reason = f"the curve is {1 / stretch - 1:.0%} longer than the rope"
        if curve.ambiguity and not _begins_again(curve, prediction):
            reason = reason or curve.ambiguity
        return Fit(curve, quality, reason, start, topology, observed=observed, object_width=width)

    def apply_index_order(self, form: FittedCurve, seen: Array, target: Array | None) -> FittedCurve:
        """Return the curve with point 0 at the end nearest the target, else nearest the top left."""
        corner = np.zeros(seen.shape[1]) if target is None else target
        first, last = (float(np.sum((seen[end] - corner) ** 2)) for end in (0, -1))
        return form if first <= last else form.reversed()

    def resample(self, form: FittedCurve, metric: FittedCurve) -> Points:
        """Return points with equal chords, from tip to tip or at the centres of N pieces."""
        first = 0
        if any(form.hints.hidden):
            piece, same = shown(form), metric is form
            form, first = form.cut(piece), piece.start
            metric = form if same else metric.cut(piece)
        along = form.metres if self.spacing == "m" and form.metres is not None else form.pixels
        if along is not None:
            share = np.linspace(0, 1, self.n) if self.ends == "tips" else (np.arange(self.n) + 0.5) / self.n
            at = interpolate(form.arc[:, None], np.ascontiguousarray(along), share * along[-1])[:, 0]
            return Points(form.at(at), form.interpolated_at(at), first + form.nearest_to(at), form.relief_at(at))
        margin = 0.0 if self.ends == "tips" else metric.arc[-1] / (2 * self.n)
        places, at = _points_on(form.points, form.arc, metric.points, metric.arc, self.n, margin)
        interpolated = metric.interpolated_at(at) if metric.interpolated.any() else np.zeros(self.n, bool)
        relief = None if form.relief is None else replace(form, arc=metric.arc).relief_at(at)
        return Points(places, interpolated, first + metric.nearest_to(at), relief)

    @property
    def compiled_functions(self) -> tuple[Any, ...]:
        """The compiled functions that a fit may call."""
        masks = gather_cells, gather_lifted_cells, fit_chain_in_mask, _points_on, _nodes_on
        masks += lift_chain, strand_gap, nearest_expected, chain_evidence, closest_sides, sharp_bends, unexplained_share
        masks += rims_of, likelier_cut, blended_tips, disagreements, evened, local_stretch, nearest_along
        axes = fill_holes, thinned, trace_skeleton, cheapest_order
        clouds = arc_length, batch_epochs, catmull_rom, interpolate, sample_spread, undo_shrinkage
        return masks + axes + clouds


def _rejection_reason(observed: Observed, width: float) -> str:
    """Return why an object cannot be a rope: too many pieces, or less than three times as long as wide."""
    for part in (observed,) if observed.dimension == 2 else observed.parts:
        if part.pieces > _MAX_PIECES:
            return f"the {part.noun} falls into {part.pieces} pieces, at most {_MAX_PIECES}"
    length = observed.area / width if observed.dimension == 2 else observed.length
    if length < _MIN_ASPECT * width:
        return f"the {observed.noun} is {length:.4g} x {width:.4g} {observed.unit}: too stout for a rope"
    return ""


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


def _doubt_in_space(curve: FittedCurve, width: float) -> str:
    """Return why the points of a rope may lie elsewhere along a curve that was found in space; empty if they do not."""
    hints = curve.hints
    if hints.stretch > 1 + max(_SHORTER * hints.slack, _SHORT * hints.length.spread_metres):
        return f"the curve is {1 - 1 / hints.stretch:.1%} shorter than the rope, and nothing is seen to hide an end"
    if hints.covered[0] == hints.covered[1]:
        return ""
    steep = curve.steepness(width / 2)
    aslant = max(float(steep[0 if hints.covered[1] else -1]), _ELSEWHERE * float(steep.max()))
    if aslant > _ASLANT:
        return f"an end is hidden, and the rope is {aslant:.2g} times as long as it looks (at most {_ASLANT})"
    return ""


def _begins_again(curve: FittedCurve, prediction: Prediction | None) -> bool:
    """Return whether a rope is numbered by the paper's rule: at a cold start, or as a whole after a long loss."""
    return prediction is None or (prediction.stale and max(curve.hints.hidden) <= curve.hints.slack)


def _seen_length(curve: FittedCurve) -> float:
    """Return the arc length of a curve without what is interpolated."""
    missing = curve.unsupported_fraction if curve.interpolated.any() else 0.0
    return float(curve.arc[-1]) * (1 - missing)
