"""Measure a sheet: its border, in space with depth, and the lattice over it, compared with what is known of it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.frame import DEPTH_TYPE, DepthImages
from shape_obs.geometry.coons import FINE, RIM, border_of, coons_patch, side_lengths
from shape_obs.geometry.lattice import assess_lattice, lattice_gauges, sample_lattice
from shape_obs.geometry.outline import SAMPLED, material_outline
from shape_obs.geometry.polyline import arc_length, closed, interpolate
from shape_obs.image.connected_runs import near_mask
from shape_obs.image.outline_tracing import trace_largest
from shape_obs.initialization.corners import nearest_corners, rim_of
from shape_obs.tracking.complete_lattice import Edges, Lens, rim_depth
from shape_obs.tracking.measure_ring import MIN_SAMPLES, lifted
from shape_obs.tracking.model import DepthLimits, LatticeConstants, LatticeModel, Model  # noqa: F401 - in a signature
from shape_obs.tracking.register_lattice import FITS, assign_corners, compare_sheet, known_slack, match_corners
from shape_obs.tracking.sheet_view import SheetView, doubtful_places, learn_sheet

if TYPE_CHECKING:
    from shape_obs.image.region import Region
    from shape_obs.tracking.scene import Scene

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.uint8]
Flags = npt.NDArray[np.bool_]

NO_CORNERS, OUT_OF_SIGHT = 4, 5  # what may be wrong with a sheet besides what ``compare_sheet`` returns
SHEET_WRONG: Final = (
    "",
    "side {} is shorter than it was: something hides a part of the sheet",
    "side {} is longer than it was: something hides a part of the sheet",
    "a side is not where it was: something hides a part of the sheet",
    "the outline's corners are not where the lattice's are",
    "the sheet runs out of the camera's sight",
)
UNBENT: Final = (90.0, 0.0, 0.0, 0.0)  # what ``assess_lattice`` returns of a rectangle
_MAX_PIXEL: Final = 1e12  # farther off, a projected point counts as out of sight


@compiled("(u1[:,::1], i8[:,::1], i8, i8, i8, " + DEPTH_TYPE + ", UniTuple(i8, 4), UniTuple(f8, 4), UniTuple(f8, 7))")
def see_sheet(
    mask: Mask, runs: Indices, pieces: int, left: int, top: int, depth: DepthImages,
    edge: Edges, camera: Lens, limits: DepthLimits,
) -> tuple[Array, Array, Indices, float, float, Array, Array, Flags, float]:  # fmt: skip
    """Return the outline of the largest piece of a mask as the rim of a sheet, and put it in space.

    Args:
        mask: As ``step_ring_in_mask`` takes it, and all up to the camera.
        runs: Of the mask.
        pieces: Components.
        left: Image column.
        top: Image row.
        depth: The frame's.
        edge: Of what is searched.
        camera: A pinhole.
        limits: As ``rim_depth`` takes it.

    Returns:
        The five of ``rim_of``; the rim in metres ``(400, 3)``, ``(0, 3)`` without depth; ``(400,)`` depth, metres or
        NaN; ``(400,)`` whether something lies over it; the width of the piece, whose rim is empty if it has few pixels.
    """
    traced, width = trace_largest(mask, runs, pieces, left, top)
    if len(traced) <= SAMPLED * (MIN_SAMPLES - 1):
        nothing = np.empty(0)
        return np.empty((0, 2)), nothing, np.empty(0, np.int64), 0.0, 0.0, np.empty((0, 3)), nothing, nothing > 0, width
    rim, turn, candidates, step, grain = rim_of(material_outline(traced, False)[1])
    z, cut = rim_depth(depth, edge, mask, left, top, rim, width, limits)
    return rim, turn, candidates, step, grain, lifted(rim, z, camera), z, cut, width


def view_sheet(region: Region, scene: Scene, model: LatticeModel) -> SheetView:
    """Return the outline of a region as the rim of a sheet, in space if the frame has depth along it."""
    own, around = scene.around(region)
    rim, turn, candidates, step, grain, space, z, cut, width = see_sheet(*own, *around, model.depth_limits)
    camera = scene.intrinsics
    if camera is not None and camera.model != "pinhole" and len(z) and np.isfinite(z).all():
        there = camera.deproject(rim, z)
        space = there if np.isfinite(there).all() else space
    space, camera = (space, camera) if len(space) else (rim, None)
    return SheetView(region, rim, turn, candidates, step, grain, space, cut, camera, width, around[-1], model)


@compiled("(f8[:,::1], f8[::1], i8[::1], f8, f8, f8[:,::1], i8[::1], f8[:,::1])")
def lay_patch(
    rim: Array, turn: Array, candidates: Indices, step: float, grain: float, space: Array, corners: Indices,
    predicted: Array,
) -> tuple[Array, float, int, float]:  # fmt: skip
    """Lay a Coons patch between four corners of a rim, numbered as they are predicted.

    Args:
        rim: What ``see_sheet`` returns, and the next five; ``space`` in pixels where nothing else is known.
        turn: Radians.
        candidates: Points.
        step: Pixels.
        grain: Pixels.
        space: ``(400, D)``.
        corners: ``(4,)`` points; ``(0,)`` for those nearest to the predicted ones.
        predicted: ``(625, 2)`` pixels; ``(0, 2)`` without a track.

    Returns:
        ``(625, D)``, or ``(0, D)`` if the corners are not in order; the strongest turn between them; which corner
        strays from the others most, and how far, see ``match_corners``.
    """
    number, stray = 0, 0.0
    if len(predicted) > 0:
        expected, places = np.empty((4, 2)), np.empty((4, 2))
        for k in range(4):
            at = (0, FINE - 1, FINE * FINE - 1, FINE * (FINE - 1))[k]
            expected[k, 0], expected[k, 1] = predicted[at, 0], predicted[at, 1]
        if len(corners) == 0:
            corners = nearest_corners(rim, candidates, step, expected)
        if len(corners) == 0:
            return np.empty((0, space.shape[1])), 0.0, number, stray
        for k in range(4):
            places[k, 0], places[k, 1] = rim[corners[k], 0], rim[corners[k], 1]
        quarters, number, stray = match_corners(expected, places)
        found = corners.copy()
        for k in range(4):
            found[k] = corners[(k + quarters) % 4]
        corners = found
    patch, kink = coons_patch(space, turn, corners, step, grain)
    return patch, kink, number, stray


Judged = tuple[int, int, Array, Array, Array, Flags, float, Array, Array, tuple[float, float, float, float]]


@compiled(
    "(f8[:,::1], f8[:,::1], f8[:,::1], f8, f8[:,::1], f8[::1], u1[:,::1], i8, i8, f8, f8, b1, f8, "
    "LatticeConstants[::1])"
)
def judge_patch(
    patch: Array, lattice: Array, space: Array, step: float, known: Array, sides: Array, mask: Mask, left: int,
    top: int, rows: float, cols: float, buckled: bool, lasted: float, model: Model,
) -> Judged:  # fmt: skip
    """Compare a sheet that is seen as a whole with what is known of it, and measure it.

    Args:
        patch: ``(625, D)`` as it lies, metres or pixels.
        lattice: ``(625, 2)`` the same in pixels.
        space: ``(400, D)`` its rim.
        step: Pixels between two points of the rim.
        known: ``(625, D')`` as it was, wherever it lay; ``(0, D')`` without a track.
        sides: ``(4,)`` the lengths of its sides in the unit of ``known``.
        mask: As ``near_mask`` takes it, and the next two.
        left: Image column.
        top: Image row.
        rows: How many points are asked for from top to bottom.
        cols: The same from left to right.
        buckled: Whether sides may be shorter, see ``compare_sheet``.
        lasted: Seconds for which this frame counts.
        model: ``(1,)`` the constants.

    Returns:
        The two of ``compare_sheet``; the lattice, and the two of ``lattice_gauges``; ``(625,)`` what is hidden; the
        share that lies off the mask; what is known now, see ``learn_sheet``; the measures of ``assess_lattice``, of a
        sheet in the image alone.
    """
    metric, constants = len(known) > 0 and known.shape[1] == 3, model[0]
    hidden, measures = ~near_mask(mask, left, top, lattice, 1), UNBENT
    down, right = lattice_gauges(lattice.reshape(FINE, FINE, 2))
    off, reference, lengths = np.count_nonzero(hidden) / len(hidden), patch, sides
    if len(known) > 0:
        scale = arc_length(closed(space))[RIM] / (RIM * step) if metric else 1.0
        border = border_of(patch if metric else lattice)
        share = constants.length_tolerance[1 if metric else 0]
        slack = known_slack(sides, share, constants.border_noise * scale)
        code, side = compare_sheet(border, border_of(known), sides, slack, metric, buckled, constants)
        if code != FITS:
            return code, side, lattice, down, right, hidden, off, reference, lengths, measures
        if not metric:
            hidden |= doubtful_places(known, lattice, min(sides[0] / cols, sides[1] / rows), model)
    if not metric and patch.shape[1] == 2:
        measures = assess_lattice(patch.reshape(FINE, FINE, 2))
    if len(known) == 0 or known.shape[1] < patch.shape[1]:
        lengths = side_lengths(border_of(patch))
    elif not (buckled and metric):
        reference, lengths = learn_sheet(known, patch, sides, lasted, constants)
    return FITS, 0, lattice, down, right, hidden, off, reference, lengths, measures


@compiled(
    "(f8[:,::1], f8[::1], i8[::1], f8, f8, f8[:,::1], i8[::1], f8[:,::1], UniTuple(f8, 4), f8[:,::1], f8[::1], "
    "u1[:,::1], i8, i8, f8, f8, b1, f8, LatticeConstants[::1])"
)
def lay_sheet(
    rim: Array, turn: Array, candidates: Indices, step: float, grain: float, space: Array, corners: Indices,
    predicted: Array, camera: Lens, known: Array, sides: Array, mask: Mask, left: int, top: int, rows: float,
    cols: float, buckled: bool, lasted: float, model: Model,
) -> tuple[Judged, Array, float, int, float]:  # fmt: skip
    """Run ``lay_patch``, project the patch by a pinhole and run ``judge_patch``, all in one call.

    Returns:
        What ``judge_patch`` returns, its code also ``NO_CORNERS`` or ``OUT_OF_SIGHT``; and the four of ``lay_patch``.
    """
    patch, kink, number, stray = lay_patch(rim, turn, candidates, step, grain, space, corners, predicted)
    lattice = projected(patch, camera) if patch.shape[1] == 3 else patch
    if len(patch) == 0 or len(lattice) == 0:
        code, nothing = OUT_OF_SIGHT if len(patch) else NO_CORNERS, np.empty(0)
        return (code, 0, lattice, nothing, nothing, nothing > 0, 0.0, patch, sides, UNBENT), patch, kink, number, stray
    judged = judge_patch(patch, lattice, space, step, known, sides, mask, left, top, rows, cols, buckled, lasted, model)
    return judged, patch, kink, number, stray


@compiled
def projected(points: Array, camera: Lens) -> Array:
    """Return points ``(P, 3)`` as pixels of a pinhole, ``(P, 2)``; ``(0, 2)`` if it does not see some of them."""
    out = np.empty((len(points), 2))
    for p in range(len(points)):
        if not points[p, 2] > 0:
            return out[:0]
        out[p, 0] = points[p, 0] / points[p, 2] * camera[0] + camera[2]
        out[p, 1] = points[p, 1] / points[p, 2] * camera[1] + camera[3]
        if not max(abs(out[p, 0]), abs(out[p, 1])) < _MAX_PIXEL:
            return out[:0]
    return out


SHEET_FUNCTIONS: Final = (
    see_sheet, lay_sheet, lay_patch, judge_patch, rim_of, rim_depth, coons_patch, border_of, assign_corners, arc_length,
    known_slack, side_lengths, doubtful_places, interpolate, match_corners, nearest_corners, assess_lattice,
    lattice_gauges, sample_lattice, material_outline,
)  # fmt: skip
