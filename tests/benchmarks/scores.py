"""Compare found points with a known curve, a known outline, or the truth of a simulator."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from shape_obs.bench.scenes import Sheet
from shape_obs.configurations.base import Ends
from shape_obs.configurations.surface import Surface
from shape_obs.geometry.outline import clockwise
from shape_obs.geometry.polyline import resample
from shape_obs.geometry.topology import Chain, Grid, Ring, Topology
from shape_obs.metrics import in_order, spacing_cv
from shape_obs.shape import Shape
from tests.benchmarks.claim import Limit
from tests.benchmarks.tables import Column, Row, of, percent, total, worst
from tests.scenes.sheets import true_lattice

Array = npt.NDArray[np.float64]

BOTH_ENDS: Final[tuple[Ends, ...]] = ("centers", "tips")
SLIP: Final = 0.5  # gaps; a point that is farther from its position is nearer to that of its neighbour
LEAST_SHOWN: Final = 0.55  # of an object: with less in sight it may be refused
ASPECTS: Final = (1.0, 1.5, 2.0, 3.0, 1 / 2, 1 / 3)  # of drawn cloths
# In degrees. This close to an eighth of a turn, either of two corners may count as the top left one.
_UNDECIDED: Final = 2.0
FAR: Final = 0.010  # metres; the mean error of a frame that must not be called ok
_FINE: Final = 8000  # steps of a known curve, a tenth of a pixel or so each
_BEYOND: Final = 40  # steps by which it is continued at its ends: less than to the next strand of a narrow coil
_PER_GAP: Final = 50  # points of a simulator's truth for each gap


def score(points: npt.ArrayLike, curve: Array, ends: Ends, *, directed: bool = True) -> Row:
    """Compare N found points with a known curve.

    Args:
        points: ``(N, D)``.
        curve: ``(P, D)``, from end to end.
        ends: Where the points belong: ``"centers"`` of N equal pieces, or from tip to tip (``"tips"``).
        directed: Whether point 0 belongs to the curve's start; otherwise either direction is right.

    Returns:
        ``ordered``: whether the points' positions along the curve strictly increase; ``flipped``: whether they run
        against the curve's direction; ``distance`` and ``farthest``: mean and largest distance of the points from the
        curve, in its unit; ``tip``: the larger distance of the first and last point from the curve's ends; ``gap_cv``:
        standard deviation over mean of the distances between neighbours; ``slip``: largest distance of a point from its
        true arc position, along the curve, in gaps.
    """
    found, gaps = np.asarray(points, dtype=np.float64), len(np.asarray(points)) - (ends == "tips")
    share = (np.arange(len(found)) + (0.0 if ends == "tips" else 0.5)) / gaps
    fine = resample(np.ascontiguousarray(curve, dtype=np.float64), _FINE + 1)
    off, other = (np.sum((found - way[np.rint(share * _FINE).astype(int)]) ** 2) for way in (fine, fine[::-1]))
    flipped = bool(other < off)
    if flipped and not directed:
        fine, flipped = fine[::-1], False
    distance = KDTree(fine).query(found)[0]
    along = (KDTree(_continued(fine, _BEYOND)).query(found)[1] - _BEYOND) / _FINE
    return Row(
        ordered=in_order(along),
        flipped=flipped,
        distance=float(distance.mean()),
        farthest=float(distance.max()),
        tip=float(np.linalg.norm(found[[0, -1]] - fine[[0, -1]], axis=1).max()),
        gap_cv=spacing_cv(found, Chain(len(found))),
        slip=float(np.abs(along - share).max() * gaps),
    )


def tally(scores: Sequence[Any]) -> Row:
    """Count the frames of one track, and those with a point more than half a gap from its position.

    Args:
        scores: A score with a ``slip`` for each frame.
    """
    slips = [each.slip for each in scores]
    return Row(frames=len(slips), slips=sum(slip > SLIP for slip in slips), worst_slip=max(slips))


def _continued(curve: Array, count: int) -> Array:
    """Return a curve continued straight by ``count`` points at both ends, so that points past a tip have an order."""
    steps = np.arange(1, count + 1)[:, None]
    before, behind = curve[0] + (curve[0] - curve[1]) * steps[::-1], curve[-1] + (curve[-1] - curve[-2]) * steps
    return np.concatenate([before, curve, behind])


def outline_score(points: npt.ArrayLike, outline: Array) -> Row:
    """Compare N found points with a known outline.

    Args:
        points: ``(N, 2)`` pixels.
        outline: ``(P, 2)`` pixels, closed, clockwise as seen, from where point 0 belongs.

    Returns:
        ``ordered``: whether the points' positions along the outline strictly increase, once around; ``clockwise``:
        whether they run clockwise as seen in the image; ``distance``: mean distance of the points from the outline, in
        pixels; ``gap_cv``: standard deviation over mean of the distances between neighbours, including last to first;
        ``slip``: largest distance of a point from its true arc position, along the outline, in gaps; it has no meaning
        where the outline does not begin where point 0 belongs.
    """
    found = np.asarray(points, dtype=np.float64)
    fine = resample(np.ascontiguousarray(np.concatenate([outline, outline[:1]])), _FINE + 1)[:-1]
    distance, nearest = KDTree(fine).query(found)
    along = np.asarray(nearest, dtype=np.float64) / _FINE
    off = (along - np.arange(len(found)) / len(found) + 0.5) % 1.0 - 0.5
    return Row(
        ordered=in_order(along, period=1.0),
        clockwise=clockwise(found),
        distance=float(distance.mean()),
        gap_cv=spacing_cv(found, Ring(len(found))),
        slip=float(np.abs(off).max() * len(found)),
    )


def simulator_score(points: Array, valid: npt.NDArray[np.bool_], layout: Topology, simulator: Any) -> Row:
    """Compare found points with the truth of a simulator.

    Args:
        points: ``(N, 3)`` metres, base frame.
        valid: ``(N,)`` the measured points.
        layout: The topology of the points.
        simulator: The environment; ``truth`` returns its points in the same frame.

    Returns:
        ``mm``: mean distance of all points from their true positions, in millimetres; ``slip``: largest distance of a
        valid point from its material, in gaps along the curve or the lattice; ``flipped``: whether another numbering of
        the same points (from the other end, the other way round, from another corner) would be nearer; ``errors``:
        ``(N,)`` distances of all points from their true positions, metres.
    """
    if isinstance(layout, Grid):
        true, lattice = simulator.truth(layout.rows, layout.cols), layout.lattice(points)
        slips = np.abs(off_lattice(lattice - layout.lattice(true), layout.lattice(true))).max(axis=-1).ravel()
        turned = [each.reshape(points.shape) for each in (lattice[::-1], lattice[:, ::-1], lattice[::-1, ::-1])]
    elif isinstance(layout, (Chain, Ring)):
        true, closed = simulator.truth(layout.size), isinstance(layout, Ring)
        slips = _along_curve(points, simulator, closed)
        turned = [np.roll(points[::-1], int(closed), axis=0)]
    else:
        raise ValueError(f"expected a chain, a ring or a lattice, got {type(layout).__name__}.")
    distance = np.linalg.norm(points - true, axis=1)
    flipped = any(float(np.sum((other - true) ** 2)) < float(np.sum(distance**2)) for other in turned)
    slip = float(slips[valid].max(initial=0.0))
    return Row(mm=1e3 * float(distance.mean()), slip=slip, flipped=flipped, errors=distance)


def _along_curve(points: Array, simulator: Any, closed: bool) -> Array:
    """Return the distances of points from their true arc positions, ``(N,)``, along the curve in gaps."""
    count = len(points)
    if closed:
        at = cdist(points, simulator.truth(_PER_GAP * count)).argmin(axis=1) / _PER_GAP
        return np.abs((at - np.arange(count) + count / 2) % count - count / 2)
    line = _continued(simulator.truth(_PER_GAP * (count - 1) + 1), _PER_GAP)
    return np.abs(cdist(points, line).argmin(axis=1) / _PER_GAP - 1 - np.arange(count))


def off_lattice(away: Array, true: Array) -> Array:
    """Return the distances of points from their true positions on a sheet, (rows, cols, 2), in gaps down and across.

    Args:
        away: From the true positions to the found ones, (rows, cols, D).
        true: The true positions, (rows, cols, D).
    """
    gaps = np.stack([np.gradient(true, axis=0), np.gradient(true, axis=1)], axis=-1)
    return np.asarray(np.linalg.pinv(gaps) @ away[..., None], dtype=np.float64)[..., 0]


def score_sheet(points: npt.ArrayLike, sheet: Sheet, rows: int, cols: int, ends: Ends, quarters: int) -> Row:
    """Compare ``(N, 2)`` found points with a cloth whose first corner is number ``quarters``, counted clockwise.

    Returns:
        ``mean`` and ``worst`` distance of the points from their true positions, in pixels; ``slip``: the largest
        distance of a point from its material, in gaps of the lattice along a row or a column; ``off``: all of these
        distances, (rows, cols, 2), down and across.
    """
    true = true_lattice(np.rot90(sheet.points, quarters), rows, cols, ends)
    away = np.asarray(points, dtype=np.float64).reshape(true.shape) - true
    off, distance = off_lattice(away, true), np.linalg.norm(away, axis=-1)
    return Row(mean=float(distance.mean()), worst=float(distance.max()), slip=float(np.abs(off).max()), off=off)


def first_corner(sheet: Sheet) -> tuple[int, bool]:
    """Return the first corner by the paper's rule (0 to 3, clockwise), and whether another one is as good."""
    right = (sheet.points[:, -1] - sheet.points[:, 0]).mean(axis=0)
    down = (sheet.points[-1] - sheet.points[0]).mean(axis=0)
    # The mean, as directions, of the angles between the cloth's axes and the image's.
    right, down = right / np.linalg.norm(right), down / np.linalg.norm(down)
    degrees = np.degrees(np.angle(complex(*right) + complex(*down) / 1j))
    quarters = round(degrees / 90)
    return -quarters % 4, bool(abs(abs(degrees / 90 - quarters) - 0.5) * 90 < _UNDECIDED)


