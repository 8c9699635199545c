"""Measure the accuracy of shapes in space: clouds of ropes, rings and sheets, and images at a slant."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import product
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree
from scipy.spatial.distance import pdist

from shape_obs.configurations.base import Configuration
from shape_obs.configurations.centerline import Centerline
from shape_obs.configurations.contour import Contour
from shape_obs.configurations.surface import Surface
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.polyline import resample
from shape_obs.metrics import spacing_cv
from shape_obs.shape import Detection, Shape
from tests.benchmarks import followed
from tests.benchmarks.scenes import clouds
from tests.benchmarks.scenes.images import CAMERA, tilted_rope, tilted_sheet
from tests.benchmarks.scenes.ropes import KINDS
from tests.benchmarks.scores import score, tally
from tests.benchmarks.tables import Row, failures, mean, median, of, summary

Array = npt.NDArray[np.float64]

COUNTS: Final = (8, 20, 50)
SIDES: Final[tuple[clouds.Side, ...]] = ("all", "front")
_WAYS: Final[dict[str, dict[str, Any]]] = {"px": {}, "m": {"spacing": "m"}, "cloud": {"lift": "cloud"}}


def rope_clouds(count: int, seed: int = 0) -> Iterator[Row]:
    """Detect rope clouds with 3 mm noise and holes cold, from tip to tip."""
    rng = np.random.default_rng(seed)
    for side, _ in product(SIDES, range(count)):
        rope = clouds.rope_cloud(rng, side=side)
        cloud = f"rope, seen {'all round' if side == 'all' else 'from the front'}"
        for n in COUNTS:
            shape, times = _twice(Centerline(n=n, ends="tips", radius=rope.radius if side == "front" else 0.0), rope)
            distance, nearest = _nearest(resample(rope.curve, 4000), _points(shape)[shape.valid])
            steps = np.diff(nearest)
            ordered = bool(len(steps) and (np.all(steps > 0) or np.all(steps < 0)))
            place = _either_way(shape, resample(rope.curve, n))
            yield _result(cloud, shape, times, ordered=ordered, curve_mm=_mm(distance), place_mm=place)


def ring_clouds(count: int, seed: int = 0) -> Iterator[Row]:
    """Detect closed ropes cold: every third one is whole, the others have two or four holes."""
    rng = np.random.default_rng(seed)
    for index in range(count):
        ring = clouds.ring_cloud(rng, holes=index % 3 * 2)
        closed = np.concatenate([ring.curve, ring.curve[:1]])
        yield _around("ring", Contour(), ring, resample(closed, 4000))


def sheet_clouds(count: int, seed: int = 0) -> Iterator[Row]:
    """Detect flat and bent sheets cold: the lattice of 4 x 8 points up to the border, and the outline."""
    rng = np.random.default_rng(seed)
    for index in range(count):
        sheet = clouds.sheet_cloud(rng, bend=(0.2, 0.8, 2.0)[index % 3])
        shape, times = _twice(Surface(rows=4, cols=8, ends="tips"), sheet)
        true = sheet.lattice(4, 8)
        apart = np.linalg.norm(_points(shape) - true, axis=1)
        mm, right = _mm(apart[shape.valid]), bool(apart.max() < pdist(true).min() / 2)
        yield _result("sheet, lattice", shape, times, ordered=right, curve_mm=mm, place_mm=mm)
        share = np.linspace(0, 1, 500)
        zero, one = np.zeros_like(share), np.ones_like(share)
        sides = [(share, zero), (one, share), (share[::-1], one), (zero, share[::-1])]
        border = np.concatenate([sheet.at(np.column_stack(side)) for side in sides])
        yield _around("sheet, outline", Contour(), sheet, border)


def cloud_table(results: Iterable[Row]) -> list[Row]:
    """Return the mean and the worst result of each object and N."""
    columns = {
        "clouds": len,
        "not_ok": failures("ok"),
        "order_wrong": failures("ordered"),
        "curve_mean_mm": of(np.nanmean, "curve_mm"),
        "curve_worst_mm": of(np.nanmax, "curve_mm"),
        "place_mean_mm": of(mean, "place_mm"),
        "place_worst_mm": of(np.max, "place_mm"),
        "gap_cv_worst": of(np.nanmax, "gap_cv"),
        "valid": of(mean, "valid"),
        "cold_ms": of(median, "cold_ms"),
        "warm_ms": of(median, "warm_ms"),
    }
    return summary(results, ("cloud", "n"), columns)


def moving_rope_clouds(speeds: Iterable[float], seeds: Iterable[int], frames: int = 180) -> Iterator[Row]:
    """Track rope clouds that wander and bend; an anchor gives point 0 in the first frame.

    Yields:
        A row for each track; slips in gaps.
    """

    def begin(rope: clouds.RopeCloud) -> ShapeDetector:
        x, y, z = rope.curve[0].tolist()
        return ShapeDetector([Centerline(ends="tips", anchor=(x, y, z))], on_invalid="interpolate")

    for seed, speed in product(seeds, speeds):
        motion = clouds.moving_rope_cloud(np.random.default_rng(seed), speed, frames)
        pairs = list(followed(motion, begin, lambda detector, rope: detector.detect_cloud(rope.points)))
        scores = [score(_points(found.shapes[0]), rope.curve, "tips") for rope, found in pairs]
        yield Row(
            speed=speed,
            **tally(scores),
            flips=sum(each.flipped for each in scores),
            not_ok=sum(not found.ok for _, found in pairs),
            mean_mm=1e3 * mean(each.distance for each in scores),
            warm_ms=median(found.timings["total"] for _, found in pairs[1:]),
        )


def tilted_images(count: int, seed: int = 0) -> Iterator[Row]:
    """Detect ropes (20 points, tip to tip) and sheets (4 x 8) at a slant with every way of lifting.

    Yields:
        A row for each image and way: the spacing, "px" or "m", with ``lift="points"``, or "cloud".
    """
    rng = np.random.default_rng(seed)
    for index in range(count):
        rope, sheet = tilted_rope(rng, KINDS[index % len(KINDS)]), tilted_sheet(rng)
        curve, lattice = resample(rope.curve, 20), sheet.lattice(4, 8)
        specs: dict[str, tuple[Configuration, Any]] = {
            "rope": (Centerline(ends="tips"), rope),
            "sheet": (Surface(rows=4, cols=8, ends="tips"), sheet),
        }
        for (image, (spec, drawn)), (way, given) in product(specs.items(), _WAYS.items()):
            shape, times = _twice(replace(spec, **given), drawn)
            place = _either_way(shape, curve) if image == "rope" else _from(lattice, shape)
            hairpin = image == "rope" and rope.hairpin
            yield Row(
                image=image, way=way, hairpin=hairpin, ok=shape.ok, place_mm=place, gap_cv=_gap_cv(shape), **times
            )


def tilted_table(results: Iterable[Row]) -> list[Row]:
    """Return the mean and the worst result of each object and way; gaps only where no bend is narrower than one."""

    def wide(row: Row) -> bool:
        return not row.hairpin

    columns = {
        "images": len,
        "not_ok": failures("ok"),
        "gap_cv_mean": of(np.nanmean, "gap_cv", wide),
        "gap_cv_worst": of(np.nanmax, "gap_cv", wide),
        "place_mean_mm": of(np.nanmean, "place_mm", wide),
        "place_worst_mm": of(np.nanmax, "place_mm", wide),
        "warm_ms": of(median, "warm_ms"),
    }
    return summary(results, ("image", "way"), columns)


def _around(cloud: str, spec: Configuration, drawn: Any, border: Array) -> Row:
    """Compare a closed shape with its true curve, which is given by close points."""
    shape, times = _twice(spec, drawn)
    distance, nearest = _nearest(border, _points(shape))
    step = np.roll(nearest, -1).astype(int) - nearest
    wrapped = (step + len(border) // 2) % len(border) - len(border) // 2
    ordered = bool(np.all(wrapped > 0) or np.all(wrapped < 0))
    return _result(cloud, shape, times, ordered=ordered, curve_mm=_mm(distance[shape.valid]), place_mm=np.nan)


def _result(cloud: str, shape: Shape, times: Row, **found: Any) -> Row:
    """Return the result of a cloud.

    Args:
        cloud: The object.
        shape: Its shape.
        times: The times of the first frame, cold, and of the second one, warm, in milliseconds.
        found: ``ordered``: whether the order is right; ``curve_mm``: mean distance of valid points from the true curve
            (axis or border), for a surface as ``place_mm``; ``place_mm``: mean distance of valid points from their
            positions on the material, at equal arc length, NaN if the shape has no first point.
    """
    valid = float(shape.valid.mean())
    return Row(cloud=cloud, n=len(shape), ok=shape.ok, gap_cv=_gap_cv(shape), valid=valid, **times, **found)


def _twice(spec: Configuration, drawn: Any) -> tuple[Shape, Row]:
    """Return the shape of a cloud or an image at a cold start, and the times of that frame and of the next one."""
    detector = ShapeDetector([spec], on_invalid="interpolate", on_missing="nan")

    def detect() -> Detection:
        is_cloud = isinstance(drawn, (clouds.RopeCloud, clouds.SheetCloud))
        return (
            detector.detect_cloud(drawn.points) if is_cloud else detector.detect_mask(drawn.mask, drawn.depth, CAMERA)
        )

    first, second = detect(), detect()
    return first.shapes[0], Row(cold_ms=first.timings["total"], warm_ms=second.timings["total"])


def _nearest(curve: Array, points: Array) -> tuple[Array, npt.NDArray[np.int_]]:
    """Return the distance of each point from the nearest point of a curve, and the index of that one."""
    tree: Any = KDTree(curve)
    return tree.query(points)


def _points(shape: Shape) -> Array:
    """Return the points in space, ``(N, 3)``; zeros where nothing was found."""
    assert shape.points3d is not None
    return np.nan_to_num(shape.points3d.astype(np.float64))


def _mm(distance: Array) -> float:
    return 1e3 * float(distance.mean()) if len(distance) else np.nan


def _from(true: Array, shape: Shape) -> float:
    """Return the mean distance of valid points from their true positions in mm."""
    return _mm(np.linalg.norm(_points(shape) - true, axis=1)[shape.valid])


def _either_way(shape: Shape, true: Array) -> float:
    """Return the mean distance of valid points from their true positions in mm, whichever end comes first."""
    return min(_from(true, shape), _from(true[::-1], shape))


def _gap_cv(shape: Shape) -> float:
    """Return the coefficient of variation of the gaps between valid neighbours."""
    return spacing_cv(_points(shape), shape.layout, shape.valid)
