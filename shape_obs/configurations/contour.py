"""Contour: the outline of a cloth or any flat thing as N points, clockwise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Final, cast

import numpy as np
import numpy.typing as npt

from shape_obs.clustering.som import batch_epochs, run_som
from shape_obs.compiled import compiled
from shape_obs.configurations.base import Configuration, Points
from shape_obs.geometry.curve import FittedCurve, TrackHints
from shape_obs.geometry.observed import Observed, Samples
from shape_obs.geometry.outline import SAMPLED, clockwise, enclosed_by, material_outline
from shape_obs.geometry.polyline import MAX_SHIFT_AROUND, arc_length, catmull_rom, closed, equal_chords, interpolate
from shape_obs.geometry.topology import Ring, Topology, undo_shrinkage
from shape_obs.image.outline_tracing import trace_hole
from shape_obs.image.region import Region
from shape_obs.tracking.complete_lattice import look_around, rim_depth
from shape_obs.tracking.complete_ring import complete_outline, hidden_pieces, nearest_places, sticks_out
from shape_obs.tracking.measure_ring import MIN_SAMPLES, PIECES, fit_ring_in_mask
from shape_obs.tracking.model import RingModel
from shape_obs.tracking.predict import Fit, Prediction
from shape_obs.tracking.register_ring import begin_outline, follow_outline, match_outline, renumber_outline
from shape_obs.tracking.register_ring_in_space import blend_space, index_shift_space
from shape_obs.tracking.scene import Scene
from shape_obs.tracking.step import step_ring_in_mask
from shape_obs.tracking.validation import outline_miss, validate_outline

if TYPE_CHECKING:
    from shape_obs.point_cloud.cloud import Cloud

Array = npt.NDArray[np.float64]

_NODES: Final = (24, 192)  # at least and at most, for any n


@dataclass(frozen=True)
class Contour(Configuration, kind="contour"):
    """The outline of the largest piece, clockwise as seen in the image, its points equally far from their neighbours.

    Point 0 lies where the outline is nearest the anchor; without one, at its topmost-left point, which is where u + v
    is least.

    Args:
        n: How many points.
        hole: None for the outer outline; 0 for the outline of the largest hole, 1 for the next.
        ring: The object is a closed band. In images an outline that encloses no hole is then refused: something lies
            over the band, and what is seen is the outline of a part of it, inside and outside in one.
    """

    model: ClassVar[RingModel] = RingModel()

    n: int = 32
    hole: int | None = None
    ring: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 3 <= self.n <= 1000:
            raise ValueError(f"contour: n must lie in 3...1000, got {self.n}.")
        if self.hole is not None and self.hole < 0:
            raise ValueError(f"contour: hole must be None or >= 0, got {self.hole}.")

    @cached_property
    def layout(self) -> Ring:
        """A ring of n points."""
        return Ring(self.n)

    def fit(self, observed: Observed, prediction: Prediction | None, target: Array | None, scene: Scene) -> Fit:
        """Fit a ring of nodes to this frame's own outline; number it as the track does, or by the paper's rule."""
        region = observed if isinstance(observed, Region) and self.hole is None else None
        if prediction is not None and region is not None:
            found = self._follow(region, prediction, scene)
            if found is not None:
                return found
        reason = self._rejection_reason(observed)
        if reason:
            return Fit(reason=reason)
        width = observed.width if observed.dimension == 2 else 0.0
        if prediction is None:
            outline = observed.outline_curve(self.hole)
            topology = self._topology(observed, outline)
            curve, miss = self._run_som(observed, outline.points[0], topology)
            curve = self.apply_index_order(curve, observed.seen(curve.points, target), target)
            nodes, (reason, quality) = curve.even(topology.size), validate_outline(observed, miss, self.model)
            space, _ = self._lift(observed, curve.points, scene)
            if space is not None:
                curve, nodes = _begun_at(curve, space, 0.0, topology.size, None)
        else:
            topology = prediction.track.topology
            curve, nodes, miss = self._track(observed, prediction.nodes[0], prediction, scene)
            reason, quality = validate_outline(observed, miss, self.model)
            if reason or abs(curve.arc[-1] / prediction.track.size - 1) > self.model.max_size_change:
                outline = observed.outline_curve(self.hole)
                start = match_outline(outline, prediction, self.model)[0].points[0]
                curve, nodes, miss = self._track(observed, start, prediction, scene)
                reason, quality = validate_outline(observed, miss, self.model)
        return Fit(curve, quality, reason, nodes, topology, width, observed, width)

    def _follow(self, region: Region, prediction: Prediction, scene: Scene) -> Fit | None:
        """Fit the outline of a region that looks as it did; None if that is to be looked at more closely."""
        known, (own, around) = prediction.track.hints.reference, scene.around(region)
        if known is None:
            return None
        followed, curve, space, arc, nodes, known, turning, miss, width = step_ring_in_mask(
            *own, *around, region.areas[0], prediction.nodes, known, prediction.lasted, self.ring,
            self.model.record, self.model.depth_limits,
        )  # fmt: skip
        if not followed:
            return None
        reason, quality = validate_outline(region, miss, self.model)
        if reason or abs(arc[-1] / prediction.track.size - 1) > self.model.max_size_change:
            return None
        form = FittedCurve(
            curve, np.zeros(len(curve), bool), arc, True, space=space if len(space) else None,
            hints=TrackHints(reference=known, turning=turning),
        )  # fmt: skip
        return Fit(form, quality, "", nodes, prediction.track.topology, width, region, width)

    def _track(
        self, observed: Observed, start: Array, prediction: Prediction, scene: Scene
    ) -> tuple[FittedCurve, Array, float]:
        """Run the self-organising map from a start and renumber the curve from where it began before.

        With depth the curve is numbered by its form in space; where something lies over it, by what is seen of it.
        """
        curve, miss = self._run_som(observed, start, prediction.track.topology)
        space, cut = self._lift(observed, curve.points, scene)
        if not isinstance(observed, Region):
            return *match_outline(curve, prediction, self.model), miss
        known = prediction.track.hints.reference
        in_space = known is not None and known.shape[1] == 3
        if in_space and space is None:  # numbered by its place in the image, if all of it is seen
            forgotten = prediction._replace(track=prediction.track._replace(hints=TrackHints()))
            found, nodes = match_outline(curve, forgotten, self.model)
            return replace(found, hints=TrackHints(reference=known)), nodes, np.inf if cut.any() else miss
        own, laid = space if in_space else None, known
        found, nodes = curve, prediction.nodes
        if not cut.any() and own is None:
            found, nodes = match_outline(curve, prediction, self.model)
        if laid is not None and own is None and not cut.any():
            cut, laid = hidden_pieces(curve.points, curve.arc, nodes, laid, prediction.nodes, self.model.record)
        if cut.any() and laid is not None:
            lifted = curve if own is None else FittedCurve.through(own, np.zeros(len(own), bool), True)
            whole = complete_outline(curve, lifted, cut, laid, prediction.nodes, self.model)
            if whole is None:
                return curve, prediction.nodes, np.inf
            completed, begin = whole
            camera, there = scene.intrinsics, completed.points
            pixels = there if own is None or camera is None else camera.project(there)
            hidden = pixels[completed.interpolated]
            if own is None or sticks_out(hidden, curve.points, self.model.inside):
                curve = FittedCurve.through(pixels, np.zeros(len(pixels), bool), True)
                return *_begun_at(curve, there, begin, len(nodes), known), miss
        if own is not None:
            points, there, arc, nodes, new, turning, _ = follow_outline(
                curve.points, own, prediction.reference, nodes, prediction.lasted, self.model.record
            )
            found = FittedCurve(points, np.zeros(len(points), bool), arc, True, space=there)
            reference = known if cut.any() else new  # what touches it may hide a little of it
            found = replace(found, hints=TrackHints(reference=reference, turning=turning))
        if own is None and space is not None:
            near = int(np.argmin(((curve.points - nodes[0]) ** 2).sum(axis=1)))
            found, nodes = _begun_at(
                curve, space, float(FittedCurve.through(space, curve.interpolated, True).arc[near]), len(nodes), None
            )
        return found, nodes, miss

    def _lift(self, region: Observed, points: Array, scene: Scene) -> tuple[Array | None, npt.NDArray[np.bool_]]:
        """Return an outline ``(P, 2)`` in metres, None without depth, and where something lies over it, ``(P,)``."""
        if not isinstance(region, Region) or self.hole is not None:
            return None, np.zeros(len(points), bool)
        return look_around(region, points, scene.images, scene.intrinsics, scene.edge, self.model.depth_limits)

    def _run_som(self, observed: Observed, start: Array, topology: Topology) -> tuple[FittedCurve, float]:
        """Run the self-organising map on the outline from its place nearest to ``start``; return curve and miss."""
        sigma = self.model.sigma
        if isinstance(observed, Region):
            traced = observed.traced_outline(self.hole)
            points, miss = fit_ring_in_mask(traced.traced, traced.hole, start, topology.size, sigma)
        else:
            samples, outline = cast("Cloud", observed).outline_samples(), observed.outline_curve()
            nearest = np.argmin(np.sum((outline.points - start) ** 2, axis=1))
            begin = outline.starting_at(float(outline.arc[nearest])).even(topology.size)
            points = catmull_rom(run_som(samples, begin, topology, (sigma,)), PIECES, True)
            miss = outline_miss(samples.points, points) / samples.scale
        return FittedCurve.through(points, np.zeros(len(points), bool), True), miss

    def _topology(self, observed: Observed, outline: FittedCurve) -> Ring:
        """Return a ring with a node every three samples, 24 to 192 of them; closer on what is thin."""
        spacing = self.model.node_spacing * (SAMPLED if observed.dimension == 2 else outline.size / len(outline.points))
        if observed.dimension == 2 and self.hole is None:
            spacing = min(spacing, self.model.max_spacing * observed.width)
        return Ring(int(np.clip(round(outline.size / spacing), *_NODES)))

    def _rejection_reason(self, observed: Observed) -> str:
        """Return why an object has no such outline: no such hole, a few pixels, or two sides too close together."""
        region = observed if isinstance(observed, Region) else None
        holes = 0 if region is None or self.hole is None else len(region.holes)
        if self.hole is not None and self.hole >= holes:
            return f"hole {self.hole} was asked for, the {observed.noun} has {holes}"
        if region is None:
            count = len(observed.outline_curve().points)
        else:
            count = -(-len(region.traced_outline(self.hole).traced) // SAMPLED)
            if self.ring and region.hollow_share < self.model.min_hollow:
                return "the mask encloses no hole: something lies over the ring, or it is open"
        if count < MIN_SAMPLES:
            return f"the outline is too small: {count} samples, at least {MIN_SAMPLES} are needed"
        least = self.model.min_width * SAMPLED
        if region is not None and self.hole is None and region.width < least:
            thin = f"too thin for an outline (at least {least:.2g})"
            return f"the mask is {region.width:.2g} px wide: {thin}"
        return ""

    def apply_index_order(self, form: FittedCurve, seen: Array, target: Array | None) -> FittedCurve:
        """Return the curve clockwise as seen, from the place nearest the target, else from the least u + v."""
        if not clockwise(seen):
            form, seen = form.reversed(), np.roll(seen[::-1], 1, axis=0)
        far = seen[:, 0] + seen[:, 1] if target is None else np.sum((seen - target) ** 2, axis=1)
        return form.starting_at(_least(far, form))

    def resample(self, form: FittedCurve, metric: FittedCurve) -> Points:
        """Return points with equal chords around, from the form's first point; in space along the form there."""
        there = metric.points if self.spacing == "px" or form.space is None else form.space
        places = points_around(form.points, form.arc, there, self.n)
        return Points(places, np.zeros(self.n, bool))

    def clusterer_samples(self, observed: Observed) -> Samples:
        """Return every pixel that the outline runs through; around a cloud, points at equal distances."""
        return observed.outline_points(self.hole)

    @property
    def compiled_functions(self) -> tuple[Any, ...]:
        """The compiled functions that a fit may call."""
        masks = (
            step_ring_in_mask,
            follow_outline,
            fit_ring_in_mask,
            enclosed_by,
            rim_depth,
            points_around,
            renumber_outline,
        )
        masks += begin_outline, hidden_pieces, nearest_places, trace_hole, material_outline
        masks += index_shift_space, blend_space
        clouds = arc_length, batch_epochs, catmull_rom, interpolate, undo_shrinkage
        return masks + clouds


