"""Ropes that cross themselves, are cut by an occluder, or run side by side, found without a previous frame."""

from __future__ import annotations

import time

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial import KDTree

from shape_obs.bench.scenes import draw_rope, resample
from shape_obs.geometry.curve import FittedCurve
from shape_obs.image.find_region import find_region
from shape_obs.image.region import Region
from shape_obs.image.roi import Window
from shape_obs.initialization.folding import fold_outline
from shape_obs.initialization.gaps import bridge
from shape_obs.initialization.medial_axis import medial_axis
from shape_obs.initialization.skeleton import skeleton_graph
from tests.benchmarks.rope_scores import is_traversed
from tests.benchmarks.ropes import cold_path
from tests.benchmarks.scenes.ropes import random_rope
from tests.benchmarks.scenes.tangles import Tangle, crossing_rope, cut_rope


def region_of(mask: npt.NDArray[np.uint8]) -> Region:
    return find_region(mask, Window(0, 0, mask.shape[1], mask.shape[0]), min_area=20, min_share=0.05)


def traced(tangles: list[Tangle]) -> list[tuple[Tangle, FittedCurve, bool]]:
    found = [(tangle, medial_axis(region_of(tangle.mask))) for tangle in tangles]
    return [(tangle, result, is_traversed(result.points, tangle)) for tangle, result in found]


def strip(*points: tuple[float, float], width: float = 10.0) -> npt.NDArray[np.uint8]:
    return draw_rope(resample(np.array(points, dtype=np.float64), 1.0), width).mask


def test_all_points_of_a_rope_that_crosses_itself_are_visible():
    tangle = crossing_rope(np.random.default_rng(11), 2)
    shape = cold_path(tangle.mask)
    assert shape.ok, shape.reason
    assert is_traversed(shape.pixels, tangle)
    assert shape.visible.all()


def test_a_traced_curve_keeps_to_the_middle_of_its_strand_at_even_steps():
    rng = np.random.default_rng(11)
    for tangle, result, right in traced([crossing_rope(rng, 1 + i % 2) for i in range(20)]):
        if right:
            distance = np.linalg.norm(result.points[:, None] - tangle.curve[None], axis=2).min(axis=1)
            step = np.linalg.norm(np.diff(result.points, axis=0), axis=1)
            assert np.percentile(distance[2:-2], 90) <= 0.25 * tangle.width
            assert step.max() <= 1.5 * step.mean()
            assert 96 <= len(result.points) <= 256


@pytest.mark.parametrize("band", [16, 50])
def test_bridged_points_of_a_traced_curve_lie_off_the_mask_and_are_no_more_than_is_hidden(band):
    rng = np.random.default_rng(12)
    for tangle, result, right in traced([cut_rope(rng, i % 2, band) for i in range(20)]):
        if right:
            assert result.interpolated.any()
            assert not region_of(tangle.mask).contains(result.points[result.interpolated]).any()
            assert result.interpolated.mean() < 2.5 * tangle.hidden.mean() + 0.03


def test_a_simple_ribbon_is_folded():
    rng = np.random.default_rng(14)
    for kind in ("smooth", "hairpin", "loop", "spiral"):
        rope = random_rope(rng, kind)
        region = region_of(rope.mask)
        result = medial_axis(region)
        assert np.array_equal(result.points, fold_outline(region.components[0].outline, region.components[0].width))
        assert not result.interpolated.any()
        assert result.ambiguity == ""
        away = KDTree(resample(rope.curve, 0.5)).query(result.points)[0]
        assert np.median(away) < 1


def test_a_mask_that_branches_is_refused():
    fork = strip((100, 100), (300, 200)) | strip((300, 200), (500, 100)) | strip((300, 200), (300, 400))
    shape = cold_path(fork)
    assert not shape.ok
    assert "branches" in shape.reason


def test_a_small_knob_is_left_out():
    rope = strip((100, 200), (500, 200)) | strip((300, 200), (300, 222), width=6)
    shape = cold_path(rope)
    assert shape.ok
    off = np.abs(shape.pixels[:, 1] - 200)
    assert np.mean(off < 1) > 0.9
    assert off.max() < 10


def test_a_closed_ring_is_refused():
    ring = np.zeros((300, 300), np.uint8)
    cv2.circle(ring, (150, 150), 90, (255,), 10)
    shape = cold_path(ring)
    assert not shape.ok
    assert "ring" in shape.reason


@pytest.mark.parametrize("seed", range(4))
def test_noise_does_no_harm(seed):
    rng = np.random.default_rng(seed)
    mask = np.where(rng.random((80, 100)) < 0.3 + 0.15 * seed, np.uint8(255), np.uint8(0))
    result = medial_axis(region_of(mask))
    assert np.isfinite(result.points).all()
    assert len(result.points) == len(result.interpolated)


@pytest.mark.parametrize("thickness", [4, 12, 60])
def test_two_crossing_strips_are_a_skeleton_with_four_free_ends(thickness):
    strips = strip((100, 100), (500, 400), width=thickness), strip((100, 400), (500, 100), width=thickness)
    cross = np.maximum(*strips)
    skeleton = skeleton_graph(cross)
    nodes = [node for branch in skeleton.branches for node in branch.nodes]
    assert sum(nodes.count(node) == 1 for node in set(nodes)) == 4
    assert skeleton.width == pytest.approx(thickness, rel=0.12)


def test_the_skeleton_lies_where_the_window_is():
    mask = strip((100, 100), (500, 400))
    whole = skeleton_graph(mask).branches[0].points
    part = skeleton_graph(np.ascontiguousarray(mask[50:, 60:]), (60, 50)).branches[0].points
    assert np.array_equal(whole, part)


def test_pieces_are_joined_in_the_best_order_overall():
    # The nearest ends of all are those of the outer pieces, which a greedy join would begin with.
    x = np.linspace(0, 1, 50)[:, None]
    pieces = [np.array([[a, y]]) + x * (b - a, 0.0) for a, b, y in ((0, 100, 0.0), (240, 130, 0.0), (270, 400, 0.0))]
    joined = bridge([pieces[2], pieces[0], pieces[1]], 10.0)
    along = joined.curve[:, 0] if joined.curve[0, 0] < joined.curve[-1, 0] else joined.curve[::-1, 0]
    assert np.all(np.diff(along) > 0)
    assert np.abs(joined.curve[:, 1]).max() < 1e-6
    assert 0 < joined.bridged.mean() < 0.5


def test_sixteen_pieces_are_joined_quickly():
    x = np.linspace(0, 20, 40)[:, None]
    pieces = [np.array([[40.0 * i, 0.0]]) + x * (1.0, 0.0) for i in np.random.default_rng(0).permutation(16)]
    start = time.perf_counter()
    joined = bridge(pieces, 5.0)
    assert time.perf_counter() - start < 0.5
    assert np.all(np.diff(joined.curve[:, 0]) * np.sign(joined.curve[-1, 0] - joined.curve[0, 0]) > 0)


def test_the_score_notices_wrong_ways():
    tangle = crossing_rope(np.random.default_rng(15), 1)
    even = resample(tangle.curve, 4.0)
    first, second = sorted(np.argsort(np.linalg.norm(even - tangle.crossings[0], axis=1))[[0, 1, 2, 3]])[::3]
    assert is_traversed(even, tangle)
    assert is_traversed(even[::-1], tangle)
    assert second - first > 3
    assert not is_traversed(np.concatenate([even[:first], even[second:]]), tangle)  # the loop left out
    assert not is_traversed(np.concatenate([even[:first], even[first:second][::-1], even[second:]]), tangle)
