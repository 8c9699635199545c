"""Scenes of several ropes are what they say, and their judge notices every kind of fault."""

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from tests.benchmarks.rope_scores import judge, seen_axis, steps_off
from tests.benchmarks.scenes.layouts import intersections
from tests.benchmarks.scenes.several_ropes import lift, noisy_depth, relief, several_ropes

SIZES = ((480, 640), (672, 896))
KINDS = [(2, 0, 0), (2, 2, 1), (2, 5, 0), (3, 1, 1), (3, 5, 0), (5, 0, 1), (5, 3, 0), (5, 6, 1)]


@pytest.fixture(scope="module", params=KINDS, ids=str)
def drawn(request):
    count, crossings, seed = request.param
    rng = np.random.default_rng([count, crossings, seed])
    return count, crossings, several_ropes(rng, count, crossings, SIZES[seed])


@pytest.fixture(scope="module")
def scenes():
    return [several_ropes(np.random.default_rng(seed), 3, 5) for seed in range(6)]


@pytest.fixture(scope="module")
def axes(scenes):
    return [[seen_axis(curve, scene.mask.shape) for curve in scene.curves] for scene in scenes]


def inside(points, size):
    return ((points >= 0) & (points <= np.array(size[::-1]) - 1)).all(axis=1)


def test_a_scene_has_the_wanted_ropes_and_crossings(drawn):
    count, crossings, scene = drawn
    assert len(scene.curves) == len(scene.widths) == count
    assert len(scene.crossings) == crossings
    assert scene.rgb.shape == (*scene.mask.shape, 3)
    assert set(np.unique(scene.mask)) <= {0, 255}
    for curve, width in zip(scene.curves, scene.widths, strict=True):
        steps = np.linalg.norm(np.diff(curve, axis=0), axis=1)
        assert abs(steps - 1).max() < 0.2
        assert 200 < steps.sum() < 920
        assert 3.7 < width < 14.8


def test_crossings_are_listed_where_curves_intersect(drawn):
    _, _, scene = drawn
    size, found = scene.mask.shape, 0
    for i, one in enumerate(scene.curves):
        for other in scene.curves[: i + 1]:
            places = np.array([place for *_, place, _ in intersections(one, other)]).reshape(-1, 2)
            found += int(inside(places, size).sum())
    assert found == len(scene.crossings)
    for crossing in scene.crossings:
        assert crossing.angle >= np.deg2rad(15)
        for index, at in ((crossing.first, crossing.first_at), (crossing.second, crossing.second_at)):
            curve = scene.curves[index]
            arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
            place = [np.interp(at, arc, curve[:, d]) for d in range(2)]
            assert np.linalg.norm(place - crossing.place) < 0.5


def test_the_mask_covers_the_axes_and_little_else(drawn):
    _, _, scene = drawn
    area = 0.0
    for curve, width in zip(scene.curves, scene.widths, strict=True):
        at = np.round(curve[inside(curve, scene.mask.shape)]).astype(int)
        assert (scene.mask[at[:, 1], at[:, 0]] > 0).mean() > 0.94
        area += len(at) * width
    assert (scene.mask > 0).sum() < 1.15 * area + 300


def test_the_upper_strand_is_drawn_on_top():
    for seed in range(4):
        scene = several_ropes(np.random.default_rng(seed), 3, 6)
        lifts = []
        for index, (curve, width) in enumerate(zip(scene.curves, scene.widths, strict=True)):
            at = [(c.first_at, c.first_above) for c in scene.crossings if c.first == index]
            at += [(c.second_at, not c.first_above) for c in scene.crossings if c.second == index]
            lifts.append(lift(len(curve), at, width))
        top = relief(scene.curves, scene.widths, lifts, scene.mask.shape, np.array([0.0, 0.0, 1.0]))
        for crossing in scene.crossings:
            u, v = np.round((crossing.place + 0.5) * 2).astype(int)
            upper = crossing.first if crossing.first_above else crossing.second
            reach = max(round(0.5 * scene.widths[upper]), 1)
            assert (top.owner[v - reach : v + reach + 1, u - reach : u + reach + 1] == upper).mean() > 0.95


def test_depth_shows_which_strand_is_above(scenes):
    for scene in scenes:
        depth = noisy_depth(scene, np.random.default_rng(0))
        assert abs(np.median(depth) - 0.6) < 0.001
        for crossing in scene.crossings:
            u, v = np.round(crossing.place).astype(int)
            width = 0.6 / 386 * max(scene.widths[crossing.first], scene.widths[crossing.second])
            # Two ropes lie over each other there.
            assert 0.6 - 2.3 * width < np.median(depth[v - 1 : v + 2, u - 1 : u + 2]) < 0.6 - 1.1 * width


