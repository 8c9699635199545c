"""Outlines in masks and in space: cold, turning, at rest, under a hand, tilted and bent."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import chain, product
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.bench.scenes import Blob, moving_blob
from shape_obs.configurations.contour import Contour
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.outline import clockwise
from shape_obs.geometry.polyline import arc_length
from tests.benchmarks import cold, followed
from tests.benchmarks.claim import Claim, Effort, Limit
from tests.benchmarks.scores import HAND_LIMITS, VISIBLE, VISIBLE_LIMITS, claimed, outline_score, tally, visible_row
from tests.benchmarks.tables import Column, Row, failures, mean, median, of, total, worst
from tests.scenes.blobs import KINDS, Garment, garments, random_blob
from tests.scenes.flat_objects import FlatScene, Hand, Motion, View, in_space, noisy_depth, ring, under_hand

COUNTS: Final = (16, 32, 64)
Objects = Mapping[str, Callable[[np.random.Generator, int], npt.NDArray[np.float64]]]
Follow = Callable[[Iterator[FlatScene], View, bool], Iterator[Row]]  # scenes, and whether there is depth -> ``claimed``
Track = tuple[Row, Iterator[Row]]  # labels, and the rows of ``claimed``
Scenes = Callable[[Effort], Iterator[Track]]
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
SPEEDS: Final = (0.5, 1, 2, 4, 8, 16)  # of a hand, pixels of a 640 x 480 image per frame
SWINGS: Final = (8, 16, 40)
_OBJECTS: Final[Objects] = {"ring": lambda rng, seed: ring(rng, True), "blob": lambda rng, seed: ring(rng, False)}
_FINE: Final = 64  # places on the true outline to a gap


def drawn_blobs(effort: Effort) -> Iterator[Blob]:
    """Draw random blobs with a known outline."""
    rng = np.random.default_rng(effort.seed)
    return (random_blob(rng, kind) for kind, _ in product(KINDS, range(effort.count(8))))


def annotated(effort: Effort) -> Iterable[Blob]:
    """Return the annotated garments, or nothing without their file."""
    return () if effort.garments is None else garments(effort.garments)


def cold_outline(blob: Blob) -> Iterator[Row]:
    """Detect a blob cold at each N.

    Yields:
        The fields of ``outline_score``. ``corners``: the distance of each annotated corner to the nearest point, as a
        share of the outline's length.
    """
    length = float(np.linalg.norm(np.roll(blob.outline, -1, axis=0) - blob.outline, axis=1).sum())
    for n in COUNTS:
        shape = cold(Contour(n=n), blob.mask)
        found = shape.pixels.astype(np.float64)
        keypoints = blob.corners.values() if isinstance(blob, Garment) else ()
        corners = [np.linalg.norm(found - corner, axis=1).min() / length for corner in keypoints]
        yield Row(outline_score(found, blob.outline), kind=blob.kind, n=n, ok=shape.ok, corners=corners)


def follow_outline(scene: tuple[int, str]) -> Row:
    """Track an outline that turns, wanders and deforms; an anchor gives point 0 in the first frame; slips in gaps."""
    seed, motion = scene

    def tracked(blob: Blob) -> npt.NDArray[np.float64]:
        return blob.outline if blob.hole is None else blob.hole

    def begin(blob: Blob) -> ShapeDetector:
        (u, v), hole = tracked(blob)[0].tolist(), None if blob.hole is None else 0
        return ShapeDetector([Contour(hole=hole, anchor=(u, v))])

    drawn = moving_blob(np.random.default_rng(seed), **MOTIONS[motion])
    pairs = [(tracked(blob), detection) for blob, detection in followed(drawn, begin)]
    scores = [outline_score(detection.shapes[0].pixels, truth) for truth, detection in pairs]
    return Row(
        tally(scores),
        motion=motion,
        disordered=sum(not (score.ordered and score.clockwise) for score in scores),
        not_ok=sum(not detection.ok for _, detection in pairs),
        distance=mean(score.distance for score in scores),
        fit_ms=median(detection.timings["fit"] for _, detection in pairs),
    )


def hands(objects: Objects, follow: Follow, places: tuple[Hand, ...], depth: bool) -> Scenes:
    """Return the scenes of objects over the border of which a hand comes, stays and goes.

    Args:
        objects: Name -> takes a generator and a seed, and returns a material grid.
        follow: How they are tracked.
        places: What the hand covers.
        depth: Whether there is depth.
    """

    def scenes(effort: Effort) -> Iterator[Track]:
        every = product(VIEWS, objects.items(), places, (0.0, 4.0), effort.seeds(50), SPEEDS)
        for view, (name, make), place, moving, seed, speed in every:
            rng = np.random.default_rng((seed, round(10 * speed)))
            drawn = under_hand(rng, make(rng, seed), view, place, speed, moving, level=not depth)
            labels = Row(rows=view.height, object=name, motion=f"hand on a {place}, {moving:g} px")
            yield labels, follow(drawn, view, depth)

    return scenes


def swings(
    objects: Objects, follow: Follow, motions: tuple[Motion, ...], noise: bool, views: tuple[View, ...] = VIEWS
) -> Scenes:
    """Return the scenes of objects that are swung through the air, with exact depth or that of a D455."""

    def scenes(effort: Effort) -> Iterator[Track]:
        every = product(views, objects.items(), motions, effort.seeds(50), SWINGS)
        for view, (name, make), motion, seed, speed in every:
            rng = np.random.default_rng((seed, round(10 * speed)))
            drawn = in_space(rng, make(rng, seed), view, motion, speed)
            drawn = noisy_depth(drawn, view, seed) if noise else drawn
            labels = Row(rows=view.height, object=name, motion=motion + ("" if view.wall else ", no wall"))
            yield labels, follow(drawn, view, True)

    return scenes


def hidden_row(track: Track) -> Row:
    """Count what was claimed of the points of a tracked object, of which a part is hidden or bent."""
    labels, frames = track
    return visible_row(frames, **labels)


def seen_outline(scenes: Iterable[FlatScene], view: View, with_depth: bool) -> Iterator[Row]:
    """Track an outline with equal gaps in space where there is depth; yield the rows of ``claimed``."""
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
        errors = np.linalg.norm(place - true[:, :2], axis=1)
        if shape.points3d is not None:
            errors = np.linalg.norm(shape.points3d - true[:, 2:5], axis=1)
        yield claimed(shape, off, errors, true[:, 5] > 0.5, scene.shown, name)


_COLD: Final[dict[str, Column]] = {
    "outlines": len,
    "order wrong": failures("ordered", "clockwise"),
    "refused": failures("ok"),
    "to the outline, mean [px]": of(mean, "distance"),
    "worst [px]": of(worst, "distance"),
    "gap CV, worst": of(worst, "gap_cv"),
    "corners missed, median [%]": lambda rows: _percent(median(chain(*(row.corners for row in rows)))),
}
_COLD_LIMITS: Final = (
    Limit("order wrong", at_most=0),
    Limit("refused", at_most=0),
    Limit("to the outline, mean [px]", at_most=0.15, unit="px"),
    Limit("worst [px]", at_most=0.3, unit="px"),
    # Where an outline bends within a gap the gaps are unequal, so that points stay on their material.
    Limit("gap CV, worst", at_most=0.2),
    Limit("gap CV, worst", at_most=0.01, where={"n": 64}),
)


def _percent(share: float | None) -> float | None:
    return None if share is None else 100 * share


CLAIMS: Final = (
    Claim("outlines.cold", "Drawn blobs, cold, at N = 16, 32 and 64.",
          drawn_blobs, cold_outline, ("kind", "n"), _COLD,
          limits=(*_COLD_LIMITS, Limit("gap CV, worst", at_most=0.01, where={"kind": ("smooth", "star")}))),
    Claim("outlines.garments", "Annotated garments (`--garments FILE`), cold, at N = 16, 32 and 64.",
          annotated, cold_outline, ("kind", "n"), _COLD, limits=_COLD_LIMITS),
    Claim(
        "outlines.turning", "Outlines that turn, wander and deform, tracked over 180 frames.",
        lambda effort: product(effort.seeds(2), MOTIONS), follow_outline, ("motion",),
        {"tracks": len, "disordered": total("disordered"), "slips": total("slips"), "refused": total("not_ok"),
         "worst slip [gaps]": of(worst, "worst_slip"), "to the outline [px]": of(mean, "distance"),
         "fit [ms]": of(median, "fit_ms")},
        limits=(
            Limit("disordered", at_most=0), Limit("slips", at_most=0), Limit("refused", at_most=0),
            Limit("worst slip [gaps]", at_most=0.1, where={"motion": ("nearly round", "40 px a frame", "hole")}),
            Limit("to the outline [px]", at_most=0.15, unit="px"),
        ),
    ),
    *(
        Claim(f"outlines.hands.{name}", f"Rings and blobs over which a hand comes, stays and goes: {name}.",
              hands(_OBJECTS, seen_outline, ("side",), depth), hidden_row, ("rows", "object", "motion"), VISIBLE,
              limits=HAND_LIMITS)
        for name, depth in (("mask", False), ("depth", True))
    ),
    *(
        Claim(f"outlines.space.{name}", f"Rings and blobs that are tilted, or of which a side bends up: depth {name}.",
              swings(_OBJECTS, seen_outline, ("tilted", "corner up"), noise), hidden_row, ("rows", "object", "motion"),
              VISIBLE, limits=VISIBLE_LIMITS)
        for name, noise in (("exact", False), ("noisy", True))
    ),
)  # fmt: skip
