"""Surface: a cloth or a towel as a lattice of points, row by row, each on its material."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Final, cast

import numpy as np
import numpy.typing as npt

from shape_obs.configurations.base import Configuration, Ends, Points
from shape_obs.geometry.coons import FINE
from shape_obs.geometry.curve import NO_VALUES
from shape_obs.geometry.lattice import FittedLattice, lattice_gauges, sample_lattice, uneven_places
from shape_obs.geometry.observed import Observed
from shape_obs.geometry.outline import material_outline
from shape_obs.geometry.polyline import arc_length, interpolate
from shape_obs.geometry.topology import Grid
from shape_obs.image.connected_runs import gather_cells
from shape_obs.image.region import Region
from shape_obs.point_cloud.local_pca import moments_within
from shape_obs.tracking.isometry import folded_reason
from shape_obs.tracking.measure_lattice import CELL, even_inside, patch_in_cloud
from shape_obs.tracking.model import LatticeModel
from shape_obs.tracking.predict import Before, Fit, Prediction, Track, unknown_before
from shape_obs.tracking.register_lattice import first_corner
from shape_obs.tracking.scene import NO_MASK, InMask, Scene
from shape_obs.tracking.state import ShapeState
from shape_obs.tracking.step_lattice import NO_CLOUD, InCloud, SheetStep, step_sheet
from shape_obs.tracking.validation import NO_CORNERS, NO_FAULT, sheet_fault

if TYPE_CHECKING:
    from shape_obs.point_cloud.cloud import Cloud

Array = npt.NDArray[np.float64]

_GRID: Final = Grid(FINE, FINE)  # the nodes that are kept from frame to frame, for any lattice that is sampled
_COMPILED: Final = (
    step_sheet, patch_in_cloud, first_corner, lattice_gauges, sample_lattice, uneven_places, arc_length, interpolate,
    material_outline, moments_within,
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
        if prediction is not None:
            before = prediction.before
        else:
            before = unknown_before(np.zeros(1, ShapeState), observed.dimension, scene.clock.now)
        if isinstance(observed, Region):
            found = self._step(scene.in_mask(observed), NO_CLOUD, target, before)
            reason = self._rejection_reason(observed, found.width, prediction is not None)
        else:
            reason, found = self._rejection_reason(observed, observed.width, prediction is not None), None
            if not reason:
                found = self._step_in_cloud(cast("Cloud", observed), prediction, target, before, scene)
                reason = sheet_fault((NO_CORNERS, 0, 0.0, 0.0), observed.noun) if found is None else ""
        if reason or found is None or (reason := sheet_fault(found.fault, observed.noun)):
            return Fit(reason=reason)
        folded = "" if found.flat else folded_reason(found.folded)
        gauges = found.down, found.right
        form = FittedLattice(found.nodes, found.hidden, gauges, FINE, off=found.off, ambiguity=folded)
        if self.epochs:
            samples = observed.gather(CELL)
            form = form.with_points(even_inside(form.points, samples.points, samples.weight, self.epochs))
        track = Track(found.state, found.nodes, found.velocity, _GRID, reference=found.reference)
        return Fit(form, found.quality, folded if prediction is None else "", track, observed, found.width)

    def _step(self, image: InMask, cloud: InCloud, target: Array | None, before: Before) -> SheetStep:
        """Follow the sheet into this frame, in one compiled call."""
        target, size = NO_VALUES if target is None else target, (self.rows, self.cols)
        return step_sheet(image, cloud, size, self.freedom, target, before, self.model.record)

    def _step_in_cloud(
        self, cloud: Cloud, prediction: Prediction | None, target: Array | None, before: Before, scene: Scene
    ) -> SheetStep | None:
        """Follow a sheet that is unrolled: its corners are nearest to those predicted, or else the best, if any."""
        nodes = np.empty((0, 3)) if prediction is None else prediction.nodes
        outline, flat = (np.ascontiguousarray(each, dtype=np.float64) for each in cloud.sheet_outline())
        region, found = cloud.parts[-1], None
        image = scene.in_mask(region) if isinstance(region, Region) else NO_MASK  # that it was seen in
        for best in (False, True) if prediction is not None else (True,):
            patch, kink, measures = patch_in_cloud(outline, flat, nodes, best)
            found = None
            if not len(patch):
                continue
            lattice = np.ascontiguousarray(cloud.to_space(patch), dtype=np.float64)
            seen = np.ascontiguousarray(cloud.seen(lattice, target), dtype=np.float64)
            measured = lattice, cloud.carries(lattice), seen, kink, measures, cloud.resolution
            found = self._step(image, measured, target, before)
            if found.fault[0] == NO_FAULT:
                break
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
        seen = np.ascontiguousarray(seen, dtype=np.float64)
        return form.turned(first_corner(seen, NO_VALUES if target is None else target))

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
        off = sample_lattice(form.off.reshape(form.rows, -1, 1), *where)[:, 0] if len(form.off) else NO_VALUES
        return Points(places, hidden, off=off)

    @property
    def compiled_functions(self) -> tuple[Any, ...]:
        """The compiled functions that a fit may call."""
        return (*_COMPILED, even_inside, gather_cells) if self.epochs else _COMPILED
