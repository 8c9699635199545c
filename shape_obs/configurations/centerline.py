"""Centerline: a rope or cable as N points from one end to the other along its axis."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, ClassVar, Final, cast

import numpy as np
import numpy.typing as npt

from shape_obs.clustering.som import batch_epochs, run_som
from shape_obs.configurations.base import Configuration, Ends, Points, Scene
from shape_obs.configurations.chain_points import follow_chain_in_mask, nodes_along, points_along
from shape_obs.geometry.curve import FittedCurve, TrackHints, local_stretch
from shape_obs.geometry.intersections import crossing_table
from shape_obs.geometry.observed import Observed
from shape_obs.geometry.polyline import arc_length, catmull_rom, interpolate
from shape_obs.geometry.topology import Chain, from_tip_to_tip, shrinkage, undo_shrinkage
from shape_obs.image.over_under import upper_strands
from shape_obs.image.region import Region
from shape_obs.image.roi import Window
from shape_obs.initialization.connectors import without_connectors
from shape_obs.initialization.folding import sharp_bends
from shape_obs.initialization.likeness import Picture
from shape_obs.initialization.medial_axis import AXIS_FUNCTIONS, medial_axis
from shape_obs.initialization.objects import SceneObject
from shape_obs.initialization.ropes import find_ropes
from shape_obs.point_cloud.lifting import nearest_expected
from shape_obs.tracking.complete import complete_chain
from shape_obs.tracking.occluders import Tips
from shape_obs.tracking.occlusion import ambiguity_of, expected_rope, is_whole, match_chain, shown
from shape_obs.tracking.predicted_rope import least_doubt, visible_nodes
from shape_obs.tracking.prediction import MAX_SIZE_CHANGE, Fit, Prediction
from shape_obs.tracking.rope_match import ADRIFT, match_to_rope
from shape_obs.tracking.validation import MAX_HIDDEN, doubt_in_space, sample_spread, validate_ribbon
from shape_obs.utils.lengths import warn_unless_metres

if TYPE_CHECKING:
    from shape_obs.point_cloud.cloud import Cloud

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

# Nodes sit about this many widths apart: closer, and a chain starts to fold across the rope; farther, and it cuts
# corners. N is sampled from the curve afterwards, so it does not matter here.
_NODE_SPACING: Final = 1.4
_NODES: Final = (6, 128)
_THINNEST: Final = 3.0  # pixels: nodes as near to each other as a thinner rope is wide follow its staircase
# Width of the map's neighbourhood in each epoch, node units. If a part of the rope was hidden in the last frame, what
# comes back has no node near it.
_SIGMAS_INITIAL: Final = (0.8, 0.4, 0.4)
_SIGMAS_STEADY: Final = (0.8, 0.4)
_SIGMAS_AREA_CHANGED: Final = (1.2, 0.6, 0.4, 0.4)
_MAX_CELL: Final = 24  # pixels
_MAX_CELLS: Final = 4096  # about; more change nothing and cost time
# The cost of joining pieces grows with the cube of their number, and a rope does not fall into that many.
_MAX_PIECES: Final = 16
_MORE: Final = 2.5  # times as many pixels as the rope: it does not come so much nearer from one frame to the next
_MIN_STRETCH: Final = 0.957  # a curve that became longer by more follows something else; a pulled band does not
_MIN_SEEN: Final = 0.3  # of a rope's length: what has to be in sight to report it, and below, to follow it
_MIN_IN_PIECES: Final = 0.45  # around a gap of a tenth of it: a piece behind a long gap may be anywhere
_GAP: Final = 0.1
_MIN_BETWEEN: Final = 0.6  # while both ends are hidden
_MIN_FOLLOWED: Final = 0.15
_END_ON: Final = 4.0  # a rope is this much longer in space than in the image: its points cannot be told apart there
_SHORTEST: Final = 0.005  # metres: a length below is in another unit
_NOTHING: Final = np.zeros(0)
_EVERYWHERE: Final = Window(-(1 << 30), -(1 << 30), 1 << 31, 1 << 31)
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

    is_ribbon: ClassVar[bool] = True
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
        width = prediction.width if prediction is not None and prediction.width else observed.width
        reason = _rejection_reason(observed, width)
        if reason:
            return Fit(reason=reason)
        found = Fit()
        if prediction is None or prediction.stale:  # nodes that are long out of date pull the chain away
            found = self._fit_initial(observed, prediction, scene)
        if prediction is not None and (found.form is None or (found.reason and not found.form.ambiguity)):
            sigmas = _SIGMAS_STEADY if prediction.steady else _SIGMAS_AREA_CHANGED
            start = visible_nodes(prediction) if prediction.hints.rope["hides"][0] else prediction
            found = self._refine(observed, start.nodes, start.relief, sigmas, width, MAX_HIDDEN, prediction, scene)
            off = np.inf if found.reason else found.form.hints.rope["innovation"][0]
            more = observed.area / max(prediction.size * width, 1e-9) if observed.dimension == 2 else 1.0
            if more > _MORE and found.reason and not prediction.stale:  # noise, or another object: no time is lost
                return Fit(reason=f"the mask has {more:.2g} times as many pixels as the rope (at most {_MORE:.2g})")
            if off > MAX_SIZE_CHANGE:  # of another length, or the chain lost its way: an initial axis decides
                again = self._fit_initial(observed, prediction, scene)
                better = not again.reason and (again.form.hints.rope["innovation"][0] <= off or is_whole(again.form))
                found = again if better else found
        if found.reason:
            return found
        curve: FittedCurve = found.form
        if _begins_again(curve, prediction):
            curve = self.apply_index_order(curve, observed.seen(curve.points, target), target)
        topology = found.topology if prediction is None else prediction.topology
        assert found.nodes is not None
        count = len(found.nodes if prediction is None else prediction.nodes)
        nodes, relief, steep = nodes_along(curve.points, curve.arc, *_measures(curve), count)
        size, hidden = float(curve.arc[-1]), curve.unsupported_fraction
        seen_width = max(observed.area / max(size * (1 - hidden), 1e-9), 1.0) if observed.dimension == 2 else 0.0
        reason, follow = self._reason_of(curve, 1 - hidden), 1 - hidden >= _MIN_FOLLOWED
        if not reason and steep > _END_ON:
            reason, follow = f"it is seen end-on, {steep:.2g} times as long as in the image (at most {_END_ON})", False
        if not reason and curve.metres is not None:
            reason = doubt_in_space(curve)
        elif not reason and self._lost_its_length(observed, prediction):
            reason = "the depth shows too little of the rope to measure its length"
        return found._replace(
            form=curve, nodes=nodes, topology=topology, size=size, width=seen_width, reason=reason, follow=follow,
            relief=None if curve.relief is None else relief,
            length=float(curve.hints.rope["metres"][0]) or found.length,
        )  # fmt: skip

    def _lost_its_length(self, observed: Observed, prediction: Prediction | None) -> bool:
        """Return whether a rope in an image, whose points lie at equal steps in space, is no longer measured there."""
        known = prediction is not None and prediction.hints.rope["metres"][0] > 0
        return known and observed.dimension == 2 and self.spacing == "m"

    def _reason_of(self, curve: FittedCurve, seen: float) -> str:
        """Return why a matched curve may be wrong, or shows too little of the rope; empty if it does not."""
        rope = curve.hints.rope
        least = _MIN_IN_PIECES if 1 - seen - sum(rope["hidden"][0]) > _GAP else _MIN_SEEN
        if seen < least:
            return f"{seen:.0%} of the rope is in sight (at least {least:.0%})"
        if seen < _MIN_BETWEEN and rope["occluded"].all():
            return f"both ends are hidden, and {seen:.0%} of the rope is in sight (at least {_MIN_BETWEEN:.0%})"
        if (drift := rope["drift"][0]) > ADRIFT:
            return f"a piece without an end in sight may have slid by {drift:.1%} of the rope's length"
        return ""

    def _fit_initial(self, observed: Observed, prediction: Prediction | None, scene: Scene) -> Fit:
        """Fit from an initial axis."""
        axis = medial_axis(observed)
        if axis.ambiguity:
            return Fit(reason=axis.ambiguity)
        width = max(observed.width, _THINNEST if observed.dimension == 2 else 0.0)
        count = int(np.clip(round(observed.length / (_NODE_SPACING * width)), *_NODES))
        start = nodes_along(axis.points, axis.arc, _NOTHING, _NOTHING, _NOTHING, count)[0]
        off = axis.unsupported_fraction if prediction is None else MAX_HIDDEN
        return self._refine(observed, start, None, _SIGMAS_INITIAL, observed.width, off, prediction, scene)

    def _refine(
        self,
        observed: Observed,
        start: Array,
        relief: Array | None,
        sigmas: tuple[float, ...],
        width: float,
        expected_off: float,
        prediction: Prediction | None,
        scene: Scene,
    ) -> Fit:
        """Run the self-organising map from a start, finish the curve, match it to the track, validate it."""
        topology, metres, deep = Chain(len(start)), _NOTHING, _NOTHING
        if isinstance(observed, Region):
            cell = max(int(min(width / 3, _MAX_CELL)), math.isqrt(observed.area // _MAX_CELLS), 1)  # thin ropes keep it
            expected = expected_rope(prediction, width, self.length or 0.0)
            lens = _NOTHING if scene.intrinsics is None else scene.intrinsics.lens
            drawn, (state, stations) = follow_chain_in_mask(
                observed.runs, start, _NOTHING if relief is None or not len(lens) else relief, *_epochs(sigmas), cell,
                (scene.edge or _EVERYWHERE)[:4], *expected, observed.mask, observed.window[:2], scene.images, lens,
            )  # fmt: skip
            points, arc, off, metres, deep, spread, ends, shapes = drawn
            tips, ribbon = Tips(ends, shapes), width
            square, area = spread + min(cell, width) ** 2 / 12, observed.area
        else:
            cloud = cast("Cloud", observed)
            samples, tips, ribbon, area = cloud.samples, Tips(), 0.0, 0
            nodes = cloud.extend_to_tips(run_som(samples, start, topology, sigmas))
            points = catmull_rom(nodes, 4, False)
            off, arc = ~cloud.carries(points), arc_length(points)
            spread = sample_spread(np.ascontiguousarray(samples.points), np.ascontiguousarray(samples.weight), points)
            square, width = spread + cloud.hidden_variance, cloud.ribbon_width
            expected = expected_rope(prediction, ribbon, self.length or 0.0)
            state, stations = match_to_rope(points, arc, off, metres, deep, *tips, *expected, False)
        plain, hints = state["plain"][0], TrackHints(state)
        known = (stations if plain else metres, None, deep) if len(metres) else (None, None, None)
        curve = FittedCurve(points, off, arc, False, *known, ribbon, hints=hints, ambiguity=ambiguity_of(state))
        if prediction is not None and not plain:
            curve = match_chain(curve, prediction, tips)  # an end under a hand is put back here
        reason, quality = validate_ribbon(curve, observed.noun, expected_off, square, width, area)
        stretch, measured = max(float(curve.hints.rope["stretch"][0]), 1e-9), curve.hints.rope["measured"][0]
        before = 0.0 if prediction is None else prediction.hints.rope["measured"][0]
        grown = curve.metres is not None and measured * _MIN_STRETCH > before > 0
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
        if form.hints.rope is not None and form.hints.rope["hides"][0]:
            piece, same = shown(form), metric is form
            form, first = form.cut(piece), piece.start
            metric = form if same else metric.cut(piece)
        places, interpolated, nearest, relief, steep = points_along(
            form.points, form.arc, metric.points, metric.arc, *_measures(form), form.interpolated, self.n,
            self.ends == "tips", self.spacing == "m", form.width / 2,
        )  # fmt: skip
        known = form.relief is not None
        return Points(places, interpolated, first + nearest, relief if known else None, steep if known else None)

    @property
    def compiled_functions(self) -> tuple[Any, ...]:
        """The compiled functions that a fit may call."""
        masks = follow_chain_in_mask, match_to_rope, points_along, nodes_along
        masks += sharp_bends, local_stretch, complete_chain
        masks += from_tip_to_tip, least_doubt, nearest_expected, crossing_table, upper_strands
        clouds = arc_length, batch_epochs, catmull_rom, interpolate, sample_spread, undo_shrinkage
        return masks + AXIS_FUNCTIONS + clouds


def _rejection_reason(observed: Observed, width: float) -> str:
    """Return why an object cannot be a rope: too many pieces, or less than three times as long as wide."""
    for part in (observed,) if observed.dimension == 2 else observed.parts:
        if part.pieces > _MAX_PIECES:
            return f"the {part.noun} falls into {part.pieces} pieces, at most {_MAX_PIECES}"
    length = observed.area / width if observed.dimension == 2 else observed.length
    if length < _MIN_ASPECT * width:
        return f"the {observed.noun} is {length:.4g} x {width:.4g} {observed.unit}: too stout for a rope"
    return ""


def _measures(curve: FittedCurve) -> tuple[Array, Array, Array]:
    """Return the metres, pixels and relief along a curve; ``(0,)`` for what is not known."""
    metres, pixels, relief = curve.metres, curve.pixels, curve.relief
    return (
        _NOTHING if metres is None else metres, _NOTHING if pixels is None else pixels,
        _NOTHING if relief is None else relief,
    )  # fmt: skip


@lru_cache(maxsize=16)
def _epochs(sigmas: tuple[float, ...]) -> tuple[Array, float]:
    """Return the widths of the map's neighbourhood as an array, and how far averaging pulls the nodes at the end."""
    return np.array(sigmas, dtype=np.float64), shrinkage(sigmas[-1])


def _begins_again(curve: FittedCurve, prediction: Prediction | None) -> bool:
    """Return whether a rope is numbered by the paper's rule: at a cold start, or as a whole after a long loss."""
    return prediction is None or (
        prediction.stale and max(curve.hints.rope["hidden"][0]) <= curve.hints.rope["tolerance"][0]
    )
