"""Centerline: a rope or cable as N points from one end to the other along its axis."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.configurations.base import Configuration, Ends, Origin, Points
from shape_obs.geometry.form import Curve
from shape_obs.geometry.polyline import equidistant_positions
from shape_obs.geometry.samples import Samples
from shape_obs.geometry.topology import Chain, Topology, shrinkage
from shape_obs.image.region import Region
from shape_obs.initialization.medial_axis import axis
from shape_obs.point_cloud.body import Body
from shape_obs.point_cloud.cloud import Cloud
from shape_obs.point_cloud.deprojection import SeenCloud
from shape_obs.point_cloud.rope_tip import extend_to_tips
from shape_obs.tracking.occlusion import follow_chain, shown
from shape_obs.tracking.prediction import Prediction
from shape_obs.tracking.validation import Verdict, judge_ribbon

Array = npt.NDArray[np.float64]

# Nodes sit about this many widths apart: closer, and a chain starts to fold across the rope; farther, and it cuts
# corners. N is sampled from the curve afterwards, so it does not matter here.
_NODE_SPACING: Final = 1.4
_NODES: Final = (6, 48)
# The cost of joining pieces grows with the cube of their number, and a rope does not fall into that many.
_MAX_PIECES: Final = 16
_MIN_ASPECT: Final = 3.0  # length over width; what is stouter has no axis to speak of, and a chain would fold up in it


@dataclass(frozen=True)
class Centerline(Configuration[Curve], kind="centerline"):
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

    def unfit(self, body: Body) -> str:
        """Return why a body cannot hold a rope: too many pieces, or less than three times as long as wide."""
        for part in (body, body.region) if isinstance(body, SeenCloud) else (body,):  # a cold start reads the mask too
            if part.pieces > _MAX_PIECES:
                return f"the {part.noun} falls into {part.pieces} pieces, at most {_MAX_PIECES}"
        if body.stretch < _MIN_ASPECT * body.width:
            return f"the {body.noun} is {body.stretch:.4g} x {body.width:.4g} {body.unit}: too stout for a rope"
        return ""

    def samples(self, body: Body) -> Samples:
        """All of the body."""
        return body.samples

    def topology(self, body: Body) -> Chain:
        """A chain with a node every 1.4 widths, 6 to 48 of them."""
        return Chain(int(np.clip(round(body.stretch / (_NODE_SPACING * body.width)), *_NODES)))

    def parameterise(self, body: Body) -> Curve:
        """The axis from tip to tip."""
        return axis(body)

    def nodes(self, form: Curve, topology: Topology) -> Array:
        """The centres of K equal pieces."""
        return form.at(_middles(topology.size) * form.size)

    def warm(self, body: Body, prediction: Prediction) -> Array:
        """The prediction itself: the chain settles from there, and only a lost one pays for a cold start."""
        return prediction.nodes

    def settled(self, start: Array, body: Body, topology: Topology, origin: Origin) -> Curve:
        """In a mask all at once."""
        if isinstance(body, Cloud):
            return super().settled(start, body, topology, origin)
        sigmas, samples = self.widths(origin), body.samples
        points, arc, carried, spread = body.kernels.ribbon(
            body.mask,
            body.window.left,
            body.window.top,
            samples.points,
            samples.weight,
            start,
            *topology.neighbourhoods(sigmas),
            shrinkage(sigmas[-1]),
            body.width,
            body.thinnest,
        )
        return Curve(points, ~carried, spread=spread, kernels=body.kernels).along(arc)

    def finish(self, nodes: Array, body: Body) -> Curve:
        """The curve through the nodes, lengthened to the rope's tips."""
        if isinstance(body, Cloud):
            nodes = extend_to_tips(nodes, body, body.width)
        points = body.kernels.catmull_rom(nodes)
        return Curve(points, ~body.carries(points), kernels=body.kernels)

    def known(self, body: Body, prediction: Prediction) -> Body:
        """A mask with the width that is known, so that its outline need not be traced."""
        return body.as_wide_as(prediction.width) if isinstance(body, Region) and prediction.width else body

    def girth(self, form: Curve, body: Body) -> float:
        """The area of a mask over the length that is seen."""
        return body.breadth(form.size * (1 - form.empty)) if isinstance(body, Region) else 0.0

    def judge(self, form: Curve, body: Body, bridged: float) -> Verdict:
        """As a ribbon."""
        return judge_ribbon(form, body, bridged)

    def numbered(self, form: Curve, seen: Array, target: Array | None) -> Curve:
        """Point 0 at the end nearest the target, else nearest the top left."""
        corner = np.zeros(seen.shape[1]) if target is None else target
        first, last = (float(np.sum((seen[end] - corner) ** 2)) for end in (0, -1))
        return form if first <= last else form.reversed()

    def follow(self, form: Curve, prediction: Prediction) -> Curve:
        """In the prediction's direction, hidden ends put back."""
        return follow_chain(form, prediction)

    def place(self, form: Curve, metric: Curve) -> Points:
        """Equal chords, from tip to tip or at the centres of N pieces."""
        if any(form.memory.hidden):
            piece = shown(form)
            form, metric = form.cut(piece), metric.cut(piece)
        at = equidistant_positions(metric.points, metric.arc, self.n, centers=self.ends != "tips", kernels=form.kernels)
        along = at if metric is form else np.interp(at, metric.arc, form.arc)
        return Points(form.at(along), metric.bridged_at(at))


@lru_cache
def _middles(count: int) -> Array:
    """(count,) the middles of so many equal pieces of 1."""
    return (np.arange(count) + 0.5) / count
