"""Contour: the outline of a cloth or any flat thing as N points, clockwise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from shape_obs.clustering.som import batch_epochs, run_ring_som, run_som
from shape_obs.configurations.base import Configuration, Points
from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.observed import Observed
from shape_obs.geometry.outline import clockwise, material_outline, pairs
from shape_obs.geometry.polyline import arc_length, catmull_rom, equal_chords, equidistant_around, interpolate
from shape_obs.geometry.samples import Samples
from shape_obs.geometry.topology import Ring, Topology, undo_shrinkage
from shape_obs.tracking.prediction import Fit, Prediction, size_jump
from shape_obs.tracking.registration import match_outline, renumber_outline
from shape_obs.tracking.validation import outline_miss, ring_miss, validate_outline

Array = npt.NDArray[np.float64]

# Samples from node to node, whatever N is: 6 px. Closer, and the nodes follow the pixels (at 4 px they jitter by a
# sixth more); farther, and they cut corners (at 8 px garments lie 0.16 px off instead of 0.13).
_NODE_SPACING: Final = 3.0
_THIN: Final = 1.5  # widths from node to node at most: farther, and a node's samples are those of the other side too
_NODES: Final = (24, 192)
# Width of the map's neighbourhood, nodes. One epoch: the start lies on the outline, and further ones change nothing.
_SIGMA: Final = 0.4
_PIECES: Final = 4  # of the curve between two nodes
_HOLLOW: Final = 0.05  # of what the outline encloses; drawn shapes without a hole have at most 0.01
_MIN_SAMPLES: Final = 8  # a ring of 16 pixels, as few as an object may have
_MIN_WIDTH: Final = 1.25  # in samples: of outlines of 2 px, one in three has its two sides mixed up; of 3 px, none


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

    n: int = 32
    hole: int | None = None
    ring: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 3 <= self.n <= 1000:
            raise ValueError(f"contour: n must lie in 3...1000, got {self.n}.")
        if self.hole is not None and self.hole < 0:
            raise ValueError(f"contour: hole must be None or >= 0, got {self.hole}.")

    @property
    def layout(self) -> Ring:
        """A ring of n points."""
        return Ring(self.n)

    def rejection_reason(self, observed: Observed) -> str:
        """Return why an object has no such outline: no such hole, a few pixels, or two sides too close together."""
        if self.hole is not None and self.hole >= observed.holes:
            return f"hole {self.hole} was asked for, the {observed.noun} has {observed.holes}"
        if self.ring and observed.hollow_share < _HOLLOW:
            return f"the {observed.noun} encloses no hole: something lies over the ring, or it is open"
        samples = observed.outline_samples(self.hole)
        if len(samples) < _MIN_SAMPLES:
            return f"the outline is too small: {len(samples)} samples, at least {_MIN_SAMPLES} are needed"
        thin, width = _MIN_WIDTH * samples.scale, observed.outline_width(self.hole)
        if width < thin:
            return f"the {observed.noun} is {width:.2g} {observed.unit} wide: too thin for an outline (at least {thin:.2g})"
        return ""

    def fit(
        self, observed: Observed, prediction: Prediction | None, target: Array | None, depth: npt.NDArray[Any] | None
    ) -> Fit:
        """Fit a ring of nodes to this frame's own outline; number it as the track does, or by the paper's rule."""
        reason = self.rejection_reason(observed)
        if reason:
            return Fit(reason=reason)
        width = observed.width if observed.dimension == 2 else 0.0
        outline = observed.outline_curve(self.hole)
        if prediction is None:
            curve, quality, reason = self._refine(
                observed, outline, outline.points[0], self._topology(observed, outline)
            )
            curve = self.apply_index_order(curve, observed.seen(curve.points, target), target)
            topology = self._topology(observed, outline)
            return Fit(curve, quality, reason, curve.even(topology.size), topology, width, observed)
        topology = prediction.topology
        curve, quality, reason = self._refine(observed, outline, prediction.nodes[0], topology)
        curve, nodes = match_outline(curve, prediction)
        if reason or size_jump(prediction, curve):
            start = match_outline(outline, prediction)[0].points[0]
            curve, quality, reason = self._refine(observed, outline, start, topology)
            curve, nodes = match_outline(curve, prediction)
        return Fit(curve, quality, reason, nodes, topology, width, observed)

    def _refine(
        self, observed: Observed, outline: FittedCurve, start: Array, topology: Topology
    ) -> tuple[FittedCurve, float, str]:
        """Run the self-organising map on the outline from its place nearest to ``start``; finish, validate."""
        samples, traced = observed.outline_samples(self.hole), observed.traced_outline(self.hole)
        if traced is not None:
            nodes, unit = run_ring_som(samples.points, traced.smooth, start, topology.size, _SIGMA)
            points = catmull_rom(nodes, _PIECES, True)
            miss = ring_miss(samples.points, unit, points, _PIECES)
        else:
            nearest = np.argmin(np.sum((outline.points - start) ** 2, axis=1))
            begin = outline.starting_at(float(outline.arc[nearest])).even(topology.size)
            points = catmull_rom(run_som(samples, begin, topology, (_SIGMA,)), _PIECES, True)
            size = float(arc_length(np.concatenate([points, points[:1]]))[-1])
            miss = outline_miss(np.ascontiguousarray(samples.points), points, size)
        curve = FittedCurve(points, np.zeros(len(points), bool), closed=True)
        reason, quality = validate_outline(observed, miss / samples.scale)
        return curve, quality, reason

    def _topology(self, observed: Observed, outline: FittedCurve) -> Ring:
        """Return a ring with a node every three samples, 24 to 192 of them; closer on what is thin."""
        scale = observed.outline_samples(self.hole).scale
        spacing = min(_NODE_SPACING * scale, _THIN * observed.outline_width(self.hole))
        return Ring(int(np.clip(round(outline.size / spacing), *_NODES)))

    def apply_index_order(self, form: FittedCurve, seen: Array, target: Array | None) -> FittedCurve:
        """Return the curve clockwise as seen, from the place nearest the target, else from the least u + v."""
        if not clockwise(seen):
            form, seen = form.reversed(), np.roll(seen[::-1], 1, axis=0)
        far = seen[:, 0] + seen[:, 1] if target is None else np.sum((seen - target) ** 2, axis=1)
        return form.starting_at(_least(far, form))

    def resample(self, form: FittedCurve, metric: FittedCurve) -> Points:
        """Return points with equal chords around, from the form's first point."""
        at = equidistant_around(metric.points, metric.arc, self.n)
        return Points(
            form.at(at if form is metric else np.interp(at, metric.arc, form.arc)), metric.interpolated_at(at)
        )

    def clusterer_samples(self, observed: Observed) -> Samples:
        """Return every pixel that the outline runs through; around a cloud, points at equal distances."""
        return observed.outline_points(self.hole)

    compiled: ClassVar[tuple[Any, ...]] = (
        arc_length,
        batch_epochs,
        catmull_rom,
        equal_chords,
        interpolate,
        material_outline,
        outline_miss,
        pairs,
        renumber_outline,
        ring_miss,
        run_ring_som,
        undo_shrinkage,
    )


def _least(values: Array, form: FittedCurve) -> float:
    """Return the arc position of the least of ``(P,)`` values on a form's points, by a parabola through its neighbours."""
    at = int(np.argmin(values))
    before, after = form.arc[at] - form.arc[at - 1] if at else form.arc[-1] - form.arc[-2], np.diff(form.arc)[at]
    fall, rise = (values[at - 1] - values[at]) / before, (values[(at + 1) % len(values)] - values[at]) / after
    bend = fall + rise
    shift = (fall * after - rise * before) / (2 * bend) if bend > 0 else 0.0
    return float(form.arc[at] + np.clip(shift, -before, after))