def best_corner(shape: Shape, sheet: Sheet, spec: Surface) -> tuple[int, Row]:
    """Return the corner of the cloth at which the points fit best, and how well they fit there."""
    ends = spec.ends or "centers"
    scores = [score_sheet(shape.pixels, sheet, spec.rows, spec.cols, ends, quarters) for quarters in range(4)]
    return min(enumerate(scores), key=lambda pair: pair[1].mean)


def by_the_rule(shape: Shape, sheet: Sheet, spec: Surface) -> tuple[bool, Row]:
    """Return whether point 0 is at the corner that the paper's rule gives, and how well the points fit the cloth."""
    expected, undecided = first_corner(sheet)
    corner, found = best_corner(shape, sheet, spec)
    return corner == expected or (undecided and (corner - expected) % 2 == 1), found


def claimed(shape: Shape, off: Array, errors: Array, hidden: npt.NDArray[np.bool_], shown: float, track: int) -> Row:
    """Return what a shape claims of its points in a frame, and what is true.

    Args:
        shape: With points in space, or without.
        off: ``(N,)`` distances of the points from their material, in gaps.
        errors: ``(N,)`` the same in metres or, without points in space, in pixels.
        hidden: ``(N,)`` the points that are out of sight in truth.
        shown: The share of the object that is seen.
        track: The number of the track.
    """
    mm = 1e3 * errors if shape.points3d is not None else np.full(len(shape), np.nan)
    visible, valid, good = shape.visible, shape.valid, shape.ok and not shape.reason
    believed = belief(shape, errors, ~hidden, bool((off[visible] > SLIP).any()))
    return Row(ok=good, shown=shown, off=off, mm=mm, visible=visible, valid=valid, hidden=hidden, track=track,
               belief=believed)  # fmt: skip


