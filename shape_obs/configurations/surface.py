"""Surface: a cloth or a towel as a lattice of points, row by row, each on its material."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final

import numpy as np
import numpy.typing as npt
from scipy.ndimage import map_coordinates

from shape_obs.clustering.som import batch_epochs, run_som
from shape_obs.configurations.base import Configuration, Ends, Points
from shape_obs.geometry.coons import FINE, coons_patch
from shape_obs.geometry.lattice import FittedLattice, assess_lattice, lattice_gauges, outer_corners, sample_lattice
from shape_obs.geometry.observed import Observed
from shape_obs.geometry.outline import material_outline
from shape_obs.geometry.polyline import arc_length, interpolate
from shape_obs.geometry.topology import Grid, undo_shrinkage
from shape_obs.image.connected_runs import gather_cells
from shape_obs.initialization.corners import Indices, Rim, nearest_corners, rim_of
from shape_obs.tracking.corner_matching import STRAYED, match_corners, match_corners_plane
from shape_obs.tracking.prediction import Fit, Prediction, size_jump
from shape_obs.tracking.validation import validate_sheet

Array = npt.NDArray[np.float64]

_GRID: Final = Grid(8, 8)  # the nodes that are remembered from frame to frame, whatever lattice is sampled
_MIN_SIDE: Final = 6.0  # in units of the resolution: what is narrower has no two sides that can be distinguished
_MAX_ASPECT: Final = 8.0  # length over width; what is longer is a ribbon, whose corners are its ends
_CELL: Final = 8  # pixels
_SIGMA: Final = 0.5  # width of the map's neighbourhood, node units
_MAX_CUT: Final = 0.03  # of the outline
_MIN_PIECE: Final = 0.8  # of the mask: the largest piece, since a sheet cannot be connected over a gap


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
            material (1.1, 1.3, 1.6 px over drawn sheets with 0, 1, 3), and away from whatever hides the inside.
        freedom: How far a corner may move from one frame to the next that the three others do not, as a share of half
            a diagonal. Beyond it something lies over that corner, and the shape is refused. Where grippers move
            single corners give more.
    """

    rows: int = 4
    cols: int = 8
    ends: Ends | None = None
    epochs: int = 0
    freedom: float = STRAYED

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (2 <= self.rows <= 100 and 2 <= self.cols <= 100):
            raise ValueError(f"surface: rows and cols must lie in 2...100, got {self.rows} and {self.cols}.")
        if not 0 <= self.epochs <= 100:
            raise ValueError(f"surface: epochs must lie in 0...100, got {self.epochs}.")
        if not 0 < self.freedom <= 1:
            raise ValueError(f"surface: freedom must lie above 0, up to 1, got {self.freedom}.")

    @property
    def layout(self) -> Grid:
        """A lattice of rows x cols points."""
        return Grid(self.rows, self.cols)

    def rejection_reason(self, observed: Observed) -> str:
        """Return why an object cannot be a sheet: a speck, a ribbon, pieces, corners out of sight, or no outline."""
        length, width, unit = observed.length, observed.width, observed.unit
        if width < _MIN_SIDE * observed.resolution:
            return f"the {observed.noun} is {width:.3g} {unit} wide: too small for a sheet"
        if length > _MAX_ASPECT * width:
            return f"the {observed.noun} is {length:.4g} x {width:.4g} {unit}: too slender for a sheet"
        if observed.dimension == 2:
            piece, cut = observed.outlined_share, observed.cut_share
            if piece < _MIN_PIECE:
                return f"the mask falls into {observed.pieces} pieces, and the largest is {piece:.0%} of it"
            if cut > _MAX_CUT:
                return f"{cut:.0%} of the outline lies on the image's edge: the sheet's corners are out of sight"
        elif not np.ptp(observed.sheet_outline()[1], axis=0).any():
            return f"the outline of the {observed.noun} has no extent"
        return ""

    def fit(
        self, observed: Observed, prediction: Prediction | None, target: Array | None, depth: npt.NDArray[Any] | None
    ) -> Fit:
        """Lay a Coons patch between the corners nearest to the predicted ones, else between the best four corners."""
        reason = self.rejection_reason(observed)
        if reason:
            return Fit(reason=reason)
        rim, found = Rim.along(*observed.sheet_outline()), Fit()
        if prediction is not None:
            corners = rim.corners_near(outer_corners(_GRID.lattice(prediction.nodes)))
            if corners is not None:
                found = self._refine(observed, rim, corners, prediction)
        if not found.ok or (prediction is not None and size_jump(prediction, found.form)):
            corners = rim.corners()
            if corners is None:
                return Fit(reason=f"the outline has {len(rim.candidates)} corners, a sheet has four")
            found = self._refine(observed, rim, corners, prediction)
        if not found.ok:
            return found
        form: FittedLattice = found.form
        if prediction is None:
            form = self.apply_index_order(form, observed.seen(form.points, target), target)
        nodes = form.evenly(_GRID.rows, _GRID.cols, centers=True)
        width = observed.width if observed.dimension == 2 else 0.0
        return found._replace(form=form, nodes=nodes, topology=_GRID, width=width)

    def _refine(self, observed: Observed, rim: Rim, corners: Indices, prediction: Prediction | None) -> Fit:
        """Lay the patch, move its inside with the map if that is asked for, match it to the track, validate it."""
        flat, kink = rim.patch(corners)
        points = observed.to_space(flat)
        form = FittedLattice(points, np.zeros(len(points), bool), rows=FINE, kink=kink)
        if self.epochs:
            form = form.with_points(points + self._moved_inside(form, observed))
        form = replace(form, interpolated=~observed.carries(form.points))
        if prediction is not None:
            form = match_corners(form, _GRID.lattice(prediction.nodes), self.freedom)
        if form.ambiguity:
            return Fit(form, 0.0, form.ambiguity)
        # A cloud is validated as it lies unrolled, where a bent side does not wind.
        judged = form if observed.dimension == 2 else form.with_points(flat)
        reason, quality = validate_sheet(judged, observed, math.degrees(kink))
        return Fit(form, quality, reason, observed=observed)

    def _moved_inside(self, form: FittedLattice, observed: Observed) -> Array:
        """Return how the self-organising map moves the points of a patch: ``(P, D)``, nothing at its border."""
        start = form.evenly(_GRID.rows, _GRID.cols, centers=True)
        nodes = run_som(observed.gather(_CELL), start, _GRID, self.epochs * (_SIGMA,))
        moved = np.pad(_GRID.lattice(nodes - start), ((1, 1), (1, 1), (0, 0)))
        at = []
        for count, places in zip(
            (_GRID.rows, _GRID.cols), _equal_gaps(form, _GRID.rows, _GRID.cols, "centers"), strict=True
        ):
            knots = np.concatenate([[0.0], places, [FINE - 1.0]])
            at.append(np.interp(np.arange(FINE), knots, np.arange(count + 2)))
        fine = np.stack(np.meshgrid(*at, indexing="ij")).reshape(2, -1)
        return np.stack([map_coordinates(moved[..., d], fine, order=1) for d in range(moved.shape[2])], axis=1)

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
        ends = self.ends or "centers"
        if form is metric and form.whole:
            return Points(form.evenly(self.rows, self.cols, centers=ends == "centers"), np.zeros(self.count, bool))
        at = _equal_gaps(metric, self.rows, self.cols, ends)
        return Points(form.at(*at), form.interpolated_at(*at))

    compiled: ClassVar[tuple[Any, ...]] = (
        arc_length,
        assess_lattice,
        batch_epochs,
        coons_patch,
        gather_cells,
        interpolate,
        lattice_gauges,
        match_corners_plane,
        material_outline,
        nearest_corners,
        outer_corners,
        rim_of,
        sample_lattice,
        undo_shrinkage,
    )


def _equal_gaps(form: FittedLattice, rows: int, cols: int, ends: Ends) -> tuple[Array, Array]:
    """Return places on a lattice, ``(rows,)`` down and ``(cols,)`` across, with equal gaps on the mean."""
    found = []
    for count, gauge in zip((rows, cols), form.gauges, strict=True):
        share = np.linspace(0, 1, count) if ends == "tips" else (np.arange(count) + 0.5) / count
        found.append(np.interp(share * gauge[-1], gauge, np.arange(len(gauge))))
    return found[0], found[1]
