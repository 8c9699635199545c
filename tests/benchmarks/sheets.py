"""Sheets: lattices on cloths that are drawn, turned, moved, at rest, under a hand, tilted, bent and folded."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import pairwise, product
from typing import Final, get_args

import numpy as np

from shape_obs.bench.scenes import Sheet, moving_sheet
from shape_obs.configurations.surface import Surface
from shape_obs.detector import ShapeDetector
from tests.benchmarks import cold, followed
from tests.benchmarks.claim import Claim, Effort, Limit
from tests.benchmarks.outlines import VIEWS, Objects, hands, hidden_row, swings
from tests.benchmarks.scores import (
    ASPECTS,
    BOTH_ENDS,
    HAND_LIMITS,
    SLIP,
    VISIBLE,
    VISIBLE_LIMITS,
    best_corner,
    by_the_rule,
    claimed,
    off_lattice,
    score_sheet,
    tally,
)
from tests.benchmarks.tables import Column, Row, failures, mean, of, percent, total, worst
from tests.scenes.crumpled import SIDE, Handling, crumpled, from_above, waved
from tests.scenes.flat_objects import FlatScene, Hand, Motion, View, cloth, noisy_depth
from tests.scenes.sheets import random_sheet, true_lattice, turning_sheet

LATTICES: Final = ((4, 8), (2, 2), (3, 3), (8, 8), (6, 10))
_SPEC: Final = Surface(rows=4, cols=8)  # of tracked cloths
_CLOTH: Final[Objects] = {"cloth": lambda rng, seed: cloth(ASPECTS[seed % 3])}


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


def motions(effort: Effort) -> Iterator[tuple[str, list[Sheet]]]:
    """Draw cloths that turn once around on the spot by a degree per frame, and that wander by 12 px, turn and bend."""
    for seed in effort.seeds(6):
        aspect = ASPECTS[seed % len(ASPECTS)]
        yield "a full turn", list(turning_sheet(np.random.default_rng(seed), aspect))
        yield "12 px a frame", list(moving_sheet(np.random.default_rng(seed), 12, aspect=aspect))


def follow(scene: tuple[str, list[Sheet]]) -> Row:
    """Track a cloth, and detect each frame of a full turn cold as well; slips are in gaps.

    The first corner is the one at which the first frame fits best.
    """
    motion, sheets = scene
    scores: list[Row] = []
    corner, not_ok = -1, 0
    for sheet, detection in followed(sheets, lambda sheet: ShapeDetector([_SPEC])):
        shape = detection.shapes[0]
        corner = corner if scores else best_corner(shape, sheet, _SPEC)[0]
        scores.append(score_sheet(shape.pixels, sheet, _SPEC.rows, _SPEC.cols, "centers", corner))
        not_ok += bool(shape.reason)
    moves = [np.abs(after.off - before.off).max() for before, after in pairwise(scores)]
    found = [by_the_rule(cold(_SPEC, s.mask), s, _SPEC) for s in (sheets if motion == "a full turn" else ())]
    wrong = sum(score.slip > SLIP or not right for right, score in found)
    distance = mean(each.mean for each in scores)
    return Row(tally(scores), motion=motion, not_ok=not_ok, move=float(max(moves)), distance=distance, cold_wrong=wrong)


def seen_points(scenes: Iterable[FlatScene], view: View, with_depth: bool) -> Iterator[Row]:
    """Track a cloth with equal gaps in space where there is depth; yield the rows of ``claimed``."""
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
        errors = np.linalg.norm(away, axis=-1).ravel()
        yield claimed(shape, off, errors, true[..., 5].ravel() > 0.5, scene.shown, name)


def cloths_from_above(effort: Effort) -> Iterator[tuple[str, str, FlatScene]]:
    """Draw crumpled and gently waved cloths from straight above, orthographic and from 0.7 m, there with noise too."""
    views = {"from 0.7 m": View(), "orthographic": View(wall=False, focal=6400.0)}
    for seed in effort.seeds(100):
        rng = np.random.default_rng(seed)
        cloths = {"crumpled": crumpled(rng, get_args(Handling)[seed % 4]), "waved": waved(rng, rng.uniform(0.0, 0.6))}
        degrees = rng.uniform(0, 360)
        for (kind, vertices), (name, view) in product(cloths.items(), views.items()):
            yield kind, name, from_above(vertices, view, degrees)
        noisy = noisy_depth(iter([from_above(each, View(), degrees) for each in cloths.values()]), View(), seed)
        yield from ((kind, "from 0.7 m, noisy", scene) for kind, scene in zip(cloths, noisy, strict=True))


def judge_laid(scene: tuple[str, str, FlatScene]) -> Iterator[Row]:
    """Detect a cloth cold; compare all of its points with the material, numbered as fits best, in cells."""
    kind, view, seen = scene
    for rows, cols in ((4, 8), (8, 8)):
        camera = View(focal=6400.0 if view == "orthographic" else 386.0).intrinsics
        detector = ShapeDetector(Surface(rows=rows, cols=cols), on_invalid="interpolate")
        shape, row = detector.detect_mask(seen.mask, seen.depth, camera).shapes[0], {"kind": kind, "view": view}
        if shape.reason:
            yield Row(**row, ok=False, off=float("nan"), valid_off=0.0, valid=float("nan"))
            continue
        turned = [np.rot90(side, k) for side in (seen.space, seen.space[::-1]) for k in range(4)]
        found = np.asarray(shape.points3d, np.float64).reshape(rows, cols, 3)
        off = [np.linalg.norm(found - true_lattice(true, rows, cols, "centers"), axis=-1) for true in turned]
        cells = min(off, key=np.mean).ravel() / (SIDE / cols)
        most = float(cells[shape.valid].max(initial=0.0))
        yield Row(**row, ok=True, off=float(cells.mean()), valid_off=most, valid=float(shape.valid.mean()))


def _beyond(field: str, most: float) -> Column:
    return lambda rows: 100 * sum(row[field] > most for row in rows) / max(sum(row["ok"] for row in rows), 1)


_UNFOLDED: Final = {"motion": tuple(f"{name}{end}" for name in ("tilted", "corner up") for end in ("", ", no wall"))}
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
    Claim(
        "sheets.moving", "Cloths that turn once around, tracked and cold, and that wander, turn and bend, tracked.",
        motions, follow, ("motion",),
        {"cloths": len, "frames": total("frames"), "slips": total("slips"), "refused": total("not_ok"),
         "worst place [cells]": of(worst, "worst_slip"), "worst move [cells]": of(worst, "move"),
         "to the material [px]": of(mean, "distance"), "cold: corner or point wrong": total("cold_wrong")},
        limits=(
            Limit("slips", at_most=0), Limit("refused", at_most=0), Limit("worst place [cells]", at_most=0.3),
            Limit("cold: corner or point wrong", at_most=0),
        ),
    ),
    *(
        Claim(f"sheets.hands.{name}", f"Cloths over a corner or a side of which a hand comes, stays and goes: {name}.",
              hands(_CLOTH, seen_points, get_args(Hand), depth), hidden_row, ("rows", "motion"), VISIBLE,
              limits=HAND_LIMITS)
        for name, depth in (("mask", False), ("depth", True))
    ),
    *(
        Claim(f"sheets.space.{name}", f"Cloths that are tilted, bent up at a corner, or folded: depth {name}.",
              swings(_CLOTH, seen_points, get_args(Motion), noise, (*VIEWS, View(wall=False))), hidden_row,
              ("rows", "motion"), VISIBLE,
              limits=(*(replace(each, where=_UNFOLDED) for each in VISIBLE_LIMITS), Limit("slips [%]", at_most=4)))
        for name, noise in (("exact", False), ("noisy", True))
    ),
    Claim(
        "sheets.crumpled", "Square cloths from above, crumpled (dropped, dragged, folded) and gently waved, cold.",
        cloths_from_above, judge_laid, ("kind", "view"),
        {"detections": len, "ok [%]": percent("ok"), "of these off by half a cell [%]": _beyond("off", 0.5),
         "a valid point off by a cell [%]": _beyond("valid_off", 1.0), "worst [cells]": of(worst, "off"),
         "valid": of(mean, "valid")},
        limits=(
            Limit("ok [%]", at_least=98, unit="%", where={"kind": "waved"}),
            Limit("of these off by half a cell [%]", at_most=5, unit="%"),
            Limit("a valid point off by a cell [%]", at_most=0, unit="%"),
        ),
    ),
)  # fmt: skip
