"""Ropes in masks: cold, bent, crossing, cut, in noise, at rest, moving, and under a hand."""

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

from shape_obs.bench.photos import BLUE, photographed
from shape_obs.bench.scenes import Rope, moving_rope
from shape_obs.configurations.centerline import Centerline
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.polyline import arc_length, resample
from shape_obs.image.find_region import find_region
from shape_obs.image.roi import Window
from shape_obs.image.segmentation import Segmentation
from shape_obs.initialization.medial_axis import medial_axis
from shape_obs.shape import Shape
from tests.benchmarks import Mask, at_rest, cold, followed
from tests.benchmarks.claim import Claim, Effort, Limit
from tests.benchmarks.rope_scores import is_traversed
from tests.benchmarks.scenes.hidden_ropes import Hidden, Where, hidden_rope
from tests.benchmarks.scenes.images import ragged, salted
from tests.benchmarks.scenes.ropes import BENDS, KINDS, bend_radius, bending_rope, bent_rope, random_rope
from tests.benchmarks.scenes.sheets import noisy
from tests.benchmarks.scenes.tangles import Tangle, crossing_rope, cut_rope, looped_rope, touching_rope
from tests.benchmarks.scores import BOTH_ENDS, SLIP, faithfulness, score, tally
from tests.benchmarks.tables import Row, failures, mean, median, of, percent, total, worst

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


def drawn_ropes(effort: Effort) -> Iterator[tuple[str, Rope]]:
    """Draw random ropes of every kind with a known centreline."""
    rng = np.random.default_rng(effort.seed)
    for kind, _ in product(KINDS, range(effort.count(40))):
        yield kind, random_rope(rng, kind)


def cold_rope(scene: tuple[str, Rope]) -> Iterator[Row]:
    """Detect a rope cold, at each N and in both end modes.

    Yields:
        The fields of ``score``. ``spaced``: gaps can be equal; where a bend is narrower than a gap, equal chords would
        move points away from their material.
    """
    kind, rope = scene
    for n, ends in product(COUNTS, BOTH_ENDS):
        shape = cold(Centerline(n=n, ends=ends), rope.mask)
        found = score(shape.pixels, rope.curve, ends, directed=False)
        spaced = n >= 12 and rope.length / n <= 2 * bend_radius(rope)
        tip = found["tip"] if ends == "tips" else np.nan
        yield Row(found, kind=kind, n=n, tip=tip, ok=shape.ok, spaced=spaced)


def bends(effort: Effort) -> Iterator[tuple[str, float, Any]]:
    """Draw ropes that bend to a few widths: each by itself, and each frame of ropes that bend more and more."""
    draws: dict[str, Callable[..., Rope | Tangle]] = {bend: partial(bent_rope, bend=bend) for bend in BENDS}
    for radius, (index, (bend, draw)) in product((1.5, 2, 3), enumerate([*draws.items(), ("loops", looped_rope)])):
        rng = np.random.default_rng([effort.seed, round(10 * radius), index])
        for width, _ in product((4, 6, 9, 14), range(effort.count(4))):
            yield bend, radius, draw(rng, radius=radius, width=width)
    for radius, width in product((1.5, 2, 3), (4, 6, 9, 14)[: effort.count(4)]):
        yield "bending", radius, width


