"""Sheets: lattices on cloths that are drawn, turned, moved, at rest, under a hand, tilted, bent and folded."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import pairwise, product
from typing import Any, Final, get_args

import numpy as np

from shape_obs.bench.scenes import Sheet, moving_sheet
from shape_obs.configurations.surface import Surface
from shape_obs.detector import ShapeDetector
from tests.benchmarks import at_rest, cold, followed
from tests.benchmarks.claim import Claim, Effort, Limit
from tests.benchmarks.outlines import SPEEDS, SWINGS, VIEWS
from tests.benchmarks.scenes.flat_objects import FlatScene, Hand, Motion, View, cloth, in_space, noisy_depth, under_hand
from tests.benchmarks.scenes.sheets import noisy, random_sheet, true_lattice, turning_sheet
from tests.benchmarks.scores import (
    BOTH_ENDS,
    SLIP,
    VISIBLE,
    VISIBLE_LIMITS,
    belief,
    off_lattice,
    tally,
    visible_row,
)
from tests.benchmarks.sheet_scores import ASPECTS, best_corner, by_the_rule, score_sheet
from tests.benchmarks.tables import Row, failures, mean, median, of, total, worst

LATTICES: Final = ((4, 8), (2, 2), (3, 3), (8, 8), (6, 10))
_SPEC: Final = Surface(rows=4, cols=8)  # of tracked cloths


def drawn_sheets(effort: Effort) -> Iterator[Sheet]:
    """Draw bent cloths at all angles."""
    rng, count = np.random.default_rng(effort.seed), effort.count(48)
    for number in range(count):
        degrees = 360 * number / count + rng.uniform(-5, 5)
        yield random_sheet(rng, ASPECTS[number % len(ASPECTS)], degrees, tilt=0.02)


def cold_sheet(sheet: Sheet) -> Iterator[Row]:
    """Detect a cloth cold, with each lattice and in both end modes."""
    for (rows, cols), ends in product(LATTICES, BOTH_ENDS):
        spec = Surface(rows=rows, cols=cols, ends=ends)
        shape = cold(spec, sheet.mask)
        right, score = by_the_rule(shape, sheet, spec)
        yield Row(score, lattice=f"{rows} x {cols}", ok=shape.ok, corner=right, slipped=score.slip > SLIP)


def track_sheet(scenes: Iterable[Sheet]) -> Row:
    """Track a cloth whose first corner is the one at which the first frame fits best; slips are in gaps."""
    scores: list[Row] = []
    times: list[float] = []
    corner, not_ok = -1, 0
    for sheet, detection in followed(scenes, lambda sheet: ShapeDetector([_SPEC])):
        shape = detection.shapes[0]
        corner = corner if scores else best_corner(shape, sheet, _SPEC)[0]
        scores.append(score_sheet(shape.pixels, sheet, _SPEC.rows, _SPEC.cols, "centers", corner))
        times.append(detection.timings["fit"] + detection.timings["lift"])
        not_ok += bool(shape.reason)
    moves = [np.abs(after.off - before.off).max() for before, after in pairwise(scores)]
    distance, far = mean(each.mean for each in scores), max(each.worst for each in scores)
    return Row(tally(scores), not_ok=not_ok, move=float(max(moves)), distance=distance, far=far, ms=median(times))


def follow_turning(seed: int) -> Row:
    """Track a cloth that turns once around on the spot, by a degree per frame, and detect each frame cold as well."""
    scenes = list(turning_sheet(np.random.default_rng(seed), ASPECTS[seed % len(ASPECTS)]))
    shapes = [cold(_SPEC, sheet.mask) for sheet in scenes]
    found = [by_the_rule(*pair, _SPEC) for pair in zip(shapes, scenes, strict=True)]
    wrong = sum(score.slip > SLIP or not right for right, score in found)
    return Row(track_sheet(scenes), motion="a full turn", cold_wrong=wrong, cold_refused=sum(not s.ok for s in shapes))


def follow_moving(seed: int) -> Row:
    """Track a cloth that wanders by 12 px per frame, turns and bends."""
    motion = moving_sheet(np.random.default_rng(seed), 12, aspect=ASPECTS[seed % len(ASPECTS)])
    return Row(track_sheet(motion), motion="12 px a frame", cold_wrong=0, cold_refused=0)


def rest(seed: int) -> Row:
    """Return the RMS movement in pixels of the points of a cloth at rest whose mask flickers."""
    rng, aspect = np.random.default_rng(seed), ASPECTS[seed % len(ASPECTS)]
    sheet = random_sheet(rng, aspect, float(rng.uniform(0, 360)))
    shapes, squares = at_rest(_SPEC, [noisy(sheet.mask, rng) for _ in range(60)])
    jitter, highest = np.sqrt([squares.mean(), squares.mean(axis=0).max()]).tolist()
    return Row(aspect=aspect, refused=sum(not shape.ok for shape in shapes), rms=jitter, worst=highest)


def under_hands(with_depth: bool) -> Callable[[Effort], Iterator[dict[str, Any]]]:
    """Return the scenes of cloths over a corner or a side of which a hand comes, stays and goes."""

    def scenes(effort: Effort) -> Iterator[dict[str, Any]]:
        hands: tuple[Hand, ...] = get_args(Hand)
        for view, place, moving, seed, speed in product(VIEWS, hands, (0.0, 4.0), effort.seeds(50), SPEEDS):
            rng = np.random.default_rng((seed, round(10 * speed)))
            drawn = under_hand(rng, cloth(ASPECTS[seed % 3]), view, place, speed, moving, level=not with_depth)
            yield {"scenes": drawn, "view": view, "motion": f"hand on a {place}, {moving:g} px", "depth": with_depth}

    return scenes


def swung(noise: bool) -> Callable[[Effort], Iterator[dict[str, Any]]]:
    """Return the scenes of cloths that are tilted, of which a corner bends to the camera, and that are folded."""

    def scenes(effort: Effort) -> Iterator[dict[str, Any]]:
        motions: tuple[Motion, ...] = get_args(Motion)
        views = (*VIEWS, View(wall=False))
        for view, motion, seed, speed in product(views, motions, effort.seeds(50), SWINGS):
            rng = np.random.default_rng((seed, round(10 * speed)))
            drawn = in_space(rng, cloth(ASPECTS[seed % 3]), view, motion, speed, 120)
            drawn = noisy_depth(drawn, view, seed) if noise else drawn
            yield {"scenes": drawn, "view": view, "motion": motion + ("" if view.wall else ", no wall"), "depth": True}

    return scenes


def follow_hidden(scene: dict[str, Any]) -> Row:
    """Track a cloth of which a part is hidden or bent, and count what was claimed of its points."""
    frames = seen_points(scene["scenes"], scene["view"], scene["depth"])
    return visible_row(frames, rows=scene["view"].height, motion=scene["motion"])


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


_FOLDED: Final = "a folded cloth is often refused, and small ones slip"
CLAIMS: Final = (
    Claim(
        "sheets.cold", "Bent cloths of all aspects and orientations, cold, with each lattice in both `ends` modes.",
        drawn_sheets, cold_sheet, ("lattice",),
        {"detections": len, "refused": failures("ok"), "corner wrong": failures("corner"), "slips": total("slipped"),
         "worst slip [cells]": of(worst, "slip"), "to the material, mean [px]": of(mean, "mean"),
         "worst cloth [px]": of(worst, "mean"), "worst point [px]": of(worst, "worst")},
        limits=(
            Limit("refused", at_most=0), Limit("corner wrong", at_most=0), Limit("slips", at_most=0),
            Limit("to the material, mean [px]", at_most=1.5, unit="px"),
            Limit("worst cloth [px]", at_most=3.0, unit="px", sampled=3.5),
        ),
    ),
    *(
        Claim(
            f"sheets.{name}", what, lambda effort: effort.seeds(6), follow, ("motion",),
            {"cloths": len, "frames": total("frames"), "slips": total("slips"), "refused": total("not_ok"),
             "worst place [cells]": of(worst, "worst_slip"), "worst move [cells]": of(worst, "move"),
             "to the material [px]": of(mean, "distance"), "cold: corner or point wrong": total("cold_wrong"),
             "cold: refused": total("cold_refused"), "fit [ms]": of(median, "ms")},
            limits=(
                Limit("slips", at_most=0), Limit("refused", at_most=0), Limit("worst place [cells]", at_most=0.3),
                Limit("cold: corner or point wrong", at_most=0),
            ),
        )
        for name, what, follow in (
            ("turning", "Cloths that turn once around in steps of a degree, tracked and cold.", follow_turning),
            ("moving", "Cloths that wander, turn and bend, tracked over 180 frames.", follow_moving),
        )
    ),
    Claim(
        "sheets.rest", "Cloths at rest in masks that flicker: RMS movement of their points.",
        lambda effort: effort.seeds(6), rest, ("aspect",),
        {"cloths": len, "refused": total("refused"), "rms [px]": of(mean, "rms"),
         "worst point [px]": of(worst, "worst")},
        limits=(Limit("refused", at_most=0), Limit("rms [px]", at_most=0.3, unit="px")),
    ),
    *(
        Claim(f"sheets.hands.{name}", f"Cloths over a corner or a side of which a hand comes, stays and goes: {name}.",
              under_hands(depth), follow_hidden, ("rows", "motion"), VISIBLE, limits=VISIBLE_LIMITS)
        for name, depth in (("mask", False), ("depth", True))
    ),
    *(
        Claim(f"sheets.space.{name}", f"Cloths that are tilted, bent up at a corner, or folded: depth {name}.",
              swung(noise), follow_hidden, ("rows", "motion"), VISIBLE,
              limits=tuple(replace(each, known=_FOLDED) for each in VISIBLE_LIMITS))
        for name, noise in (("exact", False), ("noisy", True))
    ),
)  # fmt: skip
