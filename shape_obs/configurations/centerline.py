"""Centerline: a rope or cable as N points from one end to the other along its axis."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Final, cast

import numpy as np
import numpy.typing as npt

from shape_obs.clustering.som import batch_epochs, run_som
from shape_obs.configurations.base import Configuration, Ends, Points
from shape_obs.configurations.chain_points import points_along
from shape_obs.geometry.curve import NO_VALUES, FittedCurve, local_stretch
from shape_obs.geometry.intersections import crossing_table
from shape_obs.geometry.observed import Observed
from shape_obs.geometry.polyline import arc_length, catmull_rom, interpolate
from shape_obs.geometry.rotation import spread_of
from shape_obs.geometry.topology import Chain, undo_shrinkage
from shape_obs.image.over_under import upper_strands
from shape_obs.image.region import Region
from shape_obs.initialization.appearance import Picture
from shape_obs.initialization.connectors import without_connectors
from shape_obs.initialization.folding import sharp_bends
from shape_obs.initialization.medial_axis import AXIS_FUNCTIONS, medial_axis
from shape_obs.initialization.objects import SceneObject
from shape_obs.initialization.ropes import find_ropes
from shape_obs.point_cloud.lifting import leave_out_overlaid
from shape_obs.point_cloud.local_pca import moments_within
from shape_obs.tracking.judge_chain import is_unclear, reason_of
from shape_obs.tracking.memory import evidence_of_order
from shape_obs.tracking.model import ChainModel
from shape_obs.tracking.predict import NO_NODES, Fit, Prediction, Track, reversed_rope, unknown_before
from shape_obs.tracking.register_chain import direction
from shape_obs.tracking.scene import NO_MASK, Scene
from shape_obs.tracking.state import new_rope
from shape_obs.tracking.step import NO_CLOUD, InCloud, step_chain, visible_nodes
from shape_obs.tracking.validation import sample_spread
from shape_obs.utils.lengths import warn_unless_metres

if TYPE_CHECKING:
    from shape_obs.point_cloud.cloud import Cloud

Array = npt.NDArray[np.float64]

_NODES: Final = (6, 128)  # at least and at most, for a rope of any length
_MAX_PIECES: Final = 16  # of a mask: a rope does not fall into more, and joining them costs the cube of their number
_SHORTEST: Final = 0.005  # metres: a length below is in another unit


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

    is_ribbon: ClassVar[bool] = True
    resumes: ClassVar[bool] = True
    model: ClassVar[ChainModel] = ChainModel()

    n: int = 20
    ends: Ends | None = None
    length: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 2 <= self.n <= 1000:
            raise ValueError(f"centerline: n must lie in 2...1000, got {self.n}.")
        if self.length is not None and not 0 < self.length < np.inf:
            raise ValueError(f"centerline: length must be above 0 metres, or None if unknown, got {self.length}.")
        if self.length is not None:
            warn_unless_metres("centerline: length", self.length, least=_SHORTEST, stacklevel=4)

    @cached_property
    def layout(self) -> Chain:
        """A chain of n points."""
        return Chain(self.n)

    def bare(self, region: Region) -> tuple[Region, bool]:
        """Return a mask of ropes without the connectors at their ends, and whether there are any."""
        return without_connectors(region)

    def find_objects(self, region: Region, picture: Picture | None = None) -> tuple[list[SceneObject], str]:
        """Return the ropes of a mask, longest first, and why there are none."""
        return find_ropes(region, picture)

    def fit(self, observed: Observed, prediction: Prediction | None, target: Array | None, scene: Scene) -> Fit:
        """Fit a chain of nodes: from where the track expects it, else along an initial axis."""
        model = self.model
        width = prediction.track.width if prediction is not None and prediction.track.width else observed.width
        reason = _rejection_reason(observed, width, model.min_aspect)
        if reason:
            return Fit(reason=reason)
        found = Fit()
        if prediction is None or prediction.lost:  # nodes that are long out of date pull the chain away
            found = self._fit_initial(observed, prediction, scene)
        if prediction is not None and (found.track is None or _does_not_fit(found, model.either_end)):
            found = self._step(observed, NO_NODES, width, model.max_hidden, prediction, scene)
            if (off := _innovation(found)) > model.max_size_change:
                more = observed.area / max(prediction.track.size * width, 1e-9) if observed.dimension == 2 else 1.0
                most = model.more_pixels
                if more > most and math.isinf(off) and not prediction.lost:  # noise, or another object: be quick
                    return Fit(reason=f"the mask has {more:.2g} times as many pixels as the rope (at most {most:.2g})")
                # It is of another length, or the chain lost its way: an initial axis decides.
                again = self._fit_initial(observed, prediction, scene)
                fits = not math.isinf(_innovation(again))
                better = fits and (_innovation(again) <= off or _is_whole(again, model.whole_length))
                found = again if better else found
        if (prediction is None or prediction.lost) and not math.isinf(_innovation(found)):
            found = self._numbered(found, observed, prediction, target)
        return found

    def _numbered(self, found: Fit, observed: Observed, prediction: Prediction | None, target: Array | None) -> Fit:
        """Number a rope from the end that is remembered, if it was lost; else by the paper's rule."""
        curve, track, nats = found.form, found.track, 0.0
        assert track is not None
        if prediction is not None and self.order != "image":
            nats = evidence_of_order(prediction.track, track.nodes, prediction.seconds)
        turns = nats < 0
        if abs(nats) >= self.model.sure:
            found = found._replace(same=True)
        else:
            rule = prediction is None or _seems_whole(found)
            turns = rule and self.apply_index_order(curve, observed.seen(curve.points, target), target) is not curve
        if turns:
            found = found._replace(form=curve.reversed(), track=reversed_rope(track, len(curve.points)))
        return found

    def _fit_initial(self, observed: Observed, prediction: Prediction | None, scene: Scene) -> Fit:
        """Fit from an initial axis."""
        axis, model = medial_axis(observed), self.model
        if axis.ambiguity:
            return Fit(reason=axis.ambiguity)
        width = max(observed.width, model.thinnest if observed.dimension == 2 else 0.0)
        count = int(np.clip(round(observed.length / (model.node_spacing * width)), *_NODES))
        start = interpolate(axis.points, axis.arc, (np.arange(count) + 0.5) / count * axis.arc[-1])
        off = axis.unsupported_fraction if prediction is None else model.max_hidden
        return self._step(observed, start, observed.width, off, prediction, scene)

    def _step(
        self, observed: Observed, start: Array, width: float, off: float, prediction: Prediction | None, scene: Scene
    ) -> Fit:
        """Follow the rope into this frame, from an initial axis or from where it is predicted, see ``tracking.step``.

        Args:
            observed: What the rope looks like.
            start: ``(K, D)`` nodes of an initial axis; ``(0, 2)`` starts from the prediction.
            width: Of the rope.
            off: The share of its curve that may be bridged or hidden.
            prediction: What is known of it.
            scene: The frame.
        """
        image, cloud, wide = NO_MASK, NO_CLOUD, 0.0
        if isinstance(observed, Region):
            image, wide = scene.in_mask(observed), float(width)
        else:
            start, cloud = self._fit_cloud(cast("Cloud", observed), start, prediction)
            width = cloud[3]
        if prediction is not None:
            before = prediction.before
        else:
            new = new_rope(self.model, self.length or 0.0)
            before = unknown_before(new, observed.dimension, scene.clock.now)
        stepped = step_chain(
            image, cloud, observed.area, start, wide, off, self.spacing == "m", before, self.model.record
        )
        state, nodes, velocity, deep, depth_rate, points, flags, arc, metres, pixels, log_depth = stepped
        first, past = state["shown"][0].tolist()
        curve = FittedCurve(
            points, flags, arc, False, metres, pixels, log_depth, wide, shown=(first, past),
        )  # fmt: skip
        topology = prediction.track.topology if prediction is not None else Chain(len(nodes))
        track = Track(state, nodes, velocity, topology, deep, depth_rate)
        return Fit(
            curve, float(state["quality"][0]), reason_of(state, observed.noun), track, observed, width,
            bool(state["follow"][0]),
        )  # fmt: skip

    def _fit_cloud(self, cloud: Cloud, start: Array, prediction: Prediction | None) -> tuple[Array, InCloud]:
        """Return the nodes from which the map starts in a cloud, and the curve that it ends at."""
        model, samples, sigmas = self.model, cloud.samples, self.model.sigmas_initial
        if len(start) == 0 and prediction is not None:
            known = prediction.track.state
            start = visible_nodes(prediction.nodes, NO_VALUES, known)[0]
            steady = abs(cloud.area - int(known["area"][0])) <= model.steady * int(known["area"][0])
            sigmas = model.sigmas_steady if steady else model.sigmas_changed
        curve = catmull_rom(cloud.extend_to_tips(run_som(samples, start, Chain(len(start)), sigmas)), 4, False)
        spread = sample_spread(np.ascontiguousarray(samples.points), np.ascontiguousarray(samples.weight), curve)
        spread += cloud.hidden_variance
        return start, (curve, ~cloud.carries(curve), spread, cloud.ribbon_width, cloud.resolution)

    def apply_index_order(self, form: FittedCurve, seen: Array, target: Array | None) -> FittedCurve:
        """Return the curve with point 0 at the end nearest the target, else nearest the top left."""
        corner = np.zeros(seen.shape[1]) if target is None else target
        first, last = (float(np.sum((seen[end] - corner) ** 2)) for end in (0, -1))
        return form if first <= last else form.reversed()

    def resample(self, form: FittedCurve, metric: FittedCurve) -> Points:
        """Return points with equal chords, from tip to tip or at the centres of N pieces."""
        first, last = form.shown or (0, len(form.points))
        return Points(
            *points_along(
                form.points, form.arc, metric.points, metric.arc, form.metres, form.pixels, form.log_depth,
                form.interpolated, first, last, self.n, self.ends == "tips", self.spacing == "m", form.width / 2,
            )
        )  # fmt: skip

    @property
    def compiled_functions(self) -> tuple[Any, ...]:
        """The compiled functions that a fit may call."""
        masks = step_chain, points_along, direction
        masks += sharp_bends, local_stretch, leave_out_overlaid, crossing_table, upper_strands, spread_of
        clouds = arc_length, batch_epochs, catmull_rom, interpolate, sample_spread, undo_shrinkage
        clouds += visible_nodes, moments_within
        return masks + AXIS_FUNCTIONS + clouds


