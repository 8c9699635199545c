"""Shapes in space: clouds of ropes, rings and sheets, moving clouds, and images at a slant."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree
from scipy.spatial.distance import pdist

from shape_obs.bench.scenes import border_of
from shape_obs.configurations.base import Configuration
from shape_obs.configurations.centerline import Centerline
from shape_obs.configurations.contour import Contour
from shape_obs.configurations.surface import Surface
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.polyline import resample
from shape_obs.metrics import in_order, spacing_cv
from shape_obs.shape import Shape
from tests.benchmarks import followed
from tests.benchmarks.claim import Claim, Effort, Limit
from tests.benchmarks.scores import score, tally
from tests.benchmarks.tables import Row, failures, mean, median, of, total, worst
from tests.scenes import clouds
from tests.scenes.images import CAMERA, tilted_rope, tilted_sheet
from tests.scenes.ropes import KINDS

Array = npt.NDArray[np.float64]
COUNTS: Final = (8, 20, 50)
_WAYS: Final[dict[str, dict[str, Any]]] = {"px": {}, "m": {"spacing": "m"}, "cloud": {"lift": "cloud"}}


def drawn(effort: Effort) -> Iterator[tuple[str, Any]]:
    """Draw rope clouds seen all round and from the front, closed ropes with and without holes, and bent sheets."""
    count = effort.count(30)
    rng = np.random.default_rng(effort.seed)
    sides: tuple[clouds.Side, ...] = ("all", "front")
    for side, _ in product(sides, range(count)):
        yield f"rope, {side}", clouds.rope_cloud(rng, side=side)
    rng = np.random.default_rng(effort.seed)
    yield from (("ring", clouds.ring_cloud(rng, holes=index % 3 * 2)) for index in range(count))
    rng = np.random.default_rng(effort.seed)
    yield from (("sheet", clouds.sheet_cloud(rng, bend=(0.2, 0.8, 2.0)[index % 3])) for index in range(count))


def cold_cloud(scene: tuple[str, Any]) -> Iterator[Row]:
    """Detect a cloud with 3 mm noise and holes cold: ropes at each N from tip to tip, sheets also by their outline."""
    name, cloud = scene
    if name == "ring":
        yield _measured("ring", Contour(), cloud, curve=np.concatenate([cloud.curve, cloud.curve[:1]]), closed=True)
    elif name == "sheet":
        yield _measured("sheet, lattice", Surface(rows=4, cols=8, ends="tips"), cloud, places=cloud.lattice(4, 8))
        border = cloud.at(border_of(np.stack(np.meshgrid(*[np.linspace(0, 1, 500)] * 2), axis=-1)))
        yield _measured("sheet, outline", Contour(), cloud, curve=border, closed=True)
    else:
        for n in COUNTS:
            spec = Centerline(n=n, ends="tips", radius=cloud.radius if name == "rope, front" else 0.0)
            yield _measured(name, spec, cloud, curve=cloud.curve, places=resample(cloud.curve, n))


def follow_cloud(scene: tuple[int, float]) -> Row:
    """Track a rope cloud that wanders and bends; an anchor gives point 0 in the first frame; slips are in gaps."""
    seed, speed = scene

    def begin(rope: clouds.RopeCloud) -> ShapeDetector:
        x, y, z = rope.curve[0].tolist()
        return ShapeDetector([Centerline(ends="tips", anchor=(x, y, z))], on_invalid="interpolate")

    motion = clouds.moving_rope_cloud(np.random.default_rng(seed), speed)
    pairs = list(followed(motion, begin, lambda detector, rope: detector.detect_cloud(rope.points)))
    scores = [score(_points(found.shapes[0]), rope.curve, "tips") for rope, found in pairs]
    flips, not_ok = sum(each.flipped for each in scores), sum(not found.ok for _, found in pairs)
    mm = [1e3 * each.distance for each in scores]
    return Row(tally(scores), speed=speed, flips=flips, not_ok=not_ok, mm=mean(mm))


def tilted(effort: Effort) -> Iterator[tuple[str, Any]]:
    """Draw ropes and cloths on planes at a slant."""
    rng = np.random.default_rng(effort.seed)
    for index in range(effort.count(30)):
        yield "rope", tilted_rope(rng, KINDS[index % len(KINDS)])
        yield "sheet", tilted_sheet(rng)


def lifted(scene: tuple[str, Any]) -> Iterator[Row]:
    """Detect a rope (20 points, tip to tip) or a sheet (4 x 8) at a slant, with every way of lifting."""
    name, image = scene
    is_rope = name == "rope"
    spec: Configuration = Centerline(ends="tips") if is_rope else Surface(rows=4, cols=8, ends="tips")
    places = resample(image.curve, 20) if is_rope else image.lattice(4, 8)
    for way, given in _WAYS.items():
        found = _measured(name, replace(spec, **given), image, curve=image.curve if is_rope else None, places=places)
        yield Row(found, object=name, way=way, wide=not (is_rope and image.hairpin))  # no bend is narrower than a gap


def _measured(
    name: str,
    spec: Configuration,
    scene: Any,
    *,
    curve: Array | None = None,
    places: Array | None = None,
    closed: bool = False,
) -> Row:
    """Detect a cloud, or an image with depth, cold and once more.

    Args:
        name: Of the kind of scene.
        spec: How it is detected.
        scene: What is detected.
        curve: ``(P, 3)`` metres, the line on which the points belong; None for a lattice.
        places: ``(N, 3)`` metres, where they belong, in either direction; None if there is no first point.
        closed: Whether the curve is closed.

    Returns:
        ``ordered``: whether the order is right; ``curve_mm`` and ``place_mm``: mean distances of valid points from the
        curve and from their places, NaN where that is unknown; ``gap_cv`` between valid neighbours; ``valid``: percent;
        ``cold_ms`` and ``warm_ms``.
    """
    detector = ShapeDetector([spec], on_invalid="interpolate", on_missing="nan")
    is_cloud = isinstance(scene, (clouds.RopeCloud, clouds.SheetCloud))
    first, second = (
        detector.detect_cloud(scene.points) if is_cloud else detector.detect_mask(scene.mask, scene.depth, CAMERA)
        for _ in range(2)
    )
    shape, place_mm, ordered = first.shapes[0], np.nan, True
    points, valid = _points(shape), shape.valid
    if places is not None:
        away = [np.linalg.norm(points - way, axis=1) for way in (places, places[::-1])]
        place_mm = min(_mm(each[valid]) for each in away[: 1 if curve is None else 2])
        ordered = bool(away[0].max() < pdist(places).min() / 2)
    curve_mm = place_mm
    if curve is not None:
        distance, nearest = KDTree(resample(np.ascontiguousarray(curve), 4000)).query(points[valid])
        curve_mm, along = _mm(distance), np.asarray(nearest, np.float64)
        ordered = any(in_order(way, 4000.0 if closed else None) for way in (along, along[::-1]))
    found = {"ordered": ordered, "curve_mm": curve_mm, "place_mm": place_mm, "valid": 100 * float(valid.mean())}
    times = {"cold_ms": first.timings["total"], "warm_ms": second.timings["total"]}
    return Row(found, cloud=name, n=len(shape), ok=shape.ok, gap_cv=spacing_cv(points, shape.layout, valid), **times)


def _points(shape: Shape) -> Array:
    """Return the points in space, ``(N, 3)``; zeros where nothing was found."""
    assert shape.points3d is not None
    return np.nan_to_num(shape.points3d.astype(np.float64))


def _mm(distance: Array) -> float:
    return 1e3 * float(distance.mean()) if len(distance) else np.nan


def _wide(row: Row) -> bool:
    return bool(row.wide)


CLAIMS: Final = (
    Claim(
        "clouds.cold", "Clouds of ropes, rings and sheets with 3 mm of noise and holes, cold.",
        drawn, cold_cloud, ("cloud", "n"),
        {"clouds": len, "refused": failures("ok"), "order wrong": failures("ordered"),
         "to the curve, mean [mm]": of(mean, "curve_mm"), "to the curve, worst [mm]": of(worst, "curve_mm"),
         "to their places, mean [mm]": of(mean, "place_mm"), "to their places, worst [mm]": of(worst, "place_mm"),
         "gap CV, worst": of(worst, "gap_cv"), "valid [%]": of(mean, "valid"),
         "cold [ms]": of(median, "cold_ms"), "warm [ms]": of(median, "warm_ms")},
        limits=(
            Limit("refused", at_most=0), Limit("order wrong", at_most=0),
            Limit("to the curve, worst [mm]", at_most=2.5, unit="mm",
                  where={"cloud": ("rope, all", "rope, front", "ring")}),
            Limit("to the curve, worst [mm]", at_most=5, unit="mm"), Limit("gap CV, worst", at_most=0.06),
        ),
    ),
    Claim(
        "clouds.moving", "Rope clouds that wander and bend, tracked over 180 frames, by metres per frame.",
        lambda effort: product(effort.seeds(3), (0.005, 0.015)), follow_cloud, ("speed",),
        {"tracks": len, "flips": total("flips"), "slips": total("slips"), "refused": total("not_ok"),
         "worst place [gaps]": of(worst, "worst_slip"), "mean [mm]": of(mean, "mm")},
        limits=(Limit("flips", at_most=0), Limit("slips", at_most=0), Limit("refused", at_most=0),
                Limit("mean [mm]", at_most=2, unit="mm")),
    ),
    Claim(
        "clouds.tilted", "Ropes and cloths at a slant, by `spacing` (px, m) and `lift=\"cloud\"`.",
        tilted, lifted, ("object", "way"),
        {"images": len, "refused": failures("ok"), "gap CV, mean": of(mean, "gap_cv", _wide),
         "gap CV, worst": of(worst, "gap_cv", _wide), "to their places, mean [mm]": of(mean, "place_mm", _wide),
         "to their places, worst [mm]": of(worst, "place_mm", _wide), "warm [ms]": of(median, "warm_ms")},
        limits=(
            Limit("refused", at_most=0), Limit("gap CV, worst", at_most=0.01, where={"way": "cloud"}),
            Limit("to their places, mean [mm]", at_most=5, unit="mm", where={"way": ("m", "cloud")}),
        ),
    ),
)  # fmt: skip