def test_ropes_leave_the_image_on_request():
    left = [several_ropes(np.random.default_rng(seed), 2, 1, leaving=1.0) for seed in range(4)]
    assert sum(not inside(curve, scene.mask.shape).all() for scene in left for curve in scene.curves) >= 3
    stays = [several_ropes(np.random.default_rng(seed), 2, 1, leaving=0.0) for seed in range(4)]
    assert all(inside(curve, scene.mask.shape).all() for scene in stays for curve in scene.curves)


def test_the_generator_reports_what_does_not_fit():
    with pytest.raises(RuntimeError, match="no 5 ropes with 12 crossings found that fit 120 x 80 pixels"):
        several_ropes(np.random.default_rng(0), 5, 12, (80, 120), width=14)


def test_the_truth_is_right_in_either_direction_and_order(scenes, axes):
    for scene, true in zip(scenes, axes, strict=True):
        verdict = judge([curve[::-1] for curve in true][::-1], scene)
        assert (verdict.right, verdict.wrong) == ((True,) * 3, 0)
        assert verdict.owner == (2, 1, 0)


def test_small_errors_are_right(scenes, axes):
    rng = np.random.default_rng(0)
    for scene, true in zip(scenes, axes, strict=True):
        noisy = []
        for curve, width in zip(true, scene.widths, strict=True):
            sparse = curve[np.linspace(0, len(curve) - 1, max(len(curve) // 6, 2)).astype(int)]
            noisy.append(sparse + rng.uniform(-0.2, 0.2, sparse.shape) * width)
        assert judge(noisy, scene).right == (True,) * 3


def faults(scene, true):
    """Yield a name, found curves, and how many of them are wrong."""
    others = list(true)
    for k, width in enumerate(scene.widths):
        rest = others[:k] + others[k + 1 :]
        yield "cut tip", [*rest, true[k][round(1.5 * width) :]], 1
        yield "cut tip", [*rest, true[k][: -round(1.5 * width)]], 1
        yield "half", [*rest, true[k][: len(true[k]) // 2]], 1
        along = np.gradient(true[k], axis=0)
        yield "beside", [*rest, true[k] + 0.6 * width * np.stack([-along[:, 1], along[:, 0]], axis=1)], 1
        yield "twice", [*others, true[k]], 1
        yield "no curve", [*rest, np.full((20, 2), np.nan)], 1
    yield "joined", [np.concatenate([true[0], true[1]]), true[2]], 1
    for crossing in scene.crossings:
        i, j = crossing.first, crossing.second
        one, other = true[i], true[j]
        a = int(np.argmin(np.linalg.norm(one - crossing.place, axis=1)))
        b = int(np.argmin(np.linalg.norm(other - crossing.place, axis=1)))
        rest = [curve for k, curve in enumerate(true) if k not in (i, j)]
        if i != j:
            yield "swapped", [*rest, np.concatenate([one[:a], other[b:]]), np.concatenate([other[:b], one[a:]])], 2
            yield "turned", [*rest, np.concatenate([one[:a], other[:b][::-1]]), np.concatenate([other[b:], one[a:]])], 2
        else:
            start = np.flatnonzero(np.linalg.norm(one - crossing.place, axis=1) < 1.0)
            a, b = start[0], start[-1]
            yield "loop reversed", [*rest, np.concatenate([one[:a], one[a:b][::-1], one[b:]])], 1
            yield "loop left out", [*rest, np.concatenate([one[:a], one[b:]])], 1


def test_every_fault_is_noticed(scenes, axes):
    seen = set()
    for scene, true in zip(scenes, axes, strict=True):
        for name, found, wrong in faults(scene, true):
            verdict = judge(found, scene)
            assert verdict.wrong == wrong, name
            assert sum(verdict.right) == len(found) - wrong, name
            seen.add(name)
    assert {"swapped", "loop reversed", "loop left out"} <= seen


@pytest.mark.parametrize("seed", range(10))
def test_steps_off_are_a_shortest_path(seed):
    rng = np.random.default_rng(seed)
    truth, found = (np.cumsum(rng.normal(0, 1, (count, 2)), axis=0) for count in rng.integers(5, 30, 2))
    far = np.linalg.norm(truth[:, None] - found[None], axis=2) > 2.0
    n, m = far.shape
    index = np.arange(n * m).reshape(n, m)
    steps = [(index[:-1], index[1:]), (index[:, :-1], index[:, 1:]), (index[:-1, :-1], index[1:, 1:])]
    start, end = (np.concatenate([pair[k].ravel() for pair in steps]) for k in range(2))
    # Costs are shifted by a small amount, since a sparse graph has no edges of length 0.
    cost = far.ravel()[end] + 1e-6
    graph = coo_array((cost, (start.astype(np.int32), end.astype(np.int32))), shape=(n * m, n * m)).tocsr()
    shortest = dijkstra(graph, indices=0)[n * m - 1] + far[0, 0]
    assert steps_off(truth, found, 2.0, 0) == round(shortest)
