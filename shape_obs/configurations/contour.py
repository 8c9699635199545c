"""Contour: the outline of a cloth or any flat thing as N points, clockwise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, cast

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.configurations.base import Configuration, Points
from shape_obs.geometry.curve import NO_VALUES, FittedCurve
from shape_obs.geometry.observed import Observed, Samples
from shape_obs.geometry.outline import SAMPLED, clockwise, material_outline
from shape_obs.geometry.polyline import (
    MAX_SHIFT_AROUND,
    arc_length,
    catmull_rom,
    closed,
    equal_chords,
    interpolate,
    starting_at,
)
from shape_obs.geometry.topology import Ring
from shape_obs.image.outline_tracing import trace_hole
from shape_obs.image.region import Region
from shape_obs.point_cloud.local_pca import moments_within
from shape_obs.tracking.measure_ring import MIN_SAMPLES, fit_ring_in_cloud, nodes_around
from shape_obs.tracking.model import RingModel
from shape_obs.tracking.predict import Fit, Prediction, Track, unknown_before
from shape_obs.tracking.register_ring import first_place
from shape_obs.tracking.scene import NO_MASK, Scene
from shape_obs.tracking.state import ShapeState
from shape_obs.tracking.step_ring import FOUND, NO_CLOUD, NO_HOLE, NOT_HOLLOW, TOO_SMALL, InCloud, step_ring
from shape_obs.tracking.validation import validate_outline

if TYPE_CHECKING:
    from shape_obs.point_cloud.cloud import Cloud

Array = npt.NDArray[np.float64]


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
        if prediction is not None:
            before = prediction.before
        else:
            before = unknown_before(np.zeros(1, ShapeState), observed.dimension, scene.clock.now)
        image, cloud = NO_MASK, NO_CLOUD
        if isinstance(observed, Region):
            image = scene.in_mask(observed)
        else:
            why, cloud = self._fit_cloud(cast("Cloud", observed), prediction, target)
            if why != FOUND:
                return Fit(reason=self._rejection_reason(why, observed, len(cloud[0]), 0.0))
        step = step_ring(
            image, cloud, -1 if self.hole is None else self.hole, self.ring,
            NO_VALUES if target is None else target, before, self.model.record,
        )  # fmt: skip
        (state, nodes, velocity, known, points, space, arc, unseen, miss), why, samples, width = step
        if why != FOUND:
            return Fit(reason=self._rejection_reason(why, observed, samples, width))
        reason, quality = validate_outline(observed, np.inf if unseen else miss, self.model)
        flags, space = np.zeros(len(points), bool), space if len(space) else None
        form = FittedCurve(points, flags, arc, True, space=space)
        track = Track(state, nodes, velocity, Ring(len(nodes)), reference=known)
        return Fit(form, quality, reason, track, observed, width)

    def _fit_cloud(self, cloud: Cloud, prediction: Prediction | None, target: Array | None) -> tuple[int, InCloud]:
        """Return why a cloud has no outline, or ``FOUND``, and the curve that the map finds in it."""
        samples, outline = cloud.outline_samples(), np.ascontiguousarray(cloud.outline_curve().points)
        why = NO_HOLE if self.hole is not None else TOO_SMALL if len(outline) < MIN_SAMPLES else FOUND
        if why != FOUND:
            return why, (outline, 0, np.inf, cloud.resolution)
        count, start = nodes_around(len(outline), self.model.node_spacing), outline[0]
        if prediction is not None:
            nodes = prediction.nodes
            count, start = len(nodes), nodes[0]
        points, miss = fit_ring_in_cloud(
            np.ascontiguousarray(samples.points), samples.weight, samples.scale, outline, start, count, self.model.sigma
        )
        if prediction is None:
            curve = FittedCurve.through(points, np.zeros(len(points), bool), True)
            points = self.apply_index_order(curve, cloud.seen(points, target), target).points
        return why, (points, count, miss, cloud.resolution)

    def _rejection_reason(self, why: int, observed: Observed, samples: int, width: float) -> str:
        """Return in words why an object has no such outline."""
        if why == NO_HOLE:
            holes = len(observed.holes) if isinstance(observed, Region) else 0
            return f"hole {self.hole} was asked for, the {observed.noun} has {holes}"
        if why == NOT_HOLLOW:
            return "the mask encloses no hole: something lies over the ring, or it is open"
        if why == TOO_SMALL:
            return f"the outline is too small: {samples} samples, at least {MIN_SAMPLES} are needed"
        least = self.model.min_width * SAMPLED
        return f"the mask is {width:.2g} px wide: too thin for an outline (at least {least:.2g})"

    def apply_index_order(self, form: FittedCurve, seen: Array, target: Array | None) -> FittedCurve:
        """Return the curve clockwise as seen, from the place nearest the target, else from the least u + v."""
        if not clockwise(seen):
            form, seen = form.reversed(), np.roll(seen[::-1], 1, axis=0)
        target = NO_VALUES if target is None else target
        return form.starting_at(first_place(np.ascontiguousarray(seen), form.arc, target))

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
        clouds = nodes_around, fit_ring_in_cloud, arc_length, catmull_rom, interpolate, moments_within
        clustered = trace_hole, material_outline
        return step_ring, *clouds, *clustered, first_place, starting_at, points_around


@compiled("(f8[:,::1], f8[::1], f8[:,::1], i8)")
def points_around(points: Array, arc: Array, metric: Array, count: int) -> Array:
    """Return ``count`` points of a closed curve with equal chords in a metric, from its first point."""
    around = closed(metric)
    places, _ = equal_chords(closed(points), arc, around, arc_length(around), count + 1, 0.0, MAX_SHIFT_AROUND)
    return places[:count]
