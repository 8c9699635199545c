"""Ropes in masks: cold, crossing, cut, in noise, and moving; and ropes, outlines and cloths at rest."""

from __future__ import annotations

import timeit
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from itertools import product
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial.distance import cdist

from shape_obs.bench.photos import BLUE, photographed
from shape_obs.bench.scenes import Rope, moving_rope
from shape_obs.configurations.base import Configuration
from shape_obs.configurations.centerline import Centerline
from shape_obs.configurations.contour import Contour
from shape_obs.configurations.surface import Surface
from shape_obs.detector import ShapeDetector
from shape_obs.image.find_region import find_region
from shape_obs.image.roi import Window
from shape_obs.image.segmentation import Segmentation
from shape_obs.initialization.medial_axis import medial_axis
from tests.benchmarks import Mask, at_rest, cold, followed
from tests.benchmarks.claim import Claim, Effort, Limit
from tests.benchmarks.rope_scores import is_traversed
from tests.benchmarks.scores import ASPECTS, BOTH_ENDS, score, tally
from tests.benchmarks.tables import Row, failures, mean, median, of, percent, total, worst
from tests.scenes.blobs import KINDS as BLOBS
from tests.scenes.blobs import random_blob
from tests.scenes.images import ragged, salted
from tests.scenes.ropes import KINDS, bend_radius, random_rope
from tests.scenes.sheets import noisy, random_sheet
from tests.scenes.tangles import Tangle, crossing_rope, cut_rope, touching_rope

COUNTS: Final = (8, 20, 50, 100)
_N: Final = 20  # points of a tracked rope
_FINE: Final = 60  # points of a rope whose way is compared: no farther apart than a width or two
TANGLES: Final[dict[str, Callable[[np.random.Generator], Tangle]]] = {
    "1 crossing": partial(crossing_rope, crossings=1),
    "2 crossings": partial(crossing_rope, crossings=2),
    "3 crossings": partial(crossing_rope, crossings=3),
    "cut, 16 px": partial(cut_rope, crossings=0, band=16),
    "cut, 50 px": partial(cut_rope, crossings=0, band=50),
    "crossing and cut, 16 px": partial(cut_rope, crossings=1, band=16),
    "crossing and cut, 50 px": partial(cut_rope, crossings=1, band=50),
    "side by side": touching_rope,
}


def drawn_ropes(effort: Effort) -> Iterator[Rope]:
    """Draw random ropes of every kind with a known centreline."""
    rng = np.random.default_rng(effort.seed)
    return (random_rope(rng, kind) for kind, _ in product(KINDS, range(effort.count(40))))


def cold_rope(rope: Rope) -> Iterator[Row]:
    """Detect a rope cold, at each N and in both end modes.

    Yields:
        The fields of ``score``. ``widths``: the largest distance from the axis in widths. ``spaced``: gaps can be
        equal; where a bend is narrower than a gap, equal chords would move points away from their material.
    """
    for n, ends in product(COUNTS, BOTH_ENDS):
        shape = cold(Centerline(n=n, ends=ends), rope.mask)
        found = score(shape.pixels, rope.curve, ends, directed=False)
        spaced = n >= 12 and rope.length / n <= 1.5 * bend_radius(rope)
        tip = found["tip"] if ends == "tips" else np.nan
        widths = found["farthest"] / rope.width
        yield Row(found, kind=rope.kind, n=n, tip=tip, ok=shape.ok, spaced=spaced, widths=widths)


def tangles(effort: Effort) -> Iterator[tuple[str, Tangle]]:
    """Draw ropes that cross themselves, are cut by an occluder, or run next to themselves."""
    for index, (name, draw) in enumerate(TANGLES.items()):
        rng = np.random.default_rng([effort.seed, index])
        yield from ((name, draw(rng)) for _ in range(effort.count(100)))


