"""Surface: a cloth or a towel as a lattice of points, row by row, each on its material."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from shape_obs.clustering.som import batch_epochs
from shape_obs.configurations.base import Configuration, Ends, Points
from shape_obs.configurations.sheet_map import moved_inside
from shape_obs.geometry.coons import FINE, SIDE, beneath_fold, blend_sides, border_of, side_lengths
from shape_obs.geometry.curve import TrackHints
from shape_obs.geometry.lattice import (
    FittedLattice,
    assess_lattice,
    flattened,
    lattice_gauges,
    sample_lattice,
    uneven_places,
)
from shape_obs.geometry.observed import Observed
from shape_obs.geometry.topology import Grid, undo_shrinkage
from shape_obs.image.connected_runs import gather_cells
from shape_obs.image.region import Region
from shape_obs.initialization.corners import Indices, Rim
from shape_obs.tracking.isometry import ISOMETRY_FUNCTIONS, Isometry
from shape_obs.tracking.measure_lattice import (
    NO_CORNERS,
    OUT_OF_SIGHT,
    SHEET_FUNCTIONS,
    SHEET_WRONG,
    judge_patch,
    lay_patch,
    lay_sheet,
    view_sheet,
)
from shape_obs.tracking.model import LatticeModel
from shape_obs.tracking.predict import Fit, Prediction
from shape_obs.tracking.register_lattice import match_corners
from shape_obs.tracking.scene import Scene
from shape_obs.tracking.sheet_view import KnownSheet, SheetView, doubtful_places
from shape_obs.tracking.validation import FitQuality, validate_sheet

Array = npt.NDArray[np.float64]

_GRID: Final = Grid(FINE, FINE)  # the nodes that are kept from frame to frame, for any lattice that is sampled
_NEAREST: Final = np.empty(0, np.int64)  # the corners nearest to the predicted ones
_NO_NODES, _NO_SIDES = np.empty((0, 2)), np.zeros(4)  # without a track
_NOTHING_OVER: Final = "the sheet is smaller than it was, and nothing lies over the rest"
_COVERED: Final = "something lies over the sheet's border"


@dataclass(frozen=True)
class Surface(Configuration, kind="surface"):
    """A lattice over a sheet with four corners, row by row from its top left.

    A surface is a Coons patch between the corners of its outline; ``epochs`` of the self-organising map may follow.

    Args:
        rows: How many points from top to bottom.
        cols: How many from left to right.
        ends: ``"centers"``: the points are centres of rows x cols equal pieces, as cluster centres are; ``"tips"``:
            the outer rows and columns lie on the border. None takes the detector's.
        epochs: Of the self-organising map, after the Coons patch. None by default: what is seen of a sheet's material
            is its outline. Each epoch evens the areas out and takes the points nearer to cluster centres and off their
            material (1.1, 1.3, 1.6 px over drawn sheets with 0, 1, 3), and away from what hides the inside.
        freedom: Without depth, how far a corner may move from one frame to the next that the three others do not, as
            a share of half a diagonal. Beyond it something lies over that corner, which is put back. Where grippers
            move single corners give more.
    """

    model: ClassVar[LatticeModel] = LatticeModel()

    rows: int = 4
    cols: int = 8
    ends: Ends | None = None
    epochs: int = 0
    freedom: float = 0.06  # cloths that bend and move by 30 px a frame: up to 0.025; a hand 12 px in radius: 0.11

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (2 <= self.rows <= 100 and 2 <= self.cols <= 100):
            raise ValueError(f"surface: rows and cols must lie in 2...100, got {self.rows} and {self.cols}.")
        if not 0 <= self.epochs <= 100:
            raise ValueError(f"surface: epochs must lie in 0...100, got {self.epochs}.")
        if not 0 < self.freedom <= 1:
            raise ValueError(f"surface: freedom must lie above 0, up to 1, got {self.freedom}.")

    @cached_property
    def layout(self) -> Grid:
        """A lattice of rows x cols points."""
        return Grid(self.rows, self.cols)

    def fit(self, observed: Observed, prediction: Prediction | None, target: Array | None, scene: Scene) -> Fit:
        """Lay a Coons patch between the predicted corners; put back what is hidden; else take the best four corners."""
        view = view_sheet(observed, scene, self.model) if isinstance(observed, Region) else None
        reason = self._rejection_reason(
            observed, observed.width if view is None else view.width, prediction is not None
        )
        if reason:
            return Fit(reason=reason)
        if view is None:
            found = self._fit_in_cloud(observed, prediction)
        elif prediction is None:
            found = self._fit_whole(view, None, view.best_corners(), scene)
        else:
            found = self._track(view, prediction, scene)
        if found.reason:
            return found
        if prediction is None:
            form = self.apply_index_order(found.form, observed.seen(found.form.points, target), target)
            found = found._replace(form=form, nodes=form.points)
        return self._judge_isometry(found, observed, prediction is not None, scene)

    def _judge_isometry(self, found: Fit, observed: Observed, tracked: bool, scene: Scene) -> Fit:
        """Mark what is folded or crumpled, a sheet or single nodes, as uncertain; refuse a new sheet."""
        form, size = found.form, (self.rows, self.cols)
        if scene.intrinsics is not None and scene.depth is not None:
            lattice = form.points if observed.dimension == 2 else scene.intrinsics.project(form.points)
            region = observed.parts[-1]  # of a cloud too: the mask that it was seen in
            isometry = Isometry.in_image(
                lattice, form.interpolated, region, scene.images, scene.intrinsics, size, self.model
            )
        elif observed.dimension == 3:
            isometry = Isometry.in_space(form.points, size, self.model)
        else:
            return found
        uncertain, share = isometry.verdict(self.model)
        flags = form.interpolated | (isometry.off > self.model.uncertain * isometry.gap)
        form = replace(form, interpolated=flags, off=isometry.off, ambiguity=uncertain)
        return found._replace(form=form, quality=found.quality * share, reason="" if tracked else uncertain)

    def _track(self, view: SheetView, prediction: Prediction, scene: Scene) -> Fit:
        """Fit a sheet in an image: as a whole if nothing hides its border, else with its border put back."""
        whole, covered = Fit(reason=_COVERED), view.cut.any()
        if not covered:
            whole = self._fit_whole(view, prediction, _NEAREST, scene)
        if not whole.reason:
            return whole
        found = self._fit_hidden(view, prediction, scene)
        if found.reason and not covered:
            found = self._fit_whole(view, prediction, view.best_corners(), scene)
        if found.reason and view.camera is not None and view.cut.mean() < self.model.barely_cut:
            found = self._fit_whole(view, prediction, _NEAREST, scene, buckled=True)
        return found if not found.reason or whole.reason == _COVERED else whole

    def _fit_whole(
        self, view: SheetView, prediction: Prediction | None, corners: Indices | None, scene: Scene, *,
        buckled: bool = False,
    ) -> Fit:  # fmt: skip
        """Lay the patch between four corners that are all seen, and compare it with what is known of the sheet."""
        if corners is None:
            few = f"the outline has {len(view.candidates)} corners, a sheet has four"
            return Fit(reason=few if prediction is None else SHEET_WRONG[NO_CORNERS])
        predicted, before, sides, hints, lasted = _NO_NODES, _NO_NODES, _NO_SIDES, TrackHints(), 0.0
        if prediction is not None:
            predicted, hints, lasted = prediction.nodes, prediction.track.hints, prediction.lasted
            before, sides = hints.reference, hints.sides
            if before is None or sides is None or before.shape[1] > view.space.shape[1]:
                before, sides = predicted, side_lengths(border_of(predicted))
        metric = before.shape[1] == 3
        (left, top), mask = view.region.window[:2], view.region.mask
        seen = view.rim, view.turn, view.candidates, view.step, view.grain, view.space, corners, predicted
        rest = before, sides, mask, left, top, float(self.rows), float(self.cols), buckled, lasted, self.model.record
        if view.camera is None or view.camera.model == "pinhole":
            judged, patch, kink, number, stray = lay_sheet(*seen, view.lens, *rest)
        else:
            patch, kink, number, stray = lay_patch(*seen)
            lattice = view.camera.project(patch)
            if not len(patch) or not np.isfinite(lattice).all():
                return Fit(reason=SHEET_WRONG[OUT_OF_SIGHT if len(patch) else NO_CORNERS])
            judged = judge_patch(patch, lattice, view.space, view.step, *rest)
        code, side, lattice, down, right, hidden, off, known, sides, measures = judged
        if code:
            return Fit(reason=SHEET_WRONG[code].format(side))
        if hints.reference is None or hints.reference.shape[1] <= patch.shape[1]:  # else this frame has lost its depth
            hints = TrackHints(reference=known, sides=sides)
        if not metric and patch.shape[1] == 3:
            measures = assess_lattice(flattened(patch).reshape(FINE, FINE, 2))
        corner = (0, 0.0) if metric and not buckled else (number, stray)  # in space the lengths of the sides say more
        verdict = validate_sheet(off, measures, Region.noun, math.degrees(kink), corner, self.freedom, self.model)
        return self._finish(view, lattice, (down, right), hints, verdict, hidden)

    def _fit_hidden(self, view: SheetView, prediction: Prediction, scene: Scene) -> Fit:
        """Lay the patch between sides of which a part is hidden and put back."""
        known = KnownSheet.of(prediction, view)
        border = known.complete(view, scene.depth)
        if border is None:
            return Fit(reason="too little of the sheet's border is seen to know where the rest is")
        sides = border.points[(np.arange(4)[:, None] * SIDE + np.arange(FINE)) % (4 * SIDE)]
        patch = blend_sides(np.ascontiguousarray(sides))
        lattice = view.pixels(patch) if known.metric else patch
        if lattice is None:
            return Fit(reason=SHEET_WRONG[OUT_OF_SIGHT])
        hidden = ~view.region.carries(lattice)
        if not known.metric:
            gap = min(known.sides[0] / self.cols, known.sides[1] / self.rows)
            hidden |= doubtful_places(known.lattice, patch, gap, self.model.record)
        if border.folded:
            hidden |= beneath_fold(border.folded, known.sides)
        elif (
            known.metric
            and scene.depth is not None
            and view.cut.mean() < self.model.barely_cut
            and view.sees_through(patch, lattice, scene.depth)
        ):
            return Fit(reason=_NOTHING_OVER)
        verdict = FitQuality("", float(border.seen.mean()) ** 0.5)
        gauges = lattice_gauges(lattice.reshape(FINE, FINE, 2))
        return self._finish(view, lattice, gauges, known.seen_beside(border, patch), verdict, hidden)

    def _finish(
        self, view: SheetView, lattice: Array, gauges: tuple[Array, Array], hints: TrackHints, verdict: FitQuality,
        hidden: npt.NDArray[np.bool_],
    ) -> Fit:  # fmt: skip
        """Return the fit of a lattice of ``(625, 2)`` pixels, its inside moved with the map if that is asked for."""
        form = FittedLattice(lattice, hidden, gauges, FINE, hints=hints)
        if self.epochs:
            form = form.with_points(form.points + moved_inside(form, view.region, self.epochs))
        return Fit(form, verdict.quality, verdict.reason, form.points, _GRID, view.width, view.region, view.width)

    def _fit_in_cloud(self, observed: Observed, prediction: Prediction | None) -> Fit:
        """Lay the patch over a sheet that is unrolled, between the corners nearest to the predicted ones."""
        rim = Rim.along(*observed.sheet_outline())
        found = Fit(reason="no corners were predicted")
        if prediction is not None:
            found = self._lay_in_cloud(observed, rim, rim.corners_near(_corners(prediction.nodes)), prediction)
        if found.reason:
            found = self._lay_in_cloud(observed, rim, rim.corners(), prediction)
        return found

    def _lay_in_cloud(self, cloud: Observed, rim: Rim, corners: Indices | None, prediction: Prediction | None) -> Fit:
        if corners is None:
            return Fit(reason=SHEET_WRONG[NO_CORNERS])
        flat, kink = rim.patch(corners)
        form = FittedLattice.over(cloud.to_space(flat), np.zeros(len(flat), bool), FINE)
        if self.epochs:
            form = form.with_points(form.points + moved_inside(form, cloud, self.epochs))
        stray = (0, 0.0)
        if prediction is not None:
            quarters, corner, share = match_corners(_corners(prediction.nodes), form.corners)
            form, stray = form.turned(quarters), (corner, share)
        form = replace(form, interpolated=~cloud.carries(form.points))
        off = float(form.interpolated.mean())
        # A cloud is assessed as it lies unrolled, where a bent side does not wind.
        measures = assess_lattice(flat.reshape(FINE, FINE, 2))
        kinked = math.degrees(kink)
        reason, quality = validate_sheet(off, measures, cloud.noun, kinked, stray, self.freedom, self.model)
        return Fit(form, quality, reason, form.points, _GRID, 0.0, cloud, 0.0)

    def _rejection_reason(self, observed: Observed, width: float, tracked: bool) -> str:
        """Return why an object cannot be a sheet: a speck, a ribbon, pieces, corners out of sight, or no outline."""
        unit, model = observed.unit, self.model
        if width < model.min_width * observed.resolution:
            return f"the {observed.noun} is {width:.3g} {unit} wide: too small for a sheet"
        if not tracked and observed.length > model.max_aspect * width:
            return f"the {observed.noun} is {observed.length:.4g} x {width:.4g} {unit}: too slender for a sheet"
        if isinstance(observed, Region):
            piece = observed.areas[0] / observed.area
            if piece < model.min_piece:
                return f"the mask falls into {observed.pieces} pieces, and the largest is {piece:.0%} of it"
            if not tracked and observed.cut_share > model.max_cut:
                cut = f"{observed.cut_share:.0%} of the outline lies on the image's edge"
                return f"{cut}: the sheet's corners are out of sight"
        elif not np.ptp(observed.sheet_outline()[1], axis=0).any():
            return f"the outline of the {observed.noun} has no extent"
        return ""

    def apply_index_order(self, form: FittedLattice, seen: Array, target: Array | None) -> FittedLattice:
        """Return the lattice with its first corner nearest the target; else rows run right and columns down."""
        if target is not None:
            corners = form.with_points(seen).corners
            return form.turned(int(np.argmin(np.sum((corners - target) ** 2, axis=1))))
        lattice = form.with_points(seen).lattice
        right, down = (lattice[:, -1] - lattice[:, 0]).mean(axis=0), (lattice[-1] - lattice[0]).mean(axis=0)
        right, down = (way / max(float(np.linalg.norm(way)), 1e-9) for way in (right, down))
        level, upright = right[0] + down[1], down[0] - right[1]
        return form.turned(int(np.argmax([level, upright, -level, -upright])))

    def resample(self, form: FittedLattice, metric: FittedLattice) -> Points:
        """Return points with equal gaps down and across, on the mean over the lattice."""
        where = *metric.gauges, self.rows, self.cols, self.ends != "tips"
        places = sample_lattice(form.points.reshape(form.rows, -1, form.points.shape[1]), *where)
        lattice = metric.points.reshape(metric.rows, -1, metric.points.shape[1])
        hidden = np.zeros(len(places), bool)
        if form.interpolated.any():
            share = form.interpolated.reshape(form.rows, -1, 1).astype(np.float64)
            hidden = sample_lattice(share, *where)[:, 0] > 0.5
        if lattice.shape[2] == 3 and form.points.shape[1] == 2:
            hidden |= uneven_places(sample_lattice(lattice, *where).reshape(self.rows, self.cols, 3))
        off = np.zeros(0) if form.off is None else sample_lattice(form.off.reshape(form.rows, -1, 1), *where)[:, 0]
        return Points(places, hidden, off=off)

    @property
    def compiled_functions(self) -> tuple[Any, ...]:
        """The compiled functions that a fit may call."""
        maps = (batch_epochs, gather_cells, undo_shrinkage) if self.epochs else ()
        return SHEET_FUNCTIONS + ISOMETRY_FUNCTIONS + (uneven_places, blend_sides) + maps


def _corners(nodes: Array) -> Array:
    """Return ``(4, D)`` the corners of a lattice of 25 rows and columns, clockwise."""
    return np.ascontiguousarray(nodes[[0, FINE - 1, FINE * FINE - 1, FINE * (FINE - 1)]])
