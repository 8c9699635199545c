"""Measure the accuracy of contours: drawn blobs, garments, turning outlines, flickering masks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain, product
from typing import Any, Final, cast

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.scenes import Blob, moving_blob, resample
from shape_obs.configurations.contour import Contour
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.outline import clockwise
from shape_obs.geometry.polyline import MAX_SHIFT_AROUND, arc_length, equal_chords
from tests.benchmarks import at_rest, cold, followed
from tests.benchmarks.scenes.blobs import KINDS, Garment, random_blob
from tests.benchmarks.scenes.flat_objects import FlatScene, Motion, View, in_space, noisy_depth, ring, under_hand
from tests.benchmarks.scores import SLIP, belief, outline_score, tally, tally_visible
from tests.benchmarks.tables import Row, failures, mean, median, of, summary, worst

COUNTS: Final = (16, 32, 64)
# Motions that are tracked: keywords of ``moving_blob``, which by default turns by 0.08 rad per frame.
MOTIONS: Final[dict[str, dict[str, Any]]] = {
    "ring": {},
    "ring backwards": {"turn": -0.08},
    "nearly round": {"bumps": 0.03},
    "12 px a frame": {"speed": 12},
    "40 px a frame": {"speed": 40},
    "deforming": {"turn": 0.03, "swell": 0.4},
    "hole": {"hole": True},
    "circle": {"turn": 0.0, "bumps": 0.0, "speed": 0.2},
    "circle, 160 x 120": {"turn": 0.0, "bumps": 0.0, "speed": 0.2, "radius": 25.0, "size": (120, 160)},
    "nearly round, 160 x 120": {"bumps": 0.03, "radius": 25.0, "size": (120, 160)},
}
VIEWS: Final = (View(), View(height=120))
_FINE: Final = 64  # places on the true outline to a gap
# In gaps. Equal chords may move points along the outline by 1.5 gaps (``equal_chords``); an outline that needs
# this much may need all of it once it is detected.
_COARSE: Final = 1.3


def drawn_blobs(per_kind: int, seed: int = 0) -> Iterator[Blob]:
    """Draw random blobs with a known outline."""
    rng = np.random.default_rng(seed)
    return (random_blob(rng, kind) for kind, _ in product(KINDS, range(per_kind)))


def outlines(blobs: Iterable[Blob], counts: Sequence[int] = COUNTS) -> Iterator[Row]:
    """Detect drawn blobs cold at each N.

    Yields:
        The fields of ``outline_score`` and the blob's. ``coarse``: equal chords would move so few points by 1.3 gaps or
        more from equal arc length, even on the true outline, because it bends within a gap; the gaps may then be
        unequal, so that points stay on their material. ``corners``: the distance of each annotated corner to the
        nearest point, as a share of the outline's length.
    """
    for blob, n in product(blobs, counts):
        length = float(np.linalg.norm(np.roll(blob.outline, -1, axis=0) - blob.outline, axis=1).sum())
        shape = cold(Contour(n=n), blob.mask)
        found = shape.pixels.astype(np.float64)
        coarse = _shift(blob.outline, found[0], n) > _COARSE
        keypoints = blob.corners.values() if isinstance(blob, Garment) else ()
        corners = [np.linalg.norm(found - corner, axis=1).min() / length for corner in keypoints]
        scores = outline_score(found, blob.outline)
        yield Row(kind=blob.kind, n=n, coarse=coarse, ok=shape.ok, corners=corners, **scores)


def outline_table(results: Iterable[Row]) -> list[Row]:
    """Return the mean and the worst result of each kind of blob and N."""
    columns = {
        "blobs": len,
        "order_wrong": failures("ordered", "clockwise"),
        "not_ok": failures("ok"),
        "distance_mean_px": of(mean, "distance"),
        "distance_worst_px": of(worst, "distance"),
        "gap_cv_worst": of(worst, "gap_cv", lambda row: not row.coarse),
        "too_coarse": of(sum, "coarse"),
        "gap_cv_worst_there": of(worst, "gap_cv", lambda row: row.coarse),
        "corner_median_share": of(lambda missed: median(chain(*missed)), "corners"),
    }
    return summary(results, ("kind", "n"), columns)


def turning_blobs(motions: Mapping[str, Mapping[str, Any]] = MOTIONS, seeds: Iterable[int] = (0,)) -> Iterator[Row]:
    """Track outlines that turn, wander and deform; an anchor gives point 0 in the first frame.

    Yields:
        A row for each track; slips in gaps, the rest in pixels and milliseconds.
    """

    def begin(blob: Blob) -> ShapeDetector:
        (u, v), hole = _tracked(blob)[0].tolist(), None if blob.hole is None else 0
        return ShapeDetector([Contour(hole=hole, anchor=(u, v))])

    for seed, (motion, keywords) in product(seeds, motions.items()):
        drawn = moving_blob(np.random.default_rng(seed), **keywords)
        pairs = [(_tracked(blob), detection) for blob, detection in followed(drawn, begin)]
        scores = [outline_score(detection.shapes[0].pixels, truth) for truth, detection in pairs]
        yield Row(
            motion=motion,
            **tally(scores),
            disordered=sum(not (score.ordered and score.clockwise) for score in scores),
            not_ok=sum(not detection.ok for _, detection in pairs),
            last_slip=scores[-1].slip,
            mean_distance=mean(score.distance for score in scores),
            fit_ms=median(detection.timings["fit"] for _, detection in pairs),
        )


def _tracked(blob: Blob) -> npt.NDArray[np.float64]:
    return blob.outline if blob.hole is None else blob.hole


def flickering_blobs(blobs: Iterable[Blob], flipped: Sequence[float] = (0.05, 0.1), frames: int = 60) -> Iterator[Row]:
    """Detect outlines at rest in masks whose border pixels flip.

    Yields:
        ``flipped``: share of the pixels on either side of the border that flip; ``rms``: root mean square distance of
        the points from their mean positions, in pixels; ``drift``: mean distance of the points between the first and
        the last tenth of the frames, in pixels.
    """
    near, few = np.ones((3, 3), np.uint8), max(frames // 10, 1)
    for blob, share in product(blobs, flipped):
        rng, border = np.random.default_rng(0), cv2.dilate(blob.mask, near) != cv2.erode(blob.mask, near)
        flips = (border & (rng.random(border.shape) < share) for _ in range(frames))
        masks = (np.where(each, 255 - blob.mask, blob.mask) for each in flips)
        shapes, squares = at_rest(Contour(), masks)
        first, last = (
            np.mean([shape.pixels for shape in some], axis=0, dtype=np.float64)
            for some in (shapes[:few], shapes[-few:])
        )
        yield Row(
            kind=blob.kind,
            flipped=share,
            not_ok=sum(not shape.ok for shape in shapes),
            rms=float(np.sqrt(squares.mean())),
            drift=float(np.linalg.norm(last - first, axis=-1).mean()),
        )


def _shift(outline: npt.NDArray[np.float64], start: npt.NDArray[np.float64], n: int) -> float:
    """Return how far equal chords move N points on an outline from equal arc length, in gaps."""
    fine = resample(np.concatenate([outline, outline[:1]]), 0.25)[:-1]
    begin = int(np.argmin(np.linalg.norm(fine - start, axis=1)))
    curve = FittedCurve.through(np.roll(fine, -begin, axis=0), np.zeros(len(fine), bool), closed=True)
    around = np.concatenate([curve.points, curve.points[:1]])
    at = equal_chords(around, curve.arc, around, curve.arc, n + 1, 0.0, MAX_SHIFT_AROUND)[1]
    return float(np.abs(at * n / curve.size - np.arange(n + 1)).max())


def outlines_under_hands(
    seeds: Iterable[int], speeds: Iterable[float], views: Iterable[View] = VIEWS, *, with_depth: bool
) -> Iterator[Row]:
    """Track closed bands and plain blobs over the border of which a hand comes, stays and goes.

    Args:
        seeds: Of the scenes.
        speeds: Of the hand, pixels of a 640 x 480 image per frame.
        views: Images and backgrounds.
        with_depth: Whether depth shows the hand, and the object; else there is a mask alone.

    Yields:
        The fields of ``tally_visible`` for each kind of object, motion and view.
    """
    seeds, speeds = list(seeds), list(speeds)
    for view, hollow, moving in product(views, (True, False), (0.0, 4.0)):
        frames: list[Row] = []
        for seed, speed in product(seeds, speeds):
            rng = np.random.default_rng((seed, round(10 * speed)))
            scenes = under_hand(rng, ring(rng, hollow), view, "side", speed, moving, level=not with_depth)
            frames += seen_outline(scenes, view, with_depth)
        yield Row(rows=view.height, ring=hollow, moving=moving, depth=with_depth, **tally_visible(frames))


def outlines_in_space(
    seeds: Iterable[int], speeds: Iterable[float], views: Iterable[View] = VIEWS, *, noise: bool = False
) -> Iterator[Row]:
    """Track closed bands and plain blobs that are lifted and tilted, or of which a side bends towards the camera.

    Yields:
        The fields of ``tally_visible`` for each kind of object, motion and view.
    """
    seeds, speeds, motions = list(seeds), list(speeds), cast("tuple[Motion, ...]", ("tilted", "corner up"))
    for view, hollow, motion in product(views, (True, False), motions):
        found: list[Row] = []
        for seed, speed in product(seeds, speeds):
            rng = np.random.default_rng((seed, round(10 * speed)))
            scenes = in_space(rng, ring(rng, hollow), view, motion, speed)
            found += seen_outline(noisy_depth(scenes, view, seed) if noise else scenes, view, with_depth=True)
        yield Row(rows=view.height, ring=hollow, noise=noise, motion=motion, **tally_visible(found))


def seen_outline(scenes: Iterable[FlatScene], view: View, with_depth: bool) -> Iterator[Row]:
    """Track an outline with equal gaps in space where there is depth; yield the rows of ``tally_visible``."""
    detector = ShapeDetector([Contour(spacing="m" if with_depth else "px")], on_invalid="interpolate")
    name, start, count = 0, 0.0, 32
    for scene in scenes:
        depth, camera = (scene.depth, view.intrinsics) if with_depth else (None, None)
        shape = detector.detect_mask(scene.mask, depth, camera).shapes[0]
        if not name and shape.reason:
            continue  # not begun yet
        border = np.concatenate([scene.points[-1], scene.space[-1], scene.hidden[-1][:, None]], axis=1)
        if not clockwise(border[:, :2]):
            border = np.roll(border[::-1], 1, axis=0)
        metric = border[:, 2:5] if with_depth else border[:, :2]
        arc = arc_length(np.ascontiguousarray(np.concatenate([metric, metric[:1]])))
        fine = FittedCurve(border, np.zeros(len(border), bool), arc, True).even(_FINE * count)
        place = shape.pixels.astype(np.float64)
        nearest = np.argmin(((place[:, None] - fine[:, :2]) ** 2).sum(axis=2), axis=1) / _FINE
        if shape.track_id != name:  # a new track may begin elsewhere
            turn = np.exp(2j * np.pi * (nearest - np.arange(count)) / count).mean()
            name, start = shape.track_id, float(np.angle(turn)) * count / 2 / np.pi % count
        off = np.abs((nearest - np.arange(count) - start + count / 2) % count - count / 2)
        true = fine[np.rint((np.arange(count) + start) * _FINE).astype(int) % len(fine)]
        points = shape.points3d if shape.points3d is not None else np.full((count, 3), np.nan)
        mm = 1e3 * np.linalg.norm(points - true[:, 2:5], axis=1)
        hidden, slipped = true[:, 5] > 0.5, bool((off[shape.visible] > SLIP).any())
        errors = mm / 1e3 if with_depth else np.linalg.norm(place - true[:, :2], axis=1)
        claimed = {"visible": shape.visible, "valid": shape.valid, "hidden": hidden, "track": name}
        claimed["belief"] = belief(shape, errors, ~hidden, slipped)
        yield Row(ok=shape.ok and not shape.reason, shown=scene.shown, off=off, mm=mm, **claimed)