def cold_tangle(scene: tuple[str, Tangle]) -> Row:
    """Detect a tangled rope cold, and time that against thinning with the longest path, on the same mask.

    Returns:
        ``right``: whether it was found as the rope runs; ``wrong``: whether it was accepted and does not; ``hidden``:
        points of a rope that was found right that lie under the occluder, as their neighbours do, and
        ``called_visible`` those of them that are reported visible; ``ms`` of a frame; ``ratio``: time of the start over
        that of the peer, None without scikit-image.
    """
    name, tangle = scene
    spec, window = Centerline(n=_FINE), Window(0, 0, tangle.mask.shape[1], tangle.mask.shape[0])
    runs: list[Callable[[Mask], object]] = [
        lambda mask: medial_axis(find_region(mask, window, Segmentation.min_area, Segmentation.min_share)),
        lambda mask: cold(spec, mask),
    ]
    if find_spec("skimage") is not None:
        from skimage.morphology import skeletonize

        runs.append(lambda mask: longest_path(np.asarray(skeletonize(mask > 0))))
    taken = [1e3 * min(timeit.repeat(partial(run, tangle.mask), number=1, repeat=2)) for run in runs]
    shape = cold(spec, tangle.mask)
    right = shape.ok and is_traversed(shape.pixels, tangle)
    hidden = tangle.hidden[cdist(shape.pixels, tangle.curve).argmin(axis=1)] & right
    hidden &= np.roll(hidden, 1) & np.roll(hidden, -1)
    return Row(
        rope=name,
        right=right,
        refused=not shape.ok,
        wrong=shape.ok and not right,
        hidden=int(hidden.sum()),
        called_visible=int((hidden & shape.visible).sum()),
        ms=taken[1],
        ratio=taken[0] / taken[2] if len(taken) > 2 else None,
    )


def longest_path(skeleton: npt.NDArray[np.bool_]) -> npt.NDArray[np.float64]:
    """Return the longest shortest path between pixels of a skeleton, by two sweeps: ``(P, 2)`` pixels (u, v)."""
    rows, columns = np.nonzero(skeleton)
    index = np.full((skeleton.shape[0] + 2, skeleton.shape[1] + 2), -1)
    index[rows + 1, columns + 1] = np.arange(len(rows))
    first, second, length = [], [], []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        there = index[rows + 1 + down, columns + 1 + right]
        first.append(np.flatnonzero(there >= 0))
        second.append(there[there >= 0])
        length.append(np.full(len(second[-1]), np.hypot(down, right)))
    # The graph functions of older SciPy versions take only 32-bit integers.
    pairs = tuple(np.concatenate(ends).astype(np.int32) for ends in (first, second))
    graph = coo_array((np.concatenate(length), pairs), shape=(len(rows), len(rows))).tocsr()
    reached = dijkstra(graph, directed=False, indices=0)
    start = int(np.argmax(np.where(np.isfinite(reached), reached, -1)))
    reached, previous = dijkstra(graph, directed=False, indices=start, return_predecessors=True)
    path = [int(np.argmax(np.where(np.isfinite(reached), reached, -1)))]
    while previous[path[-1]] >= 0:
        path.append(int(previous[path[-1]]))
    return np.stack([columns[path], rows[path]], axis=1).astype(np.float64)


def disturbed(effort: Effort) -> Iterator[tuple[str, float, Rope, Any]]:
    """Draw ropes with flipped pixels, ragged edges, and photographed in uneven light."""
    rng = np.random.default_rng(effort.seed)
    disturbances: dict[str, tuple[tuple[float, ...], Callable[[Mask, float], Any]]] = {
        "salt and pepper": ((0.01, 0.03, 0.05), lambda mask, share: salted(rng, mask, share)),
        "ragged edges, px": ((1.0, 2.0), lambda mask, depth: ragged(rng, mask, depth)),
        "light, times brighter": ((2.0, 4.0, 8.0), lambda mask, contrast: photographed(rng, mask, contrast, 6.0)),
    }
    ropes = [random_rope(rng, kind) for kind in KINDS for _ in range(effort.count(12))]
    for name, (levels, disturb) in disturbances.items():
        for level, rope in product(levels, ropes):
            yield name, level, rope, disturb(rope.mask, level)


