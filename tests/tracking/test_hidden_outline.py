"""An outline over which something comes that only the mask shows: seen by its turns, put back, and let go again."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from shape_obs import Contour, Intrinsics, ShapeDetector
from shape_obs.bench.scenes import moving_blob
from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.polyline import nearest_on
from shape_obs.tracking.hidden_outline import complete_outline, hidden_pieces, laid_along, nearest_places
from tests.benchmarks.outlines import MOTIONS, seen_outline
from tests.benchmarks.scenes.flat_objects import View, ring, under_hand
from tests.benchmarks.scores import tally_visible

VIEW, SMALL = View(), View(height=120)


def wavy(count: int, radius: float = 120.0) -> np.ndarray:
    around = 2 * np.pi * np.arange(count) / count
    away = radius * (1 + 0.1 * np.cos(2 * around) + 0.06 * np.sin(3 * around))
    return np.stack([300 + away * np.cos(around), 240 + away * np.sin(around)], axis=1)


def closed(points: np.ndarray) -> np.ndarray:
    return np.concatenate([points, points[:1]])


@pytest.mark.parametrize("hollow", [True, False])
@pytest.mark.parametrize(("seed", "speed", "moving"), [(0, 2.0, 4.0), (1, 1.0, 0.0), (1, 8.0, 4.0)])
def test_a_hand_that_only_the_mask_shows_moves_no_visible_point(hollow, seed, speed, moving):
    rng = np.random.default_rng((seed, round(10 * speed)))
    scenes = under_hand(rng, ring(rng, hollow), VIEW, "side", speed, moving, level=True)
    frames = list(seen_outline(scenes, VIEW, False))
    found = tally_visible(frames)
    assert found.slips <= 1, found
    assert (found.refused, found.renewed) == (0, 0)
    assert found.seen > 98
    assert found.hidden_valid < 15
    last = frames[-1]
    assert last.visible.all()
    assert last.off.max() < 0.1


def test_nor_in_a_small_image():
    rng = np.random.default_rng((0, 40))
    found = tally_visible(
        list(seen_outline(under_hand(rng, ring(rng, True), SMALL, "side", 4.0, level=True), SMALL, False))
    )
    assert found.slips <= 2, found
    assert found.refused == 0
    assert found.worst < 0.75


@pytest.mark.parametrize("motion", ["deforming", "40 px a frame", "nearly round"])
def test_an_outline_that_moves_and_changes_its_form_hides_nothing(motion):
    detector = ShapeDetector(Contour())
    for blob in moving_blob(np.random.default_rng(3), frames=60, **MOTIONS[motion]):
        assert detector.detect_mask(blob.mask).shapes[0].visible.all()


@pytest.mark.parametrize("depth", [4.0, 15.0, 60.0])
def test_what_lies_within_the_known_outline_between_two_turns_is_not_its_own(depth):
    known = wavy(80)
    middle = known[20] + (depth - 40.0) * np.array([0.0, -1.0])  # a disc of 40 pixels, from below
    hidden = np.linalg.norm(wavy(800) - middle, axis=1) < 40
    inner = middle + 40 * np.stack([np.cos(a := np.linspace(np.pi, 2 * np.pi, 400)), np.sin(a)], axis=1)
    polygon = wavy(800)
    keep = inner[_inside(polygon, inner)]
    first = int(np.flatnonzero(hidden)[0])
    line = np.concatenate([polygon[:first], keep, polygon[np.flatnonzero(hidden)[-1] + 1 :]])
    curve = FittedCurve.through(np.ascontiguousarray(line), np.zeros(len(line), bool), True)
    curve = FittedCurve.through(curve.even(320), np.zeros(320, bool), True)
    cut, laid = hidden_pieces(curve.points, curve.arc, curve.even(80), known, known + [1.5, -1.0])
    assert nearest_on(closed(polygon), laid)[1].max() < 0.6
    true = nearest_on(closed(polygon), curve.points)[1] > 3
    assert cut[true].mean() > 0.8
    assert cut.sum() <= true.sum() + 50


def even(shape: np.ndarray, count: int) -> np.ndarray:
    return FittedCurve.through(shape, np.zeros(len(shape), bool), True).even(count)


@pytest.mark.parametrize("share", [0.2, 0.35, 0.5, 0.57])
def test_a_hidden_piece_is_put_back_where_it_is(share):
    """The known outline lies elsewhere, turned, and is expected 2 px from its place; a hand has a straight edge, whose
    round corners draw the outline in by up to 3 px over three points next to it."""
    true, base, last = even(wavy(320), 320), even(wavy(800), 80), 60 + int(320 * share)
    seen, cut = true.copy(), (np.arange(320) >= 60) & (np.arange(320) <= last)
    seen[60 : last + 1] = np.linspace(true[60], true[last], last - 59)
    for step, inwards in enumerate((3.0, 2.0, 1.0), 1):
        for at in (60 - step, last + step):
            seen[at] += inwards * (c := [300, 240] - seen[at]) / np.linalg.norm(c)
    curve = FittedCurve.through(seen, np.zeros(320, bool), True)
    known = (base - [300, 240]) @ [[np.cos(0.2), np.sin(0.2)], [-np.sin(0.2), np.cos(0.2)]] + [310, 230]
    found = complete_outline(curve, curve, cut, known, base + [1.5, -1.0])
    assert found is not None
    assert nearest_on(closed(true), found[0].points)[1].max() < 0.5
    assert np.linalg.norm(found[0].at([found[1]])[0] - base[0]) < 1


def test_a_narrow_mark_shows_how_a_round_outline_that_is_hidden_in_part_has_turned():
    """It is expected 24 px off, along the outline; the mark leaves less than a tenth of that."""
    around = 2 * np.pi * np.arange(800) / 800
    away = 120 * (1 + 0.3 * np.exp(-(((around - 4.4) / 0.1) ** 2)))
    disc = np.stack([300 + away * np.cos(around), 240 + away * np.sin(around)], axis=1)
    true, base = even(disc, 320), even(disc, 80)
    seen, cut = true.copy(), (np.arange(320) >= 20) & (np.arange(320) <= 100)
    seen[20:101] = np.linspace(true[20], true[100], 81)
    curve = FittedCurve.through(seen, np.zeros(320, bool), True)
    turned = (base - [300, 240]) @ [[np.cos(0.2), np.sin(0.2)], [-np.sin(0.2), np.cos(0.2)]] + [300, 240]
    found = complete_outline(curve, curve, cut, base, turned)
    assert found is not None
    assert np.linalg.norm(found[0].at([found[1]])[0] - base[0]) < 2.4


def test_an_outline_of_which_a_third_is_in_sight_is_not_put_back():
    true, base = even(wavy(320), 320), even(wavy(800), 80)
    curve = FittedCurve.through(true, np.zeros(320, bool), True)
    assert complete_outline(curve, curve, np.arange(320) < 213, base, base) is None


def _inside(polygon: np.ndarray, points: np.ndarray) -> np.ndarray:
    return nearest_places(closed(polygon), np.ascontiguousarray(points))[2]


def test_a_dent_without_turns_is_a_change_of_form():
    known, around = wavy(80), 2 * np.pi * np.arange(320) / 320
    dent = 12 * np.exp(-(((around - np.pi / 2) / 0.5) ** 2))[:, None]
    points = wavy(320) - dent * np.stack([np.cos(around), np.sin(around)], axis=1)
    curve = FittedCurve.through(points, np.zeros(320, bool), True)
    assert not hidden_pieces(curve.points, curve.arc, curve.even(80), known, known)[0].any()


def test_the_nearest_places_are_the_nearest():
    line, points = closed(wavy(70)), np.random.default_rng(0).uniform(100, 500, (200, 2))
    place, far, inside = nearest_places(line, points)
    np.testing.assert_allclose(far, nearest_on(line, points)[1], atol=1e-9)
    at = place.astype(int)
    foot = line[at] + (place - at)[:, None] * (line[at + 1] - line[at])
    np.testing.assert_allclose(np.linalg.norm(points - foot, axis=1), far, atol=1e-5)
    radius = np.linalg.norm(points - [300, 240], axis=1)
    assert inside[radius < 100].all()
    assert not inside[radius > 145].any()


def test_an_outline_is_laid_along_what_is_seen_of_it():
    rng, points = np.random.default_rng(1), wavy(80)
    seen = wavy(300)
    seen[60:120] += 0.4 * ([300.0, 240.0] - seen[60:120])  # a fifth of it lies elsewhere
    moved = 1.02 * (points - [300, 240]) + [304, 237] + rng.normal(0, 0.1, points.shape)
    laid = laid_along(closed(seen), moved)
    assert nearest_on(closed(wavy(300)), laid)[1].max() < 1
    assert np.linalg.norm(laid - points, axis=1).max() < 3


def test_an_outline_is_laid_along_the_rest_while_a_hand_comes_over_it():
    """A fifth lies 8 px inside, so that a quarter of that is left at most; it was expected 5 px from its place."""
    seen = wavy(300)
    inwards = [300.0, 240.0] - seen[60:120]
    seen[60:120] += 8 * inwards / np.linalg.norm(inwards, axis=1, keepdims=True)
    laid = laid_along(closed(seen), 1.02 * (wavy(80) - [300, 240]) + [304, 237])
    assert nearest_on(closed(wavy(300)), laid)[1].max() < 2


def test_what_only_touches_an_outline_hides_nothing():
    camera = Intrinsics(160, 120, 110.0, 110.0, 80.0, 60.0)
    free, touched = (ShapeDetector(Contour(spacing="m")) for _ in range(2))
    around = 2 * np.pi * np.arange(400) / 400
    away = 25 * (1 + 0.12 * np.cos(3 * around + 0.4) + 0.06 * np.cos(2 * around + 1))
    for frame in range(70):
        wide = 0.1 * np.sin(np.pi * frame / 70) ** 2  # it changes its form
        points = np.stack([away * np.cos(around) * (1 + wide), away * np.sin(around) * (1 - wide)], axis=1) + [82, 62]
        mask = cv2.fillPoly(np.zeros((120, 160), np.uint8), [np.rint(16 * points).astype(int)], 255, shift=4)
        depth = np.where(mask > 0, np.uint16(600), np.uint16(650))
        expected = free.detect_mask(mask, depth, camera).shapes[0]
        top, (v, u) = points[np.argmin(points[:, 1])], np.mgrid[:120, :160]
        if frame >= 20:
            depth[(abs(u - top[0]) < 5) & (v < top[1] + 6) & (mask == 0)] = 500
        found = touched.detect_mask(mask, depth, camera).shapes[0]
        assert found.visible.all()
        gap = np.linalg.norm(np.diff(expected.pixels, axis=0), axis=1).mean()
        assert np.linalg.norm(found.pixels - expected.pixels, axis=1).max() < 0.2 * gap