def visible_row(frames: Iterable[Row], **labels: Any) -> Row:
    """Count what was claimed of an object of which a part is hidden, over the rows of ``claimed`` of a track.

    Returns:
        The sums of which ``VISIBLE`` makes a table, and further fields.
    """
    frames = list(frames)
    ok, due = [row for row in frames if row.ok], [row for row in frames if row.shown >= LEAST_SHOWN]
    seen = [float((row.visible & row.valid)[~row.hidden].mean()) for row in due if not row.hidden.all()]
    errors = np.concatenate([row.mm[row.valid] for row in ok] or [np.empty(0)])
    return Row(
        labels,
        frames=len(frames),
        ok=len(ok),
        slips=sum(bool((row.off[row.visible] > SLIP).any()) for row in ok),
        due=len(due),
        refused=sum(not row.ok for row in due),
        seen=sum(seen),
        with_seen=len(seen),
        hidden=sum(int(row.hidden.sum()) for row in frames),
        hidden_valid=sum(int((row.valid & row.hidden).sum()) for row in frames),
        mm=float(errors.sum()),
        measured=len(errors),
        far=sum(bool(row.valid.any() and row.mm[row.valid].mean() > 1e3 * FAR) for row in ok),
        renewed=sum(after.track == before.track + 1 for before, after in pairwise(frames)),
        worst=max((float(row.off[row.visible].max(initial=0.0)) for row in ok), default=0.0),
    )