def cold_in_noise(scene: tuple[str, float, Rope, Any]) -> Row:
    """Detect a rope in a mask or an image that is disturbed, cold."""
    name, level, rope, image = scene
    detector, found = ShapeDetector([Centerline(n=_N)], BLUE), Row(ordered=False, distance=np.nan)
    shape = (detector.detect_mask(image) if image.ndim == 2 else detector.detect(image)).shapes[0]
    if shape.ok:
        found = score(shape.pixels, rope.curve, "centers", directed=False)
    return Row(found, disturbance=name, level=level, ok=shape.ok)


def flickering(effort: Effort) -> Iterator[tuple[str, float, Configuration, list[Mask]]]:
    """Draw objects at rest in 60 masks, each of them cut from another noisy image; noise is a share of the contrast."""
    rng, some = np.random.default_rng(effort.seed), range(effort.count(4))
    objects: dict[str, tuple[Configuration, list[Mask]]] = {
        "rope": (Centerline(n=_N), [random_rope(rng, kind).mask for kind in KINDS for _ in some]),
        "outline": (Contour(), [random_blob(rng, kind).mask for kind in BLOBS for _ in some]),
        "cloth": (Surface(rows=4, cols=8), [random_sheet(rng, a, rng.uniform(0, 360)).mask for a in ASPECTS]),
    }
    for name, (spec, masks) in objects.items():
        for sigma, mask in product((0.05, 0.1, 0.15), masks):
            yield name, sigma, spec, [noisy(mask, rng, sigma) for _ in range(60)]


def jitter(scene: tuple[str, float, Configuration, list[Mask]]) -> Row:
    """Detect an object at rest in masks that flicker.

    Returns:
        ``rms`` distance of the points from their mean positions, and ``drift``: the mean distance of the points between
        the first and the last tenth of the frames, in pixels.
    """
    name, noise, spec, masks = scene
    shapes, squares = at_rest(spec, masks)
    first, last = (np.mean([shape.pixels for shape in some], axis=0) for some in (shapes[:6], shapes[-6:]))
    drift, refused = float(np.linalg.norm(last - first, axis=-1).mean()), sum(not shape.ok for shape in shapes)
    rms = float(np.sqrt(squares.mean()))
    return Row(object=name, noise=noise, frames=len(masks), refused=refused, rms=rms, drift=drift)


def follow_rope(scene: tuple[int, float]) -> Row:
    """Track a rope that wanders and bends; an anchor gives point 0 in the first frame; slips are in gaps."""
    seed, speed = scene

    def begin(rope: Rope) -> ShapeDetector:
        u, v = rope.curve[0].tolist()
        return ShapeDetector([Centerline(n=_N, ends="tips", anchor=(u, v))])

    found = list(followed(moving_rope(np.random.default_rng(seed), speed), begin))
    scores = [score(detection.shapes[0].pixels, rope.curve, "tips") for rope, detection in found]
    flips, not_ok = sum(each.flipped for each in scores), sum(not detection.ok for _, detection in found)
    return Row(tally(scores), speed=speed, flips=flips, not_ok=not_ok, distance=mean(each.distance for each in scores))


