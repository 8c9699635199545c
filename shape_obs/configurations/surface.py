"""Surface: a cloth or a towel as a lattice of points, row by row, each on its material."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from shape_obs.clustering.som import batch_epochs
from shape_obs.configurations.base import Configuration, Ends, Points
from shape_obs.configurations.sheet_map import moved_inside
from shape_obs.geometry.coons import FINE
from shape_obs.geometry.curve import NO_VALUES
from shape_obs.geometry.lattice import FittedLattice, lattice_gauges, sample_lattice, uneven_places
from shape_obs.geometry.observed import Observed
from shape_obs.geometry.outline import material_outline
from shape_obs.geometry.polyline import arc_length, interpolate
from shape_obs.geometry.topology import Grid, undo_shrinkage
from shape_obs.image.connected_runs import gather_cells
from shape_obs.image.region import Region
from shape_obs.tracking.isometry import Isometry, isometry_in_image, isometry_in_space
from shape_obs.tracking.measure_lattice import patch_in_cloud
from shape_obs.tracking.model import LatticeModel
from shape_obs.tracking.predict import (
    NO_BOX,
    Fit,
    Prediction,
    ShapeBefore,
    Track,
    known_before,
    turned_sheet,
)
from shape_obs.tracking.scene import Scene
from shape_obs.tracking.step_lattice import advance_sheet, register_in_cloud, step_sheet
from shape_obs.tracking.validation import NO_CORNERS, NO_FAULT, judge_sheet, sheet_fault

Array = npt.NDArray[np.float64]

_GRID: Final = Grid(FINE, FINE)  # the nodes that are kept from frame to frame, for any lattice that is sampled
_COMPILED: Final = (
    step_sheet, advance_sheet, patch_in_cloud, register_in_cloud, judge_sheet, isometry_in_image,
    isometry_in_space, lattice_gauges, sample_lattice, uneven_places, arc_length, interpolate, material_outline,
)  # fmt: skip


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
        before = known_before(prediction, observed.dimension, scene.clock.now)
        if isinstance(observed, Region):
            found = self._fit_in_image(observed, before, scene)
        else:
            found = self._fit_in_cloud(observed, prediction, before)
        if found.track is None:
            return found
        form, track = found.form, found.track
        if prediction is None:
            quarters = self._quarters(form, observed.seen(form.points, target), target)
            form, track = form.turned(quarters), turned_sheet(track, quarters)
        box, model = observed.box[:4] if observed.box else NO_BOX, self.model.record
        velocity = advance_sheet(track.state, form.points, form.size, found.object_width, box, before, model)
        found = found._replace(form=form, track=track._replace(nodes=form.points, velocity=velocity))
        return self._judge_isometry(found, observed, before, scene)

    def _fit_in_image(self, region: Region, before: ShapeBefore, scene: Scene) -> Fit:
        """Fit a sheet in a mask, in one compiled call."""
        own, around = scene.around(region)
        fault, quality, lattice, hidden, state, known, down, right, width = step_sheet(
            *own, *around, (self.rows, self.cols), self.freedom, before, self.model.record
        )
        reason = self._rejection_reason(region, width, len(before[1]) > 0) or sheet_fault(fault, Region.noun)
        if reason:
            return Fit(reason=reason)
        form = self._evened(FittedLattice(lattice, hidden, (down, right), FINE), region)
        return Fit(form, quality, "", Track(state, lattice, lattice, _GRID, reference=known), region, width)

    def _evened(self, form: FittedLattice, observed: Observed) -> FittedLattice:
        """Return a lattice, its inside moved with the map where there are ``epochs`` of it."""
        return form.with_points(form.points + moved_inside(form, observed, self.epochs)) if self.epochs else form

    def _fit_in_cloud(self, observed: Observed, prediction: Prediction | None, before: ShapeBefore) -> Fit:
        """Lay the patch over a sheet that is unrolled: between the corners nearest to those predicted, or the best."""
        reason = self._rejection_reason(observed, observed.width, prediction is not None)
        if reason:
            return Fit(reason=reason)
        nodes = np.empty((0, 3)) if prediction is None else prediction.nodes
        outline, flat = (np.ascontiguousarray(each, dtype=np.float64) for each in observed.sheet_outline())
        fault = NO_CORNERS, 0, 0.0, 0.0
        for best in (False, True) if len(nodes) else (True,):
            patch, kink, measures = patch_in_cloud(outline, flat, nodes, best)
            fault = NO_CORNERS, 0, 0.0, 0.0
            if not len(patch):
                continue
            form = FittedLattice.over(observed.to_space(patch), np.zeros(len(patch), bool), FINE)
            form = self._evened(form, observed)
            quarters, state, code, side = register_in_cloud(
                np.ascontiguousarray(form.points), observed.resolution, nodes, before, self.model.record
            )
            form = form.turned(quarters)
            form = replace(form, interpolated=~observed.carries(form.points))
            off = float(form.interpolated.mean())
            fault, quality = judge_sheet(off, measures, kink, 0, 0.0, self.freedom, self.model.record)
            fault = fault if code == NO_FAULT else (code, side, 0.0, 0.0)
            if fault[0] == NO_FAULT:
                track = Track(state, form.points, form.points, _GRID)
                return Fit(form, quality, "", track, observed)
        return Fit(reason=sheet_fault(fault, observed.noun))

    def _judge_isometry(self, found: Fit, observed: Observed, before: ShapeBefore, scene: Scene) -> Fit:
        """Mark what is folded or crumpled, a sheet or single nodes, as uncertain: it teaches no side lengths.

        A new sheet is refused.
        """
        form, (rows, cols), camera, model = found.form, (self.rows, self.cols), scene.intrinsics, self.model
        if camera is not None and scene.depth is not None:
            lattice = form.points if observed.dimension == 2 else camera.project(form.points)
            region = observed.parts[-1]  # of a cloud too: the mask that it was seen in
            seen = lattice, form.interpolated, scene.images, region.mask, region.window[:2]
            isometry = Isometry(*isometry_in_image(*seen, camera.lens, rows, cols, model.record))
        elif observed.dimension == 3:
            isometry = Isometry(*isometry_in_space(np.ascontiguousarray(form.points), rows, cols, model.record))
        else:
            return found
        uncertain, share = isometry.verdict(model)
        flags = form.interpolated | (isometry.off > model.uncertain * isometry.gap)
        form = replace(form, interpolated=flags, off=isometry.off, ambiguity=uncertain)
        found = found._replace(form=form, quality=found.quality * share)
        if not uncertain:
            return found
        state, last = before[:2]
        if not len(last):
            return found._replace(reason=uncertain)
        assert found.track is not None
        found.track.state["sides"] = state["sides"]
        return found

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
        return form.turned(self._quarters(form, seen, target))

    def _quarters(self, form: FittedLattice, seen: Array, target: Array | None) -> int:
        """Return how many corners further on, clockwise, the paper's rule puts the first corner of a lattice."""
        flat = form.with_points(seen)
        if target is not None:
            return int(np.argmin(np.sum((flat.corners - target) ** 2, axis=1)))
        lattice = flat.lattice
        right, down = (lattice[:, -1] - lattice[:, 0]).mean(axis=0), (lattice[-1] - lattice[0]).mean(axis=0)
        right, down = (way / max(float(np.linalg.norm(way)), 1e-9) for way in (right, down))
        level, upright = right[0] + down[1], down[0] - right[1]
        return int(np.argmax([level, upright, -level, -upright]))

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
        off = NO_VALUES if form.off is None else sample_lattice(form.off.reshape(form.rows, -1, 1), *where)[:, 0]
        return Points(places, hidden, off=off)

    @property
    def compiled_functions(self) -> tuple[Any, ...]:
        """The compiled functions that a fit may call."""
        maps = (batch_epochs, gather_cells, undo_shrinkage) if self.epochs else ()
        return _COMPILED + maps
