"""Masks that are no object are refused with a reason, and what bounds the time is counted, not timed."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from shape_obs import Centerline, Contour, ShapeDetector, Surface
from shape_obs.image.find_region import find_region
from shape_obs.image.roi import Window
from shape_obs.initialization.gaps import cheapest_order
from shape_obs.initialization.junctions import find_zones
from shape_obs.initialization.skeleton import Branch, Skeleton
from tests.benchmarks.scenes.blobs import random_blob
from tests.benchmarks.scenes.images import salted
from tests.benchmarks.scenes.ropes import random_rope
from tests.benchmarks.scenes.sheets import random_sheet
from tests.benchmarks.tables import Row
from tests.benchmarks.worst_case_claims import PATTERNS, SIZES, slowest, targets, worst_cases

SIZE = (640, 480)


def drawn(pattern):
    return PATTERNS[pattern](np.random.default_rng(0), SIZE)


def region_of(mask):
    return find_region(mask, Window(0, 0, mask.shape[1], mask.shape[0]), 20, 0.05)


@pytest.mark.parametrize("spec", [Centerline(), Contour(), Surface()])
@pytest.mark.parametrize(
    "pattern", ["checkerboard 1", "noise 50%, grain 1", "comb 1/1", "grid 1/1", "winding line 1/1", "rings 1/1"]
)
def test_noise_and_fine_patterns_are_refused_with_a_reason(pattern, spec):
    shape = ShapeDetector([spec]).detect_mask(drawn(pattern)).shapes[0]
    assert not shape.ok
    assert "runs of pixels, at most 19200" in shape.reason


@pytest.mark.parametrize("pattern", PATTERNS)
def test_what_is_measured_has_a_bounded_number_of_runs_and_border_pixels(pattern):
    mask = drawn(pattern)
    region = region_of(mask)
    if region.refusal:
        assert not region.mask.any()
        assert region.pieces == 0
    else:
        assert len(region.runs) <= mask.size / 16
        # Each border pixel begins or ends a run along a row or a column, and is passed four times at most.
        traced = len(region.traced.outlines) + region.traced.holes[:, 3].sum()
        assert traced <= 4 * 4 * mask.size / 16


def test_a_refused_mask_counts_the_same_when_it_is_transposed():
    mask = drawn("comb 3/1")
    reasons = {ShapeDetector([Contour()]).detect_mask(each).shapes[0].reason for each in (mask, mask.T)}
    assert len(reasons) == 1


@pytest.mark.parametrize("pattern", ["noise 65%, grain 8", "grid 8/60", "maze 4"])
def test_a_rope_with_more_holes_or_branches_than_any_rope_is_refused_before_it_is_strung_together(pattern, monkeypatch):
    monkeypatch.setattr("shape_obs.initialization.medial_axis.untangle", None)
    shape = ShapeDetector([Centerline()]).detect_mask(drawn(pattern)).shapes[0]
    assert not shape.ok
    assert "it is no rope" in shape.reason


@pytest.mark.parametrize("share", [0.01, 0.05])
def test_objects_in_salt_and_pepper_are_measured(share):
    rng = np.random.default_rng(1)
    for mask in (random_rope(rng).mask, random_blob(rng).mask, random_sheet(rng, 1.5, 20.0).mask):
        region = region_of(salted(rng, mask, share))
        assert not region.refusal
        assert region.areas[0] > 0.8 * np.count_nonzero(mask)


def test_a_plate_with_a_twentieth_of_its_pixels_missing_keeps_its_outline():
    mask = np.zeros((480, 640), np.uint8)
    mask[60:420, 80:560] = 255
    holes = np.where(np.random.default_rng(2).random(mask.shape) < 0.05, 0, mask).astype(np.uint8)
    shape = ShapeDetector([Contour()]).detect_mask(holes).shapes[0]
    assert shape.ok, shape.reason
    assert np.abs(shape.pixels.min(axis=0) - (80, 60)).max() < 3


def test_a_crowd_of_shared_branches_is_matched_in_part_and_said_to_be_one():
    ends = np.random.default_rng(0).permutation(np.repeat(np.arange(40), 3)).reshape(-1, 2)
    line, radius = np.array([[0.0, 0.0], [10.0, 0.0]]), np.full(2, 6.0)
    branches = tuple(Branch(line, radius, (int(a), int(b))) for a, b in ends)
    assert "too close together" in find_zones(Skeleton(branches, 10.0)).doubt
    assert not find_zones(Skeleton(branches[:12], 10.0)).doubt


def test_the_cheapest_order_is_that_of_all_orders():
    from itertools import pairwise, permutations, product

    rng = np.random.default_rng(0)
    for _ in range(5):
        price = rng.random((8, 8))
        price += price.T
        price[[0, 1, 2, 3, 4, 5, 6, 7], [1, 0, 3, 2, 5, 4, 7, 6]] = np.inf
        np.fill_diagonal(price, np.inf)
        every = [
            sum(price[2 * a + 1 - e, 2 * b + f] for (a, e), (b, f) in pairwise(way))
            for order in permutations(range(4))
            for turned in product((0, 1), repeat=4)
            for way in [list(zip(order, turned, strict=True))]
        ]
        total, ends = cheapest_order(price)
        assert total == pytest.approx(min(every))
        assert sorted(ends.tolist()) == list(range(8))
        assert total == pytest.approx(sum(price[a, b] for a, b in zip(ends[1:-1:2], ends[2::2], strict=True)))


def test_the_benchmark_measures_every_shape_and_input():
    rows = list(worst_cases((160, 120), 0, ("mask", "cloud"), patterns=("full", "checkerboard 8")))
    assert len(rows) == 2 * 2 * 3
    assert {row.pattern for row in rows} == {"full", "checkerboard 8"}
    assert len(slowest(rows, ("shape", "given"), ("ms", "passes"))) == 6
    rows = [Row(row, size=f"{width}x{height}", ms=30.0) for row in rows for width, height in SIZES]
    assert [row.reached for row in targets(rows, [])] == ["no", "yes"]


def test_a_line_through_the_image_is_no_fine_pattern():
    mask = np.zeros((480, 640), np.uint8)
    for v in range(20, 460, 24):
        cv2.line(mask, (20, v), (620, v + 12), (255,), 6)
    assert not region_of(mask).refusal
