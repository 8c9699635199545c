"""Scenes of several ropes, at rest and moving, are what they say, and their judge notices every kind of fault."""

from itertools import pairwise

import numpy as np
import pytest

from tests.benchmarks.rope_scores import judge, seen_axis
from tests.benchmarks.scenes.moving_ropes import MOTIONS, moving_ropes
from tests.benchmarks.scenes.several_ropes import noisy_depth, several_ropes
from tests.scenes.layouts import intersections


@pytest.mark.parametrize(("count", "crossings", "leaving"), [(2, 0, 0.0), (3, 5, 0.0), (5, 6, 1.0)])
def test_a_scene_has_the_wanted_ropes_and_crossings_and_depth_shows_the_upper_strand(count, crossings, leaving):
    scene = several_ropes(np.random.default_rng(count), count, crossings, leaving=leaving)
    assert (len(scene.curves), len(scene.crossings)) == (count, crossings)
    inside = [((c >= 0) & (c <= np.array(scene.mask.shape[::-1]) - 1)).all(axis=1) for c in scene.curves]
    assert any(not each.all() for each in inside) == bool(leaving)
    pairs = [(one, other) for i, one in enumerate(scene.curves) for other in scene.curves[: i + 1]]
    assert sum(len(intersections(one, other)) for one, other in pairs) == crossings
    area = 0.0
    for curve, width, seen in zip(scene.curves, scene.widths, inside, strict=True):
        assert np.linalg.norm(np.diff(curve, axis=0), axis=1) == pytest.approx(1, abs=1e-6)
        column, row = np.round(curve[seen]).astype(int).T
        assert (scene.mask[row, column] > 0).mean() > 0.94
        area += seen.sum() * width
    assert (scene.mask > 0).sum() < 1.15 * area + 300
    depth = noisy_depth(scene, np.random.default_rng(0))
    for crossing in scene.crossings:
        for index, at in ((crossing.first, crossing.first_at), (crossing.second, crossing.second_at)):
            assert np.linalg.norm(scene.curves[index][round(at)] - crossing.place) < 1.5
        u, v = np.round(crossing.place).astype(int)
        thick = 0.6 / 386 * max(scene.widths)
        assert 0.6 - 2.3 * thick < np.median(depth[v - 1 : v + 2, u - 1 : u + 2]) < 0.6 - 1.1 * thick  # two ropes


def test_the_generator_reports_what_does_not_fit():
    with pytest.raises(RuntimeError, match="no 5 ropes with 12 crossings found that fit 60 x 40 pixels"):
        several_ropes(np.random.default_rng(0), 5, 12, (40, 60), width=14)


@pytest.mark.parametrize("kind", MOTIONS)
def test_moving_points_are_material_and_do_what_their_kind_says(kind):
    moments = list(moving_ropes(np.random.default_rng(5), kind=kind, fastest=15.0))
    shares = np.array([[visible.mean() for visible in moment.visible] for moment in moments])
    steps = [[np.linalg.norm(a - b, axis=1).max() for a, b in zip(one.curves, other.curves, strict=True)]
             for one, other in pairwise(moments)]  # fmt: skip
    assert 4 > np.max(steps) > 2 if "hand" in kind else 15 >= np.max(steps) > 8
    for moment in moments[::20]:
        assert not moment.mask[moment.hand].any()
        for curve, visible in zip(moment.curves, moment.visible, strict=True):
            column, row = np.round(curve[visible]).astype(int).T
            assert (moment.mask[row, column] == 0).sum() <= 2
    cross = [any(intersections(a, b) for a, b in pairwise((*m.curves, m.curves[0]))) for m in moments[::3]]
    assert "hand" in kind or any(cross) == (kind == "crossing")
    assert (shares.min() < 0.5) == (kind in ("slow hand", "fast hand", "leaving"))


def faults(scene, true):
    """Yield a name, found curves, and how many of them are wrong."""
    for k, width in enumerate(scene.widths):
        rest, one = true[:k] + true[k + 1 :], true[k]
        along = np.gradient(one, axis=0)
        yield "cut tip", [*rest, one[round(1.5 * width) :]], 1
        yield "half", [*rest, one[: len(one) // 2]], 1
        yield "beside", [*rest, one + 0.6 * width * np.stack([-along[:, 1], along[:, 0]], axis=1)], 1
        yield "twice", [*true, one], 1
        yield "no curve", [*rest, np.full((20, 2), np.nan)], 1
    for crossing in scene.crossings:
        i, j, place = crossing.first, crossing.second, crossing.place
        one, other = true[i], true[j]
        a, b = (int(np.argmin(np.linalg.norm(curve - place, axis=1))) for curve in (one, other))
        rest = [curve for k, curve in enumerate(true) if k not in (i, j)]
        if i != j:
            yield "swapped", [*rest, np.concatenate([one[:a], other[b:]]), np.concatenate([other[:b], one[a:]])], 2
        else:
            a, b = np.flatnonzero(np.linalg.norm(one - place, axis=1) < 1.0)[[0, -1]]
            yield "loop reversed", [*rest, np.concatenate([one[:a], one[a:b][::-1], one[b:]])], 1
            yield "loop left out", [*rest, np.concatenate([one[:a], one[b:]])], 1


def test_the_truth_is_right_in_either_direction_and_every_fault_is_noticed():
    seen, rng = set(), np.random.default_rng(0)
    for seed in range(6):
        scene = several_ropes(np.random.default_rng(seed), 3, 5)
        true = [seen_axis(curve, scene.mask.shape) for curve in scene.curves]
        noisy = [(c + rng.uniform(-0.15, 0.15, c.shape) * w)[::6] for c, w in zip(true, scene.widths, strict=True)]
        verdict = judge([curve[::-1] for curve in noisy][::-1], scene)
        assert (verdict.right, verdict.wrong, verdict.owner) == ((True,) * 3, 0, (2, 1, 0))
        for name, found, wrong in faults(scene, true):
            verdict = judge(found, scene)
            assert (verdict.wrong, sum(verdict.right)) == (wrong, len(found) - wrong), name
            seen.add(name)
    assert {"swapped", "loop reversed", "loop left out"} <= seen