def bent_rope_followed(scene: tuple[str, float, Any]) -> Iterator[Row]:
    """Detect a bent rope cold and after 10 frames at rest, or a rope while it bends; yield ``faithfulness``."""
    bend, radius, drawn = scene
    spec = Centerline(n=256, ends="tips")
    if bend == "bending":
        frames = list(followed(bending_rope(radius, drawn), lambda _: ShapeDetector([spec])))
        pairs = [("tracked", rope, detection.shapes[0]) for rope, detection in frames[len(frames) // 2 :]]
    else:
        shapes = at_rest(spec, [drawn.mask] * 10)[0]
        pairs = [("cold", drawn, shapes[0]), ("tracked", drawn, shapes[-1])]
    for way, rope, shape in pairs:
        found = faithfulness(shape.pixels, rope.curve, rope.width) if shape.ok else {}
        empty = dict.fromkeys(("within", "distance", "farthest"), np.nan)
        yield Row({**empty, **found}, bend=bend, radius=radius, detected=way, ok=shape.ok)


def cold_tangle(scene: tuple[str, Tangle]) -> Row:
    """Detect a tangled rope cold, and time that against thinning with the longest path, on the same mask.

    Returns:
        ``right``: whether it was found as the rope runs; ``wrong``: whether it was accepted and does not; ``hidden``:
        points under the occluder of a rope that was found right, ``called_visible`` those reported visible; ``ms`` of a
        frame; ``ratio``: time of the start over that of the peer, None without scikit-image.
    """
    name, tangle = scene
    runs: list[Callable[[Mask], object]] = [_start, cold_path]
    if find_spec("skimage") is not None:
        from skimage.morphology import skeletonize

        runs.append(lambda mask: longest_path(np.asarray(skeletonize(mask > 0))))
    taken = [1e3 * timeit.timeit(partial(run, tangle.mask), number=1) for run in runs]
    shape = cold_path(tangle.mask)
    right = shape.ok and is_traversed(shape.pixels, tangle)
    hidden = points_hidden(shape, tangle) if right else np.zeros(len(shape), bool)
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


def cold_path(mask: Mask) -> Shape:
    """Detect a centerline of 60 points without a track."""
    return cold(Centerline(n=_FINE), mask)


def _start(mask: Mask) -> object:
    window = Window(0, 0, mask.shape[1], mask.shape[0])
    return medial_axis(find_region(mask, window, Segmentation.min_area, Segmentation.min_share))


def points_hidden(shape: Shape, tangle: Tangle) -> npt.NDArray[np.bool_]:
    """Return which points of a rightly found shape belong under the occluder: ``(N,)`` bool.

    A point is located by its share of the rope's length, so that the form of a bridge makes no difference. Points
    within a gap of the occluder's edge do not count.
    """
    arc = arc_length(np.ascontiguousarray(tangle.curve))
    gap = arc[-1] / len(shape)
    at = (np.arange(len(shape)) + 0.5) * gap
    reached = [tangle.hidden[np.searchsorted(arc, np.clip(at + off, 0, arc[-1]))] for off in (-gap, 0.0, gap)]
    inside = np.logical_and.reduce(reached)
    ends = shape.pixels[[0, -1]]
    forwards, backwards = (np.linalg.norm(ends - tangle.curve[way], axis=1).sum() for way in ([0, -1], [-1, 0]))
    return inside if forwards <= backwards else inside[::-1]


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
    detector = ShapeDetector([Centerline(n=_N)], BLUE)
    shape = (detector.detect_mask(image) if image.ndim == 2 else detector.detect(image)).shapes[0]
    found = (
        score(shape.pixels, rope.curve, "centers", directed=False) if shape.ok else Row(ordered=False, distance=np.nan)
    )
    return Row(found, disturbance=name, level=level, ok=shape.ok)


def flickering(effort: Effort) -> Iterator[tuple[str, float, list[Mask]]]:
    """Draw ropes at rest in 60 masks, each of them cut from another noisy image; noise is a share of the contrast."""
    rng = np.random.default_rng(effort.seed)
    for kind in KINDS:
        ropes = [random_rope(rng, kind) for _ in range(effort.count(4))]
        for sigma, rope in product((0.05, 0.1, 0.15), ropes):
            yield kind, sigma, [noisy(rope.mask, rng, sigma) for _ in range(60)]


def jitter(scene: tuple[str, float, list[Mask]]) -> Row:
    """Return the RMS distance of a rope's points at rest from their mean positions, in pixels."""
    kind, noise, masks = scene
    return Row(kind=kind, noise=noise, rms=float(np.sqrt(at_rest(Centerline(n=_N), masks)[1].mean())))


def _anchored(rope: Rope) -> ShapeDetector:
    """Return a detector whose point 0 is anchored at the rope's first point."""
    u, v = rope.curve[0].tolist()
    return ShapeDetector([Centerline(n=_N, ends="tips", anchor=(u, v))])


def follow_rope(scene: tuple[int, float]) -> Row:
    """Track a rope that wanders and bends; an anchor gives point 0 in the first frame; slips are in gaps."""
    seed, speed = scene
    found = list(followed(moving_rope(np.random.default_rng(seed), speed), _anchored))
    scores = [score(detection.shapes[0].pixels, rope.curve, "tips") for rope, detection in found]
    flips, not_ok = sum(each.flipped for each in scores), sum(not detection.ok for _, detection in found)
    return Row(tally(scores), speed=speed, flips=flips, not_ok=not_ok, distance=mean(each.distance for each in scores))


def under_hands(effort: Effort) -> Iterator[tuple[Where, float, float, int, list[Hidden]]]:
    """Draw ropes that wander and bend while a hand covers a part of them and leaves again."""
    places: tuple[Where, ...] = ("start", "end", "middle")
    for seed, speed, share, where, creep in product(effort.seeds(3), (4, 10), (0.1, 0.25), places, (0, 12)):
        rng = np.random.default_rng(seed)
        yield where, speed, share, creep, list(hidden_rope(rng, speed, share, where, creep=creep))


def follow_under_hand(scene: tuple[str, float, float, int, list[Hidden]]) -> Row:
    """Track a rope under a hand.

    Returns:
        ``lost``: frames in which the shape was refused; ``slips``: frames with a visible point more than half a gap
        from its place, ``worst`` the largest such distance in gaps; ``called_hidden``: visible points that were
        reported hidden; ``called_visible``: hidden points, farther than one point from the edge of the hand, that were
        reported visible; ``points``: of all frames.
    """
    where, speed, share, creep, motion = scene
    row = Row(lost=0, slips=0, worst=0.0, called_hidden=0, called_visible=0, points=_N * len(motion))
    for frame, detection in followed(motion, lambda frame: _anchored(frame.rope)):
        shape = detection.shapes[0]
        if shape.reason:
            row["lost"] += 1
            continue
        truth = resample(frame.rope.curve, _N)
        column, line = np.rint(truth).astype(int).T
        seen = frame.mask[line, column] > 0
        gap = arc_length(np.ascontiguousarray(frame.rope.curve))[-1] / (_N - 1)
        gaps = np.linalg.norm(shape.pixels - truth, axis=1) / gap
        most = float(gaps[seen & shape.visible].max(initial=0.0))
        near_seen = seen | np.roll(seen, 1) | np.roll(seen, -1)
        row["slips"] += most > SLIP
        row["worst"] = max(row["worst"], most)
        row["called_hidden"] += int(np.sum(seen & ~shape.visible))
        row["called_visible"] += int(np.sum(~near_seen & shape.visible))
    where = "an end" if where != "middle" else "the middle"
    return Row(row, where=where, share=share, creep=creep, speed=speed, frames=len(motion))


def tangles(effort: Effort) -> Iterator[tuple[str, Tangle]]:
    """Draw ropes that cross themselves, are cut by an occluder, or run next to themselves."""
    for index, (name, draw) in enumerate(TANGLES.items()):
        rng = np.random.default_rng([effort.seed, index])
        for _ in range(effort.count(100)):
            yield name, draw(rng)


CLAIMS: Final = (
    Claim(
        "ropes.cold", "Drawn ropes, each found cold with N = 8, 20, 50 and 100 in both `ends` modes.",
        drawn_ropes, cold_rope, ("kind",),
        {"detections": len, "order wrong": failures("ordered"), "refused": failures("ok"),
         "to the axis, mean [px]": of(mean, "distance"), "worst [px]": of(worst, "distance"),
         "tip, mean [px]": of(mean, "tip"), "tip, worst [px]": of(worst, "tip"),
         "gap CV, worst": of(worst, "gap_cv", lambda row: row.spaced),
         "narrow bends": of(len, "gap_cv", lambda row: row.n >= 12 and not row.spaced)},
        limits=(
            Limit("order wrong", at_most=0), Limit("refused", at_most=0), Limit("worst [px]", at_most=0.6, unit="px"),
            Limit("tip, worst [px]", at_most=1.5, unit="px", known="0.7 % of the tips, of ends that curl narrowly"),
            Limit("gap CV, worst", at_most=0.01),
        ),
    ),
    Claim(
        "ropes.bent", "Ropes that bend to 1.5, 2 and 3 widths, cold, after 10 frames at rest, and while they bend.",
        bends, bent_rope_followed, ("bend", "detected"),
        {"ropes": len, "refused": failures("ok"),
         "least share within half a width": lambda rows: min((r.within for r in rows if r.ok), default=None),
         "distance [widths]": of(mean, "distance"), "farthest [widths]": of(worst, "farthest")},
        limits=(
            Limit("refused", at_most=1), Limit("least share within half a width", at_least=0.99),
            Limit("farthest [widths]", at_most=0.5),
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
        "ropes.rest", "Ropes at rest in masks that flicker: RMS distance of the points from their mean positions.",
        flickering, jitter, ("noise",),
        {"ropes": len, "rms [px]": of(lambda some: float(np.sqrt(np.mean(np.square(some)))), "rms"),
         "worst rope [px]": of(worst, "rms")},
        limits=(
            Limit("worst rope [px]", at_most=0.3, unit="px", where={"noise": (0.05, 0.1)}),
            Limit("worst rope [px]", at_most=0.45, unit="px"),
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
    Claim(
        "ropes.hands", "Moving ropes of which a hand covers 10 or 25 %, at once or over 12 frames.",
        under_hands, follow_under_hand, ("where", "speed"),
        {"tracks": len, "frames": total("frames"), "slips": total("slips"), "refused": total("lost"),
         "worst place [gaps]": of(worst, "worst"), "called hidden [%]": percent("called_hidden", "points"),
         "called visible [%]": percent("called_visible", "points")},
        limits=(
            Limit("slips", at_most=0), Limit("refused", at_most=0),
            Limit("called hidden [%]", at_most=0.5, unit="%"), Limit("called visible [%]", at_most=0, unit="%"),
        ),
    ),
)  # fmt: skip