CLAIMS: Final = (
    Claim(
        "ropes.cold", "Drawn ropes, each found cold with N = 8, 20, 50 and 100 in both `ends` modes.",
        drawn_ropes, cold_rope, ("kind",),
        {"detections": len, "order wrong": failures("ordered"), "refused": failures("ok"),
         "to the axis, mean [px]": of(mean, "distance"), "worst [px]": of(worst, "distance"),
         "worst point [widths]": of(worst, "widths"),
         "tip, worst [px]": of(worst, "tip"),
         "gap CV, worst": of(worst, "gap_cv", lambda row: row.spaced),
         "narrow bends": of(len, "gap_cv", lambda row: row.n >= 12 and not row.spaced)},
        limits=(
            Limit("order wrong", at_most=0), Limit("refused", at_most=0), Limit("worst [px]", at_most=0.6, unit="px"),
            Limit("worst point [widths]", at_most=0.5),
            Limit("tip, worst [px]", at_most=1.5, unit="px", known="0.7 % of the tips, of ends that curl narrowly"),
            Limit("tip, worst [px]", at_most=4, unit="px"), Limit("gap CV, worst", at_most=0.01),
        ),
    ),
    Claim(
        "ropes.tangled", "Ropes that cross themselves, are cut, or touch themselves, cold, and the time of thinning.",
        tangles, cold_tangle, ("rope",),
        {"masks": len, "right [%]": percent("right"), "refused [%]": percent("refused"),
         "silently wrong [%]": percent("wrong"), "hidden points": total("hidden"),
         "called visible": total("called_visible"), "frame [ms]": of(median, "ms"),
         "times thinning": of(median, "ratio")},
        limits=(
            Limit("right [%]", at_least=98, unit="%", where={"rope": (*tuple(TANGLES)[:4], "side by side")},
                  sampled=95),
            Limit("right [%]", at_least=90, unit="%"), Limit("silently wrong [%]", at_most=1, unit="%", sampled=2),
            Limit("times thinning", at_most=1.0, unit="x"),
        ),
    ),
    Claim(
        "ropes.noise", "Drawn ropes with flipped pixels, ragged edges and in uneven light, cold.",
        disturbed, cold_in_noise, ("disturbance", "level"),
        {"ropes": len, "order right [%]": percent("ordered"), "refused": failures("ok"),
         "to the axis [px]": of(mean, "distance")},
        limits=(
            Limit("order right [%]", at_least=95, unit="%"), Limit("to the axis [px]", at_most=1.0, unit="px"),
            Limit("to the axis [px]", at_most=0.3, unit="px", where={"disturbance": "salt and pepper"}),
        ),
    ),
    Claim(
        "ropes.rest", "Ropes, outlines and cloths at rest in masks that flicker: rms movement of the points.",
        flickering, jitter, ("object", "noise"),
        {"objects": len, "refused": total("refused"), "median [px]": of(median, "rms"), "mean [px]": of(mean, "rms"),
         "worst [px]": of(worst, "rms"), "drift, worst [px]": of(worst, "drift")},
        limits=(
            Limit("refused", at_most=0), Limit("median [px]", at_most=0.6), Limit("mean [px]", at_most=0.6, sampled=5),
            Limit("mean [px]", at_most=0.45, unit="px", where={"object": ("rope", "cloth")}),
            Limit("mean [px]", at_most=0.3, unit="px", where={"object": ("rope", "cloth"), "noise": (0.05, 0.1)}),
            Limit("worst [px]", at_most=1.2, unit="px", where={"object": ("rope", "cloth")}),
            Limit("drift, worst [px]", at_most=0.7, unit="px", where={"object": ("rope", "cloth")}),
            Limit("drift, worst [px]", at_most=0.7, unit="px", sampled=7),
        ),
    ),
    Claim(
        "ropes.moving", "Ropes that wander, turn and bend over 180 frames, by the pixels of a frame's largest motion.",
        lambda effort: product(effort.seeds(6), (10, 40)), follow_rope, ("speed",),
        {"tracks": len, "flips": total("flips"), "slips": total("slips"), "refused": total("not_ok"),
         "worst place [gaps]": of(worst, "worst_slip"), "to the axis [px]": of(mean, "distance")},
        limits=(
            Limit("flips", at_most=0), Limit("slips", at_most=0), Limit("refused", at_most=0),
            Limit("to the axis [px]", at_most=0.6, unit="px"),
        ),
    ),
)  # fmt: skip
