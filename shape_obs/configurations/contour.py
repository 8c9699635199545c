"""Contour: the outline of a cloth or any flat thing as N points, clockwise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.configurations.base import Configuration, Origin, Points
from shape_obs.geometry.form import Curve, Memory
from shape_obs.geometry.outline import clockwise
from shape_obs.geometry.polyline import equidistant_around
from shape_obs.geometry.samples import Samples
from shape_obs.geometry.topology import Ring, Topology
from shape_obs.image.region import Region
from shape_obs.initialization.outline import border, breadth, holes, outline, outline_points, outline_samples, sampling
from shape_obs.point_cloud.body import Body
from shape_obs.tracking.prediction import Prediction
from shape_obs.tracking.registration import blend, lag
from shape_obs.tracking.validation import Verdict, judge_outline

Array = npt.NDArray[np.float64]

# Samples from node to node, whatever N is: 6 px. Closer, and the nodes follow the pixels (at 4 px they jitter by a
# sixth more); farther, and they cut corners (at 8 px garments lie 0.16 px off instead of 0.13).
_NODE_SPACING: Final = 3.0
_THIN: Final = 1.5  # widths from node to node at most: farther, and a node's samples are those of the other side too
_NODES: Final = (24, 192)
_WIDTH: Final = 0.4  # of the map's neighbourhood, nodes
_PIECES: Final = 4  # of the curve between two nodes
_HOLLOW: Final = 0.05  # of what the outline encloses; drawn shapes without a hole have at most 0.01
_MIN_SAMPLES: Final = 8  # a ring of 16 pixels, as few as a body may have
_MIN_WIDTH: Final = 1.25  # in samples: of outlines of 2 px, one in three has its two sides mixed up; of 3 px, none
# Numbered by the last frame alone, an outline of noisy pixels creeps by 6 px in 180 frames. The mean of some twenty
# frames holds it, and is left behind by slow changes of shape alone.
_FORGETTING: Final = 0.05


@dataclass(frozen=True)
class Contour(Configuration[Curve], kind="contour"):
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

    def unfit(self, body: Body) -> str:
        """No such hole, an outline of a few pixels, or two sides too close to be told apart."""
        found = holes(body) if self.hole is not None else 0
        if self.hole is not None and self.hole >= found:
            return f"hole {self.hole} was asked for, the {body.noun} has {found}"
        if self.ring and isinstance(body, Region) and body.hollow < _HOLLOW:
            return f"the {body.noun} encloses no hole: something lies over the ring, or it is open"
        count, scale = sampling(body, self.hole)
        if count < _MIN_SAMPLES:
            return f"the outline is too small: {count} samples, at least {_MIN_SAMPLES} are needed"
        thin = _MIN_WIDTH * scale
        width = breadth(body, self.hole)
        if width < thin:
            return f"the {body.noun} is {width:.2g} {body.unit} wide: too thin for an outline (at least {thin:.2g})"
        return ""

    def samples(self, body: Body) -> Samples:
        """The outline."""
        return outline_samples(body, self.hole)

    def all_samples(self, body: Body) -> Samples:
        """Every pixel that the outline runs through; around a cloud, points at equal distances."""
        return outline_points(body, self.hole)

    def topology(self, body: Body) -> Ring:
        """A ring with a node every three samples, 24 to 192 of them; closer on what is thin."""
        spacing = min(_NODE_SPACING * self.samples(body).scale, _THIN * breadth(body, self.hole))
        return Ring(int(np.clip(round(self.parameterise(body).size / spacing), *_NODES)))

    def parameterise(self, body: Body) -> Curve:
        """The outline, clockwise as seen."""
        return outline(body, self.hole)

    def nodes(self, form: Curve, topology: Topology) -> Array:
        """K places of equal arc length, the first at the form's first point."""
        return form.even(topology.size)

    def warm(self, body: Body, prediction: Prediction) -> Array:
        """On this frame's own outline. They begin near where they are expected; it is the fitted form that follows."""
        if isinstance(body, Region):
            return prediction.nodes  # they tell ``settled`` where to begin
        form = self.parameterise(body)
        nearest = np.argmin(np.sum((form.points - prediction.nodes[0]) ** 2, axis=1))
        return self.nodes(form.begun_at(float(form.arc[nearest])), prediction.topology)

    def widths(self, origin: Origin) -> tuple[float, ...]:
        """One epoch: the start lies on the outline, and further ones change nothing."""
        return (_WIDTH,)

    def settled(self, start: Array, body: Body, topology: Topology, origin: Origin) -> Curve:
        """On a border all at once."""
        if not isinstance(body, Region):
            return super().settled(start, body, topology, origin)
        edge = border(body, self.hole)
        points, miss = body.kernels.ring(edge.points, edge.smooth, start[0], topology.size, _WIDTH, _PIECES)
        return Curve(points, np.zeros(len(points), bool), True, miss=miss, kernels=body.kernels)

    def finish(self, nodes: Array, body: Body) -> Curve:
        """The closed curve through the nodes."""
        points = body.kernels.catmull_rom(nodes, _PIECES, True)
        return Curve(points, np.zeros(len(points), bool), closed=True, kernels=body.kernels)

    def judge(self, form: Curve, body: Body, bridged: float) -> Verdict:
        """By how closely it follows the outline, and how much of the body lies within."""
        scale, miss = sampling(body, self.hole)[1], form.miss
        if miss is None:
            miss = body.kernels.miss(self.samples(body).points, form.points, form.size)
        return judge_outline(body, miss / scale)

    def numbered(self, form: Curve, seen: Array, target: Array | None) -> Curve:
        """Clockwise as seen, from the place nearest the target, else from the least u + v."""
        if not clockwise(seen):
            form, seen = form.reversed(), np.roll(seen[::-1], 1, axis=0)
        far = seen[:, 0] + seen[:, 1] if target is None else np.sum((seen - target) ** 2, axis=1)
        return form.begun_at(_least(far, form))

    def follow(self, form: Curve, prediction: Prediction) -> Curve:
        """From the place where the predicted outline begins, whichever way it has turned."""
        reference = prediction.nodes if prediction.memory.reference is None else prediction.memory.reference
        if form.points.shape[1] == 2:
            points, arc, nodes, blended = form.kernels.followed(form.points, reference, prediction.nodes, _FORGETTING)
            memory = Memory(reference=blended)
            turned = Curve(
                points, np.zeros(len(points), bool), True, miss=form.miss, memory=memory, kernels=form.kernels
            )
            return turned.knowing(arc, nodes)
        behind = lag(reference, prediction.nodes, self.nodes(form, prediction.topology))
        turned = form.begun_at(behind * form.size / prediction.topology.size)
        blended = blend(reference, self.nodes(turned, prediction.topology), _FORGETTING)
        return replace(turned, memory=Memory(reference=blended))

    def place(self, form: Curve, metric: Curve) -> Points:
        """Equal chords around, from the form's first point."""
        at = equidistant_around(metric.points, metric.arc, self.n, form.kernels)
        return Points(form.at(at if form is metric else np.interp(at, metric.arc, form.arc)), metric.bridged_at(at))


def _least(values: Array, form: Curve) -> float:
    """Arc position of the least of (P,) values on a form's points: of the parabola through it and its neighbours."""
    at = int(np.argmin(values))
    before, after = form.arc[at] - form.arc[at - 1] if at else form.arc[-1] - form.arc[-2], np.diff(form.arc)[at]
    fall, rise = (values[at - 1] - values[at]) / before, (values[(at + 1) % len(values)] - values[at]) / after
    bend = fall + rise
    shift = (fall * after - rise * before) / (2 * bend) if bend > 0 else 0.0
    return float(form.arc[at] + np.clip(shift, -before, after))