def _least(values: Array, form: FittedCurve) -> float:
    """Return the arc position of the least of ``(P,)`` values, by a parabola through it and its neighbours."""
    at = int(np.argmin(values))
    before, after = form.arc[at] - form.arc[at - 1] if at else form.arc[-1] - form.arc[-2], np.diff(form.arc)[at]
    fall, rise = (values[at - 1] - values[at]) / before, (values[(at + 1) % len(values)] - values[at]) / after
    bend = fall + rise
    shift = (fall * after - rise * before) / (2 * bend) if bend > 0 else 0.0
    return float(form.arc[at] + np.clip(shift, -before, after))


def _begun_at(
    curve: FittedCurve, space: Array, begin: float, count: int, reference: Array | None
) -> tuple[FittedCurve, Array]:
    """Return a curve from an arc position in space on, and its ``count`` nodes, equally spaced there.

    Args:
        curve: ``(P, 2)`` pixels.
        space: ``(P, D)`` the same in metres.
        begin: Metres along it.
        count: How many nodes.
        reference: ``(count, D)`` what is known of its form; None if nothing is.
    """
    points, there, arc, nodes, places = begin_outline(curve.points, np.ascontiguousarray(space), begin, count)
    hints = TrackHints(reference=places if reference is None else reference)
    known = there if there.shape[1] == 3 else None
    return FittedCurve(points, np.zeros(len(points), bool), arc, True, space=known, hints=hints), nodes


@compiled("(f8[:,::1], f8[::1], f8[:,::1], i8)")
def points_around(points: Array, arc: Array, metric: Array, count: int) -> Array:
    """Return ``count`` points of a closed curve with equal chords in a metric, from its first point."""
    around = closed(metric)
    places, _ = equal_chords(closed(points), arc, around, arc_length(around), count + 1, 0.0, MAX_SHIFT_AROUND)
    return places[:count]
