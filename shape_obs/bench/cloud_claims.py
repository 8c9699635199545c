"""Measure the accuracy of shapes in space: clouds of ropes, rings and sheets, and images at a slant."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree
from scipy.spatial.distance import pdist

from shape_obs.bench.scores import score, tally
from shape_obs.bench.synthetic.clouds import Side, moving_rope_cloud, ring_cloud, rope_cloud, sheet_cloud
from shape_obs.bench.synthetic.images import CAMERA, tilted_rope, tilted_sheet
from shape_obs.bench.synthetic.ropes import KINDS
from shape_obs.bench.tables import Row, grouped, mean
from shape_obs.configurations.base import Configuration
from shape_obs.configurations.centerline import Centerline
from shape_obs.configurations.contour import Contour
from shape_obs.configurations.surface import Surface
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.polyline import resample
from shape_obs.metrics import spacing_cv
from shape_obs.shape import Shape

Array = npt.NDArray[np.float64]

COUNTS: Final = (8, 20, 50)
SIDES: Final[tuple[Side, ...]] = ("all", "front")
_WAYS: Final[dict[str, dict[str, Any]]] = {"px": {}, "m": {"spacing": "m"}, "cloud": {"lift": "cloud"}}


class CloudResult(NamedTuple):
    """One cloud, detected cold and then warm.

    Args:
        what: The object.
        n: Number of points.
        ok: Whether it was found.
        ordered: Whether the order is right.
        curve_mm: Mean distance of valid points from the true curve (axis or border); for a surface as ``place_mm``.
        place_mm: Mean distance of valid points from their positions on the material, at equal arc length; NaN if the
            shape has no first point.
        gap_cv: Standard deviation over mean of the gaps.
        valid: Share of valid points.
        cold_ms: Time of the first frame, in milliseconds.
        warm_ms: Time of the second frame, in milliseconds.
    """

    what: str
    n: int
    ok: bool
    ordered: bool
    curve_mm: float
    place_mm: float
    gap_cv: float
    valid: float
    cold_ms: float
    warm_ms: float


class CloudMotion(NamedTuple):
    """One moving rope cloud, tracked; lengths in metres, slips in gaps."""

    speed: float
    frames: int
    flips: int
    slips: int
    not_ok: int
    worst_slip: float
    mean_mm: float
    warm_ms: float


class TiltedResult(NamedTuple):
    """One image at a slant; ``way`` is the spacing, "px" or "m", with ``lift="points"``, or "cloud"."""

    what: str
    way: str
    hairpin: bool
    ok: bool
    gap_cv: float
    place_mm: float
    warm_ms: float


def rope_clouds(
    count: int, seed: int = 0, counts: Sequence[int] = COUNTS, sides: Sequence[Side] = SIDES
) -> Iterator[CloudResult]:
    """Detect rope clouds with 3 mm noise and holes cold, from tip to tip."""
    rng = np.random.default_rng(seed)
    for side in sides:
        for _ in range(count):
            rope = rope_cloud(rng, side=side)
            for n in counts:
                spec = Centerline(n=n, ends="tips", radius=rope.radius if side == "front" else 0.0)
                shape, cold, warm = _twice(spec, rope.points)
                tree: Any = KDTree(resample(rope.curve, 4000))
                distance, nearest = tree.query(_points(shape)[shape.valid])
                steps = np.diff(nearest)
                what = f"rope, seen {'all round' if side == 'all' else 'from the front'}"
                ordered = bool(len(steps) and (np.all(steps > 0) or np.all(steps < 0)))
                along = _either_way(shape, resample(rope.curve, n))
                yield _result(what, shape, ordered, _mm(distance), along, cold, warm)


def ring_clouds(count: int, seed: int = 0, n: int = 32) -> Iterator[CloudResult]:
    """Detect closed ropes cold: every third one is whole, the others have two or four holes."""
    rng = np.random.default_rng(seed)
    for index in range(count):
        ring = ring_cloud(rng, holes=index % 3 * 2)
        closed = np.concatenate([ring.curve, ring.curve[:1]])
        yield _around("ring", Contour(n=n), ring.points, resample(closed, 4000))


def sheet_clouds(count: int, seed: int = 0) -> Iterator[CloudResult]:
    """Detect flat and bent sheets cold: the lattice of 4 x 8 points up to the border, and the outline."""
    rng = np.random.default_rng(seed)
    for index in range(count):
        sheet = sheet_cloud(rng, bend=(0.2, 0.8, 2.0)[index % 3])
        shape, cold, warm = _twice(Surface(rows=4, cols=8, ends="tips"), sheet.points)
        true = sheet.lattice(4, 8)
        apart = np.linalg.norm(_points(shape) - true, axis=1)
        mm, right = _mm(apart[shape.valid]), bool(apart.max() < pdist(true).min() / 2)
        yield _result("sheet, lattice", shape, right, mm, mm, cold, warm)
        share = np.linspace(0, 1, 500)
        zero, one = np.zeros_like(share), np.ones_like(share)
        sides = [(share, zero), (one, share), (share[::-1], one), (zero, share[::-1])]
        border = np.concatenate([sheet.at(np.column_stack(side)) for side in sides])
        yield _around("sheet, outline", Contour(), sheet.points, border)


def moving_rope_clouds(
    speeds: Iterable[float], seeds: Iterable[int], frames: int = 180, n: int = 20
) -> Iterator[CloudMotion]:
    """Track rope clouds that wander and bend; an anchor gives point 0 in the first frame."""
    for seed, speed in product(seeds, speeds):
        detector, scores, times, not_ok = ShapeDetector(), [], [], 0
        for index, rope in enumerate(moving_rope_cloud(np.random.default_rng(seed), speed, frames)):
            if index == 0:
                x, y, z = (float(value) for value in rope.curve[0])
                spec = Centerline(n=n, ends="tips", anchor=(x, y, z))
                detector = ShapeDetector([spec], on_invalid="interpolate")
            detection = detector.detect_cloud(rope.points)
            not_ok += not detection.ok
            times.append(detection.timings["total"])
            scores.append(score(_points(detection.shapes[0]), rope.curve, "tips"))
        yield CloudMotion(
            speed=speed,
            **tally(scores),
            not_ok=not_ok,
            mean_mm=1e3 * mean(s.distance for s in scores),
            warm_ms=float(np.median(times[1:])),
        )


def tilted_images(count: int, seed: int = 0) -> Iterator[TiltedResult]:
    """Detect ropes (20 points, tip to tip) and sheets (4 x 8) at a slant with every way of lifting."""
    rng = np.random.default_rng(seed)
    for index in range(count):
        rope, sheet = tilted_rope(rng, KINDS[index % len(KINDS)]), tilted_sheet(rng)
        true = resample(rope.curve, 20)
        for way, given in _WAYS.items():
            shape, _, warm = _twice(replace(Centerline(ends="tips"), **given), rope.mask, rope.depth)
            place = _either_way(shape, true)
            yield TiltedResult("rope", way, rope.hairpin, shape.ok, _gap_cv(shape), place, warm)
        for way, given in _WAYS.items():
            spec = replace(Surface(rows=4, cols=8, ends="tips"), **given)
            shape, _, warm = _twice(spec, sheet.mask, sheet.depth)
            place = _mm(np.linalg.norm(_points(shape) - sheet.lattice(4, 8), axis=1)[shape.valid])
            yield TiltedResult("sheet", way, False, shape.ok, _gap_cv(shape), place, warm)


def cloud_table(results: Iterable[CloudResult]) -> list[Row]:
    """Return the mean and the worst result of each object and N."""
    return [
        {
            "cloud": what,
            "n": n,
            "clouds": len(found),
            "not_ok": sum(not r.ok for r in found),
            "order_wrong": sum(not r.ordered for r in found),
            "curve_mean_mm": float(np.nanmean([r.curve_mm for r in found])),
            "curve_worst_mm": float(np.nanmax([r.curve_mm for r in found])),
            "place_mean_mm": mean(r.place_mm for r in found),
            "place_worst_mm": float(np.max([r.place_mm for r in found])),
            "gap_cv_worst": float(np.nanmax([r.gap_cv for r in found])),
            "valid": mean(r.valid for r in found),
            "cold_ms": float(np.median([r.cold_ms for r in found])),
            "warm_ms": float(np.median([r.warm_ms for r in found])),
        }
        for (what, n), found in grouped(results, lambda result: (result.what, result.n)).items()
    ]


def tilted_table(results: Iterable[TiltedResult]) -> list[Row]:
    """Return the mean and the worst result of each object and way; gaps only where no bend is narrower than one."""
    return [
        {
            "image": what,
            "way": way,
            "images": len(found),
            "not_ok": sum(not r.ok for r in found),
            "gap_cv_mean": float(np.nanmean([r.gap_cv for r in found if not r.hairpin])),
            "gap_cv_worst": float(np.nanmax([r.gap_cv for r in found if not r.hairpin])),
            "place_mean_mm": float(np.nanmean([r.place_mm for r in found if not r.hairpin])),
            "place_worst_mm": float(np.nanmax([r.place_mm for r in found if not r.hairpin])),
            "warm_ms": float(np.median([r.warm_ms for r in found])),
        }
        for (what, way), found in grouped(results, lambda result: (result.what, result.way)).items()
    ]


def _around(what: str, spec: Configuration, points: Array, border: Array) -> CloudResult:
    """Compare a closed shape with its true curve, which is given by close points."""
    shape, cold, warm = _twice(spec, points)
    found = _points(shape)
    tree: Any = KDTree(border)
    distance, nearest = tree.query(found)
    step = np.roll(nearest, -1).astype(int) - nearest
    wrapped = (step + len(border) // 2) % len(border) - len(border) // 2
    ordered = bool(np.all(wrapped > 0) or np.all(wrapped < 0))
    return _result(what, shape, ordered, _mm(distance[shape.valid]), np.nan, cold, warm)


def _result(
    what: str, shape: Shape, ordered: bool, curve: float, place: float, cold: float, warm: float
) -> CloudResult:
    spacing, valid = _gap_cv(shape), float(shape.valid.mean())
    return CloudResult(what, len(shape), shape.ok, ordered, curve, place, spacing, valid, cold, warm)


def _twice(spec: Configuration, body: Any, depth: Any = None) -> tuple[Shape, float, float]:
    """Return the shape at a cold start, and the times of that frame and of the next one."""
    detector = ShapeDetector([spec], on_invalid="interpolate", on_missing="nan")
    if depth is None:
        first, second = (detector.detect_cloud(body) for _ in range(2))
    else:
        first, second = (detector.detect_mask(body, depth, CAMERA) for _ in range(2))
    return first.shapes[0], first.timings["total"], second.timings["total"]


def _points(shape: Shape) -> Array:
    """Return the points in space, (N, 3); zeros where nothing was found."""
    assert shape.points3d is not None
    return np.nan_to_num(shape.points3d.astype(np.float64))


def _mm(distance: Array) -> float:
    return 1e3 * float(distance.mean()) if len(distance) else np.nan


def _either_way(shape: Shape, true: Array) -> float:
    """Return the mean distance of valid points from their true positions in mm, whichever end comes first."""
    return min(_mm(np.linalg.norm(_points(shape) - order, axis=1)[shape.valid]) for order in (true, true[::-1]))


def _gap_cv(shape: Shape) -> float:
    """Return the coefficient of variation of the gaps between valid neighbours."""
    return spacing_cv(_points(shape), shape.layout, shape.valid)
