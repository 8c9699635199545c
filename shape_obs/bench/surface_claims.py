"""Measure the accuracy of surfaces on drawn cloths: at rest, turning, moving, noisy."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import product
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.bench.synthetic.sheets import Sheet, moving_sheet, noisy, random_sheet, turning_sheet
from shape_obs.bench.tables import Row, grouped, mean
from shape_obs.configurations.base import Ends
from shape_obs.configurations.surface import Surface
from shape_obs.detector import ShapeDetector
from shape_obs.shape import Shape

Array = npt.NDArray[np.float64]

ASPECTS: Final = (1.0, 1.5, 2.0, 3.0, 1 / 2, 1 / 3)
LATTICES: Final = ((4, 8), (2, 2), (3, 3), (8, 8), (6, 10))
_BOTH_ENDS: Final[tuple[Ends, ...]] = ("centers", "tips")
# In degrees. This close to an eighth of a turn, either of two corners may count as the top left one.
_UNDECIDED: Final = 2.0
_SLIP: Final = 0.5  # cells


class SheetScore(NamedTuple):
    """The distance of found points from their material.

    Args:
        mean: Mean distance of the points from their true positions, in pixels.
        worst: The largest such distance.
        slip: The largest distance of a point from its material, in gaps of the lattice along a row or a column.
    """

    mean: float
    worst: float
    slip: float


class SheetResult(NamedTuple):
    """One drawn cloth, detected cold. ``corner_right``: point 0 is at the corner that the paper's rule gives."""

    aspect: float
    degrees: float
    rows: int
    cols: int
    ends: Ends
    ok: bool
    corner_right: bool
    quality: float
    score: SheetScore


class TurnResult(NamedTuple):
    """One cloth that turns once around by one degree per frame, tracked and also detected cold in each frame."""

    aspect: float
    frames: int
    tracked_slips: int
    tracked_not_ok: int
    worst_slip: float
    worst_move: float
    cold_wrong: int
    cold_undecided: int
    cold_not_ok: int


class WanderResult(NamedTuple):
    """One moving cloth, tracked; lengths in pixels, slips in gaps, milliseconds of a warm frame."""

    speed: float
    frames: int
    slips: int
    not_ok: int
    worst_slip: float
    mean_distance: float
    worst_distance: float
    milliseconds: float


class JitterResult(NamedTuple):
    """One tracked cloth at rest under a mask with a noisy border: RMS movement of its points, in pixels."""

    aspect: float
    frames: int
    not_ok: int
    mean: float
    worst_point: float


def score_sheet(points: npt.ArrayLike, sheet: Sheet, rows: int, cols: int, ends: Ends, quarters: int) -> SheetScore:
    """Compare (N, 2) found points with a cloth whose first corner is number ``quarters``, counted clockwise."""
    true = _turned(sheet, quarters).lattice(rows, cols, ends)
    distance = np.linalg.norm(np.asarray(points, dtype=np.float64).reshape(true.shape) - true, axis=-1)
    slip = np.abs(_off(points, sheet, rows, cols, ends, quarters)).max()
    return SheetScore(float(distance.mean()), float(distance.max()), float(slip))


def first_corner(sheet: Sheet) -> tuple[int, bool]:
    """Return the first corner by the paper's rule (0 to 3, clockwise), and whether another one is as good."""
    right = (sheet.points[:, -1] - sheet.points[:, 0]).mean(axis=0)
    down = (sheet.points[-1] - sheet.points[0]).mean(axis=0)
    # The mean, as directions, of the angles between the cloth's axes and the image's.
    right, down = right / np.linalg.norm(right), down / np.linalg.norm(down)
    degrees = np.degrees(np.angle(complex(*right) + complex(*down) / 1j))
    quarters = round(degrees / 90)
    return -quarters % 4, bool(abs(abs(degrees / 90 - quarters) - 0.5) * 90 < _UNDECIDED)


def drawn_sheets(
    count: int,
    seed: int = 0,
    lattices: Sequence[tuple[int, int]] = LATTICES,
    aspects: Sequence[float] = ASPECTS,
    tilt: float = 0.02,
) -> Iterator[SheetResult]:
    """Detect ``count`` bent cloths cold at all angles, with each lattice and in both end modes."""
    rng = np.random.default_rng(seed)
    for number in range(count):
        aspect, degrees = aspects[number % len(aspects)], 360 * number / count + rng.uniform(-5, 5)
        sheet = random_sheet(rng, aspect, degrees, tilt=tilt)
        expected, undecided = first_corner(sheet)
        for (rows, cols), ends in product(lattices, _BOTH_ENDS):
            shape = _cold(sheet, rows, cols, ends)
            corner, score = _best(shape, sheet, rows, cols, ends)
            right = corner == expected or (undecided and (corner - expected) % 2 == 1)
            yield SheetResult(aspect, degrees, rows, cols, ends, shape.ok, right, shape.quality, score)