def _mean_mm(rows: Sequence[Row]) -> float | None:
    found, count = sum(row.mm for row in rows), sum(row.measured for row in rows)
    return None if not count or found != found else found / count


# Slips are frames that are ok and have a visible point more than half a gap off; refused are frames in which 55 % of
# the object shows; seen are truly visible points of these frames that are visible and valid.
VISIBLE: Final[dict[str, Column]] = {
    "frames": total("frames"),
    "slips [%]": percent("slips", "ok"),
    "refused [%]": percent("refused", "due"),
    "seen [%]": percent("seen", "with_seen"),
    "hidden valid [%]": percent("hidden_valid", "hidden"),
    "mean [mm]": _mean_mm,
    "far [%]": percent("far", "ok"),
    "renewed": total("renewed"),
    "worst [gaps]": of(worst, "worst"),
}
VISIBLE_LIMITS: Final = (
    Limit("slips [%]", at_most=1, unit="%", where={"rows": 480}),
    Limit("slips [%]", at_most=1, unit="%", where={"rows": 120}, sampled=10),
    Limit("refused [%]", at_most=2, unit="%"),
    Limit("seen [%]", at_least=90, unit="%"),
)
HAND_LIMITS: Final = (*VISIBLE_LIMITS, Limit("hidden valid [%]", at_most=25, unit="%"))


def tally_visible(frames: Iterable[Row]) -> Row:
    """Return ``VISIBLE`` of one track under short names; shares are in percent."""
    names = ("frames", "slips", "refused", "seen", "hidden_valid", "mm", "far", "renewed", "worst")
    counted = [visible_row(frames)]
    return Row(zip(names, (column(counted) for column in VISIBLE.values()), strict=True))


def belief(shape: Shape, errors: Array, shown: npt.NDArray[np.bool_], slipped: bool) -> Row:
    """Return what a shape that is ok says of its errors, and what they are.

    Args:
        shape: With points in space, or without.
        errors: ``(N,)`` distances of the points from their material, metres or, without points in space, pixels.
        shown: ``(N,)`` the points that are in sight in truth.
        slipped: Whether a visible point is more than half a gap off.

    Returns:
        ``errors``, ``sigma`` and ``shown``: ``(N,)``; ``space``: whether they are metres; ``wrong``: whether the frame
        should not be ok: it slipped, or the mean error of its valid points is above 10 mm.
    """
    space = shape.points3d is not None
    far = space and shape.valid.any() and float(errors[shape.valid].mean()) > FAR
    return Row(errors=errors, sigma=shape.sigma, shown=shown, space=space, wrong=bool(slipped or far))
