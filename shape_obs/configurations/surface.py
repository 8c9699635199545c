"""Surface: a cloth or a towel as a lattice of points, row by row, each on its material."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.ndimage import map_coordinates

from shape_obs.clustering.som import batch_epochs, run_som
from shape_obs.compiled import compiled
from shape_obs.configurations.base import Configuration, Ends, Points, Scene
from shape_obs.geometry.coons import FINE, coons_patch
from shape_obs.geometry.lattice import FittedLattice, assess_lattice, lattice_gauges, outer_corners, sample_lattice
from shape_obs.geometry.observed import Observed
from shape_obs.geometry.outline import material_outline
from shape_obs.geometry.polyline import arc_length, interpolate
from shape_obs.geometry.topology import Grid, undo_shrinkage
from shape_obs.image.connected_runs import gather_cells, near_mask
from shape_obs.image.region import Region
from shape_obs.initialization.corners import Indices, Rim, nearest_corners, rim_of
from shape_obs.tracking.corner_matching import STRAYED, match_lattice
from shape_obs.tracking.prediction import MAX_SIZE_CHANGE, Fit, Prediction
from shape_obs.tracking.validation import validate_sheet

Array = npt.NDArray[np.float64]

_GRID: Final = Grid(8, 8)  # the nodes that are kept from frame to frame, for any lattice that is sampled
_MIN_SIDE: Final = 6.0  # in units of the resolution: what is narrower has no two sides that can be distinguished
_MAX_ASPECT: Final = 8.0  # length over width; what is longer is a ribbon, whose corners are its ends
_CELL: Final = 8  # pixels
_SIGMA: Final = 0.5  # width of the map's neighbourhood, node units
_MAX_CUT: Final = 0.03  # of the outline
_NO_CORNERS: Final = "the outline's corners are not where the lattice's are"
_ANY_CORNERS: Final = np.empty(0, np.int64)
_NOTHING_EXPECTED: Final = np.empty((0, 0, 2))
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
            material (1.1, 1.3, 1.6 px over drawn sheets with 0, 1, 3), and away from what hides the inside.
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

    @cached_property
    def layout(self) -> Grid:
        """A lattice of rows x cols points."""
        return Grid(self.rows, self.cols)

    def fit(self, observed: Observed, prediction: Prediction | None, target: Array | None, scene: Scene) -> Fit:
        """Lay a Coons patch between the corners nearest to the predicted ones, else between the best four corners."""
        reason = self._rejection_reason(observed)
        if reason:
            return Fit(reason=reason)
        found = Fit(reason="no corners were predicted")
        expected = None if prediction is None else prediction.nodes.reshape(_GRID.rows, _GRID.cols, -1)
        if expected is not None:
            found = self._lay_patch(observed, None, expected)
        if found.reason or (prediction is not None and abs(found.size / prediction.size - 1) > MAX_SIZE_CHANGE):
            rim = Rim.along(*observed.sheet_outline())
            corners = rim.corners()
            if corners is None:
                return Fit(reason=f"the outline has {len(rim.candidates)} corners, a sheet has four")
            found = self._lay_patch(observed, corners, expected)
        if found.reason or prediction is not None:
            return found
        form = self.apply_index_order(found.form, observed.seen(found.form.points, target), target)
        return found._replace(form=form, nodes=form.evenly(_GRID.rows, _GRID.cols, centers=True))

    def _lay_patch(self, observed: Observed, corners: Indices | None, expected: Array | None) -> Fit:
        """Lay the patch, move its inside with the map if that is asked for, match it to the track, validate it.

        Args:
            observed: The sheet.
            corners: ``(4,)`` points of its rim; None for those nearest to the predicted ones.
            expected: ``(R, C, D)`` the predicted nodes; None at a cold start.
        """
        predicted = expected if expected is not None else _NOTHING_EXPECTED
        if isinstance(observed, Region) and not self.epochs:
            laid = corners if corners is not None else _ANY_CORNERS
            (left, top), traced = observed.window[:2], observed.outline.traced
            points, on_object, kink, stray, share, measures, down, right, nodes = fit_patch_in_mask(
                traced, observed.mask, left, top, laid, predicted
            )
            if not len(points):
                return Fit(reason=_NO_CORNERS)
            form = FittedLattice(points, ~on_object, (down, right), FINE)
        else:
            rim = Rim.along(*observed.sheet_outline())
            if corners is None and expected is not None:
                corners = rim.corners_near(outer_corners(expected))
            if corners is None:
                return Fit(reason=_NO_CORNERS)
            flat, kink = rim.patch(corners)
            form = FittedLattice.over(observed.to_space(flat), np.zeros(len(flat), bool), FINE)
            if self.epochs:
                form = form.with_points(form.points + self._moved_inside(form, observed))
            lattice, stray, share = match_lattice(form.lattice, predicted)
            points = lattice.reshape(form.points.shape)
            form = FittedLattice.over(points, ~observed.carries(points), FINE)
            # A cloud is assessed as it lies unrolled, where a bent side does not wind.
            measures = assess_lattice((points if observed.dimension == 2 else flat).reshape(FINE, FINE, 2))
            nodes = form.evenly(_GRID.rows, _GRID.cols, centers=True)
        off = np.count_nonzero(form.interpolated) / len(form.interpolated)
        degrees, strays = math.degrees(kink), (stray, share)
        reason, quality = validate_sheet(off, measures, observed.noun, degrees, strays, self.freedom)
        size = float(form.gauges[0][-1] + form.gauges[1][-1])
        width = observed.width if observed.dimension == 2 else 0.0
        return Fit(form, quality, reason, nodes, _GRID, size, width, observed, width)

    def _rejection_reason(self, observed: Observed) -> str:
        """Return why an object cannot be a sheet: a speck, a ribbon, pieces, corners out of sight, or no outline."""
        width, length, unit = observed.width, observed.length, observed.unit
        if width < _MIN_SIDE * observed.resolution:
            return f"the {observed.noun} is {width:.3g} {unit} wide: too small for a sheet"
        if length > _MAX_ASPECT * width:
            return f"the {observed.noun} is {length:.4g} x {width:.4g} {unit}: too slender for a sheet"
        if isinstance(observed, Region):
            piece, cut = observed.outlined_share, observed.cut_share
            if piece < _MIN_PIECE:
                return f"the mask falls into {observed.pieces} pieces, and the largest is {piece:.0%} of it"
            if cut > _MAX_CUT:
                return f"{cut:.0%} of the outline lies on the image's edge: the sheet's corners are out of sight"
        elif not np.ptp(observed.sheet_outline()[1], axis=0).any():
            return f"the outline of the {observed.noun} has no extent"
        return ""

    def _moved_inside(self, form: FittedLattice, observed: Observed) -> Array:
        """Return how the self-organising map moves the points of a patch: ``(P, D)``, nothing at its border."""
        start = form.evenly(_GRID.rows, _GRID.cols, centers=True)
        nodes = run_som(observed.gather(_CELL), start, _GRID, self.epochs * (_SIGMA,))
        moved = np.pad(_GRID.lattice(nodes - start), ((1, 1), (1, 1), (0, 0)))
        at = []
        for count, gauge in zip((_GRID.rows, _GRID.cols), form.gauges, strict=True):
            middles = np.interp((np.arange(count) + 0.5) / count * gauge[-1], gauge, np.arange(FINE))
            knots = np.concatenate([[0.0], middles, [FINE - 1.0]])
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
        where = *metric.gauges, self.rows, self.cols, self.ends != "tips"
        places = _points_over(form.points.reshape(form.rows, -1, form.points.shape[1]), *where)
        if not form.interpolated.any():
            return Points(places, np.zeros(len(places), bool))
        share = form.interpolated.reshape(form.rows, -1, 1).astype(np.float64)
        return Points(places, _points_over(share, *where)[:, 0] > 0.5)

    @property
    def compiled_functions(self) -> tuple[Any, ...]:
        """The compiled functions that a fit may call."""
        masks = fit_patch_in_mask, _points_over, rim_of, material_outline, coons_patch, nearest_corners, match_lattice
        lattices = assess_lattice, lattice_gauges, outer_corners, sample_lattice, arc_length, interpolate
        maps = (batch_epochs, gather_cells, undo_shrinkage) if self.epochs else ()
        return masks + lattices + maps


@compiled("(f8[:,::1], u1[:,::1], i8, i8, i8[::1], f8[:,:,::1])")
def fit_patch_in_mask(
    traced: Array, mask: npt.NDArray[np.uint8], left: int, top: int, corners: Indices, expected: Array
) -> tuple[Array, npt.NDArray[np.bool_], float, int, float, tuple[float, float, float, float], Array, Array, Array]:
    """Lay the Coons patch of a sheet in a mask, match it to the track and measure it, all in one call.

    Args:
        traced: ``(P, 2)`` pixels, through the centres of the outline's border pixels.
        mask: ``(h, w)`` uint8, C-contiguous.
        left: Image column of its first pixel.
        top: Image row of its first pixel.
        corners: ``(4,)`` points of the rim; ``(0,)`` for those nearest to the predicted ones.
        expected: ``(R, C, 2)`` the predicted nodes; ``(0, 0, 2)`` at a cold start.

    Returns:
        ``(625, 2)`` points, numbered as predicted, none if the corners are not in order; whether the mask has a pixel
        there; the kink, radians; the corner that strays most, and by which share of half a diagonal; see
        ``assess_lattice``; ``lattice_gauges``; ``(64, 2)`` the nodes.
    """
    rim, turn, candidates, step, grain = rim_of(material_outline(traced, False)[1])
    if len(corners) == 0:
        corners = nearest_corners(rim, candidates, step, outer_corners(expected))
    if len(corners) == 0:
        nothing = np.empty((0, 2))
        return nothing, np.empty(0, np.bool_), 0.0, 0, 0.0, (0.0, 0.0, 0.0, 0.0), step * turn[:0], turn[:0], nothing
    patch, kink = coons_patch(rim, turn, corners, step, grain)
    lattice, corner, share = match_lattice(patch.reshape(FINE, FINE, 2), expected)
    down, right = lattice_gauges(lattice)
    nodes = sample_lattice(lattice, down, right, 8, 8, True)
    patch = lattice.reshape(FINE * FINE, 2)
    on_mask = near_mask(mask, left, top, patch, 1)
    return patch, on_mask, kink, corner, share, assess_lattice(lattice), down, right, nodes


@compiled("(f8[:,:,::1], f8[::1], f8[::1], i8, i8, b1)")
def _points_over(lattice: Array, down: Array, right: Array, rows: int, cols: int, centers: bool) -> Array:
    """Return ``(rows*cols, D)`` points of a lattice with equal gaps down and across, on the mean."""
    return sample_lattice(lattice, down, right, rows, cols, centers)
