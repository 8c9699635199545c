"""Ropes that cross themselves, are cut by an occluder, or run side by side, found without a previous frame."""

from __future__ import annotations

import time

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from shape_obs.coldstart.bridge import bridge
from shape_obs.coldstart.fold import fold
from shape_obs.coldstart.skeleton import skeleton_graph
from shape_obs.coldstart.trace import Trace, trace
from shape_obs.evaluation.ropes import draw_rope, random_rope, resample
from shape_obs.evaluation.tangles import (
    Tangle,
    crossing_rope,
    cut_rope,
    is_traversed,
    touching_rope,
)
from shape_obs.region import Region, find_region
from shape_obs.roi import Window


def region_of(mask: npt.NDArray[np.uint8]) -> Region:
    return find_region(mask, Window(0, 0, mask.shape[1], mask.shape[0]), min_area=20, min_share=0.05)


def traced(tangles: list[Tangle]) -> list[tuple[Tangle, Trace, bool]]:
    found = [(tangle, trace(region_of(tangle.mask))) for tangle in tangles]
    return [(tangle, result, is_traversed(result.curve, tangle)) for tangle, result in found]


def strip(*points: tuple[float, float], width: float = 10.0) -> npt.NDArray[np.uint8]:
    return draw_rope(resample(np.array(points, dtype=np.float64), 1.0), width).mask


@pytest.fixture(scope="module")
def crossing() -> list[tuple[Tangle, Trace, bool]]:
    rng = np.random.default_rng(11)
    return traced([crossing_rope(rng, 1 + i % 3) for i in range(30)])


def test_a_rope_that_crosses_itself_is_followed(crossing):
    assert np.mean([right for _, _, right in crossing]) >= 0.95
    assert np.mean([bool(result.doubt) for _, result, _ in crossing]) <= 0.05


def test_a_traced_curve_keeps_to_the_middle_of_its_strand_at_even_steps(crossing):
    for tangle, result, right in crossing:
        if right:
            distance = np.linalg.norm(result.curve[:, None] - tangle.curve[None], axis=2).min(axis=1)
            step = np.linalg.norm(np.diff(result.curve, axis=0), axis=1)
            assert np.percentile(distance[2:-2], 90) <= 0.25 * tangle.width
            assert step.max() <= 1.5 * step.mean()
            assert 96 <= len(result.curve) <= 256


@pytest.mark.parametrize("band", [16, 50])
@pytest.mark.parametrize("crossings", [0, 1])
def test_a_rope_cut_by_an_occluder_is_joined_and_its_gaps_are_told(band, crossings):
    rng = np.random.default_rng(12 + crossings)
    found = traced([cut_rope(rng, crossings, band) for _ in range(20)])
    assert sum(right or bool(result.doubt) for _, result, right in found) >= 19
    assert sum(right for _, _, right in found) >= 18
    for tangle, result, right in found:
        if right:
            assert result.bridged.any()
            hidden = tangle.mask[tuple(np.rint(result.curve[result.bridged]).astype(int).T[::-1])] == 0
            assert hidden.all()
            assert result.bridged.mean() < 2.5 * tangle.hidden.mean() + 0.03


def test_strands_side_by_side_are_told_apart_or_doubted():
    rng = np.random.default_rng(13)
    found = traced([touching_rope(rng) for _ in range(25)])
    assert all(right or result.doubt for _, result, right in found)
    assert np.mean([right for _, _, right in found]) >= 0.9


def test_a_simple_ribbon_is_folded():
    rng = np.random.default_rng(14)
    for kind in ("smooth", "hairpin", "loop", "spiral"):
        region = region_of(random_rope(rng, kind).mask)
        result = trace(region)
        assert np.array_equal(result.curve, fold(region.components[0].outline, region.components[0].width))
        assert not result.bridged.any()
        assert result.doubt == ""


def test_a_mask_that_branches_is_doubted():
    fork = strip((100, 100), (300, 200)) | strip((300, 200), (500, 100)) | strip((300, 200), (300, 400))
    assert "branches" in trace(region_of(fork)).doubt


def test_a_small_knob_is_left_out():
    rope = strip((100, 200), (500, 200)) | strip((300, 200), (300, 222), width=6)
    result = trace(region_of(rope))
    assert result.doubt == ""
    assert np.abs(result.curve[2:-2, 1] - 200).max() < 3


def test_a_closed_ring_is_doubted():
    ring = np.zeros((300, 300), np.uint8)
    cv2.circle(ring, (150, 150), 90, 255, 10)
    assert "ring" in trace(region_of(ring)).doubt


@pytest.mark.parametrize("seed", range(4))
def test_noise_does_no_harm(seed):
    rng = np.random.default_rng(seed)
    mask = np.where(rng.random((120, 160)) < 0.3 + 0.15 * seed, np.uint8(255), np.uint8(0))
    result = trace(region_of(mask))
    assert np.isfinite(result.curve).all()
    assert len(result.curve) == len(result.bridged)


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


def test_the_judge_tells_wrong_ways():
    tangle = crossing_rope(np.random.default_rng(15), 1)
    even = resample(tangle.curve, 4.0)
    first, second = sorted(np.argsort(np.linalg.norm(even - tangle.crossings[0], axis=1))[[0, 1, 2, 3]])[::3]
    assert is_traversed(even, tangle)
    assert is_traversed(even[::-1], tangle)
    assert second - first > 3
    assert not is_traversed(np.concatenate([even[:first], even[second:]]), tangle)  # the loop left out
    assert not is_traversed(np.concatenate([even[:first], even[first:second][::-1], even[second:]]), tangle)