def turning_sheets(
    seeds: Iterable[int], aspects: Sequence[float] = ASPECTS, rows: int = 4, cols: int = 8, step: float = 1.0
) -> Iterator[TurnResult]:
    """Track bent cloths that turn once around on the spot, and detect each frame cold."""
    for seed in seeds:
        aspect = aspects[seed % len(aspects)]
        detector = ShapeDetector([Surface(rows=rows, cols=cols)])
        slips: list[float] = []
        moves = [0.0]
        tracked_not_ok = wrong = open_choices = cold_not_ok = 0
        first, before = -1, np.zeros((rows, cols, 2))
        for sheet in turning_sheet(np.random.default_rng(seed), aspect, step):
            shape = detector.detect_mask(sheet.mask).shapes[0]
            tracked_not_ok += bool(shape.reason)
            if first < 0:
                first = _best(shape, sheet, rows, cols, "centers")[0]
            slips.append(score_sheet(shape.pixels, sheet, rows, cols, "centers", first).slip)
            off = _off(shape.pixels, sheet, rows, cols, "centers", first)
            if len(slips) > 1:
                moves.append(float(np.abs(off - before).max()))
            before = off
            cold = _cold(sheet, rows, cols, "centers")
            expected, undecided = first_corner(sheet)
            corner, score = _best(cold, sheet, rows, cols, "centers")
            open_choices += undecided
            wrong += score.slip > _SLIP or (corner != expected and not undecided)
            cold_not_ok += not cold.ok
        yield TurnResult(
            aspect=aspect,
            frames=len(slips),
            tracked_slips=sum(slip > _SLIP for slip in slips),
            tracked_not_ok=tracked_not_ok,
            worst_slip=max(slips),
            worst_move=max(moves),
            cold_wrong=wrong,
            cold_undecided=open_choices,
            cold_not_ok=cold_not_ok,
        )


def moving_sheets(
    speeds: Iterable[float], seeds: Iterable[int], frames: int = 180, rows: int = 4, cols: int = 8
) -> Iterator[WanderResult]:
    """Track cloths that wander, turn and bend."""
    for seed, speed in product(seeds, speeds):
        detector, first = ShapeDetector([Surface(rows=rows, cols=cols)]), -1
        scores: list[SheetScore] = []
        times: list[float] = []
        not_ok = 0
        aspect = ASPECTS[seed % len(ASPECTS)]
        for sheet in moving_sheet(np.random.default_rng(seed), speed, frames, aspect=aspect):
            detection = detector.detect_mask(sheet.mask)
            shape = detection.shapes[0]
            if first < 0:
                first = _best(shape, sheet, rows, cols, "centers")[0]
            not_ok += bool(shape.reason)
            times.append(detection.timings["fit"] + detection.timings["lift"])
            scores.append(score_sheet(shape.pixels, sheet, rows, cols, "centers", first))
        yield WanderResult(
            speed=speed,
            frames=len(scores),
            slips=sum(s.slip > _SLIP for s in scores),
            not_ok=not_ok,
            worst_slip=max(s.slip for s in scores),
            mean_distance=mean(s.mean for s in scores),
            worst_distance=max(s.worst for s in scores),
            milliseconds=float(np.median(times)),
        )


def noisy_sheets(seeds: Iterable[int], frames: int = 60, rows: int = 4, cols: int = 8) -> Iterator[JitterResult]:
    """Track cloths at rest whose mask is cut from another noisy image in every frame."""
    for seed in seeds:
        rng, aspect = np.random.default_rng(seed), ASPECTS[seed % len(ASPECTS)]
        sheet = random_sheet(rng, aspect, float(rng.uniform(0, 360)))
        detector = ShapeDetector([Surface(rows=rows, cols=cols)])
        shapes = [detector.detect_mask(noisy(sheet.mask, rng)).shapes[0] for _ in range(frames)]
        points = np.stack([shape.pixels for shape in shapes]).astype(np.float64)
        squares = np.sum((points - points.mean(axis=0)) ** 2, axis=2).mean(axis=0)
        yield JitterResult(
            aspect=aspect,
            frames=frames,
            not_ok=sum(not shape.ok for shape in shapes),
            mean=float(np.sqrt(squares.mean())),
            worst_point=float(np.sqrt(squares.max())),
        )


def sheet_table(results: Iterable[SheetResult]) -> list[Row]:
    """Return the mean and the worst result of each lattice."""
    return [
        {
            "lattice": lattice,
            "sheets": len(found) // len({r.ends for r in found}),
            "not_ok": sum(not r.ok for r in found),
            "corner_wrong": sum(not r.corner_right for r in found),
            "slips": sum(r.score.slip > _SLIP for r in found),
            "worst_slip": max(r.score.slip for r in found),
            "distance_mean_px": mean(r.score.mean for r in found),
            "worst_sheet_px": max(r.score.mean for r in found),
            "worst_point_px": max(r.score.worst for r in found),
        }
        for lattice, found in grouped(results, lambda result: f"{result.rows}x{result.cols}").items()
    ]


def _turned(sheet: Sheet, quarters: int) -> Sheet:
    return Sheet(np.rot90(sheet.points, quarters), sheet.mask)


def _cold(sheet: Sheet, rows: int, cols: int, ends: Ends) -> Shape:
    return ShapeDetector([Surface(rows=rows, cols=cols, ends=ends)]).detect_mask(sheet.mask).shapes[0]


def _best(shape: Shape, sheet: Sheet, rows: int, cols: int, ends: Ends) -> tuple[int, SheetScore]:
    """Return the corner of the cloth at which the points fit best, and how well they fit there."""
    scores = [score_sheet(shape.pixels, sheet, rows, cols, ends, quarters) for quarters in range(4)]
    best = int(np.argmin([score.mean for score in scores]))
    return best, scores[best]


def _off(points: npt.ArrayLike, sheet: Sheet, rows: int, cols: int, ends: Ends, quarters: int) -> Array:
    """Return the distance of each point from its material, (rows, cols, 2), in gaps of the lattice down and across."""
    true = _turned(sheet, quarters).lattice(rows, cols, ends)
    away = np.asarray(points, dtype=np.float64).reshape(true.shape) - true
    gaps = np.stack([np.gradient(true, axis=0), np.gradient(true, axis=1)], axis=-1)
    return np.asarray(np.linalg.solve(gaps, away[..., None])[..., 0], dtype=np.float64)