def _rejection_reason(observed: Observed, width: float, aspect: float) -> str:
    """Return why an object cannot be a rope: too many pieces, or less than three times as long as wide."""
    for part in (observed,) if observed.dimension == 2 else observed.parts:
        if part.pieces > _MAX_PIECES:
            return f"the {part.noun} falls into {part.pieces} pieces, at most {_MAX_PIECES}"
    length = observed.area / width if observed.dimension == 2 else observed.length
    if length < aspect * width:
        return f"the {observed.noun} is {length:.4g} x {width:.4g} {observed.unit}: too stout for a rope"
    return ""


def _does_not_fit(found: Fit, either_end: float) -> bool:
    """Return whether an initial curve does not fit, for another reason than that it is not clear which piece it is."""
    assert found.track is not None
    return math.isinf(_innovation(found)) and not is_unclear(found.track.state, either_end)


def _innovation(found: Fit) -> float:
    """Return by which share of the rope's length other parts are hidden than before; infinity if nothing fits."""
    return math.inf if found.track is None else float(found.track.state["innovation"][0])


def _is_whole(found: Fit, share: float) -> bool:
    """Return whether a form is as long in space as its rope, but for a share, and nothing of it is hidden."""
    assert found.track is not None
    rope = found.track.state
    return len(found.form.metres) > 0 and not rope["hides"][0] and abs(rope["stretch"][0] - 1) <= share


def _seems_whole(found: Fit) -> bool:
    """Return whether no more of a rope is hidden than noise explains."""
    rope = None if found.track is None else found.track.state
    return rope is not None and max(rope["hidden"][0]) <= rope["tolerance"][0]
