"""Measure the accuracy of surfaces on drawn cloths: at rest, turning, moving, noisy."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import pairwise, product
from typing import Final, get_args

import numpy as np
import numpy.typing as npt

from shape_obs.bench.scenes import Sheet, moving_sheet
from shape_obs.configurations.base import Ends
from shape_obs.configurations.surface import Surface
from shape_obs.detector import ShapeDetector
from shape_obs.shape import Shape
from tests.benchmarks import at_rest, cold, followed
from tests.benchmarks.scenes.flat_objects import FlatScene, Hand, Motion, View, cloth, in_space, noisy_depth, under_hand
from tests.benchmarks.scenes.sheets import noisy, random_sheet, true_lattice, turning_sheet
from tests.benchmarks.scores import BOTH_ENDS, SLIP, belief, off_lattice, tally, tally_visible
from tests.benchmarks.tables import Row, failures, mean, median, of, summary

ASPECTS: Final = (1.0, 1.5, 2.0, 3.0, 1 / 2, 1 / 3)
LATTICES: Final = ((4, 8), (2, 2), (3, 3), (8, 8), (6, 10))
VIEWS: Final = (View(), View(height=120))
_SPEC: Final = Surface(rows=4, cols=8)  # of tracked cloths
# In degrees. This close to an eighth of a turn, either of two corners may count as the top left one.
_UNDECIDED: Final = 2.0


def score_sheet(points: npt.ArrayLike, sheet: Sheet, rows: int, cols: int, ends: Ends, quarters: int) -> Row:
    """Compare ``(N, 2)`` found points with a cloth whose first corner is number ``quarters``, counted clockwise.

    Returns:
        ``mean`` and ``worst`` distance of the points from their true positions, in pixels; ``slip``: the largest
        distance of a point from its material, in gaps of the lattice along a row or a column; ``off``: all of these
        distances, (rows, cols, 2), down and across.
    """
    true = true_lattice(np.rot90(sheet.points, quarters), rows, cols, ends)
    away = np.asarray(points, dtype=np.float64).reshape(true.shape) - true
    off = off_lattice(away, true)
    distance = np.linalg.norm(away, axis=-1)
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


def drawn_sheets(count: int, seed: int = 0) -> Iterator[Row]:
    """Detect ``count`` bent cloths cold at all angles, with each lattice and in both end modes.

    Yields:
        A row for each detection; ``corner_right``: point 0 is at the corner that the paper's rule gives; ``score``:
        of ``score_sheet``.
    """
    rng = np.random.default_rng(seed)
    for number in range(count):
        aspect, degrees = ASPECTS[number % len(ASPECTS)], 360 * number / count + rng.uniform(-5, 5)
        sheet = random_sheet(rng, aspect, degrees, tilt=0.02)
        for (rows, cols), ends in product(LATTICES, BOTH_ENDS):
            spec = Surface(rows=rows, cols=cols, ends=ends)
            shape = cold(spec, sheet.mask)
            right, score = _by_the_rule(shape, sheet, spec)
            found = {"ok": shape.ok, "corner_right": right, "quality": shape.quality, "score": score}
            yield Row(aspect=aspect, lattice=f"{rows}x{cols}", ends=ends, **found)


def sheet_table(results: Iterable[Row]) -> list[Row]:
    """Return the mean and the worst result of each lattice."""
    columns = {
        "sheets": lambda found: len(found) // len({row.ends for row in found}),
        "not_ok": failures("ok"),
        "corner_wrong": failures("corner_right"),
        "slips": of(lambda slips: sum(slip > SLIP for slip in slips), "score.slip"),
        "worst_slip": of(max, "score.slip"),
        "distance_mean_px": of(mean, "score.mean"),
        "worst_sheet_px": of(max, "score.mean"),
        "worst_point_px": of(max, "score.worst"),
    }
    return summary(results, ("lattice",), columns)


def turning_sheets(seeds: Iterable[int]) -> Iterator[Row]:
    """Track bent cloths that turn once around on the spot, by a degree per frame, and detect each frame cold.

    Yields:
        A row for each cloth: slips and moves of the tracked points in gaps, and the cold frames in which the corner or
        a point was wrong.
    """
    for seed in seeds:
        aspect = ASPECTS[seed % len(ASPECTS)]
        scenes = list(turning_sheet(np.random.default_rng(seed), aspect))
        tracked, scores, _ = _tracked(scenes)
        moves = [np.abs(after.off - before.off).max() for before, after in pairwise(scores)]
        shapes = [cold(_SPEC, sheet.mask) for sheet in scenes]
        found = [_by_the_rule(*pair, _SPEC) for pair in zip(shapes, scenes, strict=True)]
        yield Row(
            aspect=aspect,
            frames=tracked.frames,
            tracked_slips=tracked.slips,
            tracked_not_ok=tracked.not_ok,
            worst_slip=tracked.worst_slip,
            worst_move=float(max(moves)),
            cold_wrong=sum(score.slip > SLIP or not right for right, score in found),
            cold_undecided=sum(first_corner(sheet)[1] for sheet in scenes),
            cold_not_ok=sum(not shape.ok for shape in shapes),
        )


def moving_sheets(speeds: Iterable[float], seeds: Iterable[int], frames: int = 180) -> Iterator[Row]:
    """Track cloths that wander, turn and bend.

    Yields:
        A row for each track: lengths in pixels, slips in gaps, milliseconds of a warm frame.
    """
    for seed, speed in product(seeds, speeds):
        motion = moving_sheet(np.random.default_rng(seed), speed, frames, aspect=ASPECTS[seed % len(ASPECTS)])
        tracked, scores, times = _tracked(motion)
        distance, worst = mean(each.mean for each in scores), max(each.worst for each in scores)
        yield Row(speed=speed, **tracked, mean_distance=distance, worst_distance=worst, milliseconds=median(times))


def noisy_sheets(seeds: Iterable[int], frames: int = 60) -> Iterator[Row]:
    """Track cloths at rest whose mask is cut from another noisy image in every frame.

    Yields:
        The RMS movement of the points of each cloth, in pixels: ``mean`` over all, and that of the worst point.
    """
    for seed in seeds:
        rng, aspect = np.random.default_rng(seed), ASPECTS[seed % len(ASPECTS)]
        sheet = random_sheet(rng, aspect, float(rng.uniform(0, 360)))
        shapes, squares = at_rest(_SPEC, (noisy(sheet.mask, rng) for _ in range(frames)))
        by_point = squares.mean(axis=0)
        jitter, highest = np.sqrt([by_point.mean(), by_point.max()]).tolist()
        not_ok = sum(not shape.ok for shape in shapes)
        yield Row(aspect=aspect, frames=frames, not_ok=not_ok, mean=jitter, worst_point=highest)


def cloths_under_hands(
    seeds: Iterable[int], speeds: Iterable[float], views: Iterable[View] = VIEWS, *, with_depth: bool
) -> Iterator[Row]:
    """Track cloths over a corner or a side of which a hand comes, stays and goes, at rest and moving.

    Args:
        seeds: Of the scenes.
        speeds: Of the hand, pixels of a 640 x 480 image per frame.
        views: Images and backgrounds.
        with_depth: Whether depth shows the hand, and the cloth; else there is a mask alone.

    Yields:
        The fields of ``tally_visible`` for each kind of hand, motion and view.
    """
    seeds, speeds = list(seeds), list(speeds)
    for view, place, moving in product(views, get_args(Hand), (0.0, 4.0)):
        frames: list[Row] = []
        for seed, speed in product(seeds, speeds):
            rng = np.random.default_rng((seed, round(10 * speed)))
            scenes = under_hand(rng, cloth(ASPECTS[seed % 3]), view, place, speed, moving, level=not with_depth)
            frames += seen_points(scenes, view, with_depth)
        yield Row(rows=view.height, hand=place, moving=moving, depth=with_depth, **tally_visible(frames))


def cloths_in_space(
    seeds: Iterable[int],
    speeds: Iterable[float],
    views: Iterable[View] = (*VIEWS, View(wall=False)),
    *,
    noise: bool = False,
    frames: int = 120,
) -> Iterator[Row]:
    """Track cloths that are lifted and tilted, of which a corner bends towards the camera, and that are folded.

    Yields:
        The fields of ``tally_visible`` for each kind of motion and view.
    """
    seeds, speeds = list(seeds), list(speeds)
    for view, motion in product(views, get_args(Motion)):
        found: list[Row] = []
        for seed, speed in product(seeds, speeds):
            rng = np.random.default_rng((seed, round(10 * speed)))
            scenes = in_space(rng, cloth(ASPECTS[seed % 3]), view, motion, speed, frames)
            found += seen_points(noisy_depth(scenes, view, seed) if noise else scenes, view, with_depth=True)
        yield Row(rows=view.height, wall=view.wall, noise=noise, motion=motion, **tally_visible(found))


def seen_points(scenes: Iterable[FlatScene], view: View, with_depth: bool) -> Iterator[Row]:
    """Track a cloth with equal gaps in space where there is depth; yield the rows of ``tally_visible``."""
    spec = Surface(rows=4, cols=8, spacing="m" if with_depth else "px")
    detector, name, corner = ShapeDetector([spec], on_invalid="interpolate"), 0, 0
    for scene in scenes:
        depth, camera = (scene.depth, view.intrinsics) if with_depth else (None, None)
        shape = detector.detect_mask(scene.mask, depth, camera).shapes[0]
        if not name and shape.reason:
            continue  # not begun yet
        whole = np.concatenate([scene.points, scene.space, scene.hidden[..., None].astype(np.float64)], axis=2)
        found = np.asarray(shape.pixels, dtype=np.float64).reshape(4, 8, 2)
        turned = [true_lattice(np.rot90(whole, quarters), 4, 8, "centers") for quarters in range(4)]
        if shape.track_id != name:  # a new track may begin at another corner
            apart = [np.linalg.norm(found - true[..., :2], axis=-1).mean() for true in turned]
            name, corner = shape.track_id, int(np.argmin(apart))
        true = turned[corner]
        away, place = found - true[..., :2], true[..., :2]
        if shape.points3d is not None:  # in the image a steep piece of cloth has no gaps
            away, place = shape.points3d.reshape(4, 8, 3) - true[..., 2:5], true[..., 2:5]
        off = np.abs(off_lattice(np.nan_to_num(away), place)).max(axis=-1).ravel()
        mm = 1e3 * np.linalg.norm(away, axis=-1).ravel() if shape.points3d is not None else np.full(32, np.nan)
        hidden, slipped = true[..., 5].ravel() > 0.5, bool((off[shape.visible] > SLIP).any())
        claimed = {"visible": shape.visible, "valid": shape.valid, "hidden": hidden, "track": name}
        claimed["belief"] = belief(shape, np.linalg.norm(away, axis=-1).ravel(), ~hidden, slipped)
        yield Row(ok=shape.ok and not shape.reason, shown=scene.shown, off=off, mm=mm, **claimed)


def _tracked(scenes: Iterable[Sheet]) -> tuple[Row, list[Row], list[float]]:
    """Track a cloth; its first corner is the one at which the first frame fits best.

    Returns:
        The number of frames, slips and frames without the shape; the scores; the milliseconds of fit and lift.
    """
    scores: list[Row] = []
    times: list[float] = []
    corner, not_ok = -1, 0
    for sheet, detection in followed(scenes, lambda sheet: ShapeDetector([_SPEC])):
        shape = detection.shapes[0]
        corner = corner if scores else _best(shape, sheet, _SPEC)[0]
        scores.append(score_sheet(shape.pixels, sheet, _SPEC.rows, _SPEC.cols, "centers", corner))
        times.append(detection.timings["fit"] + detection.timings["lift"])
        not_ok += bool(shape.reason)
    return Row(tally(scores), not_ok=not_ok), scores, times


def _best(shape: Shape, sheet: Sheet, spec: Surface) -> tuple[int, Row]:
    """Return the corner of the cloth at which the points fit best, and how well they fit there."""
    ends = spec.ends or "centers"
    scores = [score_sheet(shape.pixels, sheet, spec.rows, spec.cols, ends, quarters) for quarters in range(4)]
    return min(enumerate(scores), key=lambda pair: pair[1].mean)


def _by_the_rule(shape: Shape, sheet: Sheet, spec: Surface) -> tuple[bool, Row]:
    """Return whether point 0 is at the corner that the paper's rule gives, and how well the points fit the cloth."""
    expected, undecided = first_corner(sheet)
    corner, found = _best(shape, sheet, spec)
    return corner == expected or (undecided and (corner - expected) % 2 == 1), found
