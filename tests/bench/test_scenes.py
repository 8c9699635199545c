"""The truth of drawn scenes is true, on the object and under a hand, and the judge of several ropes misses no fault."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import cv2
import numpy as np
import pytest

from shape_obs.bench.photos import BLUE, Scene, photographs
from shape_obs.bench.scenes import moving_blob, moving_rope, moving_sheet, truth_of
from tests.benchmarks.rope_scores import judge, seen_axis
from tests.benchmarks.scenes.several_ropes import several_ropes

FRAMES = 24


@pytest.fixture(params=["rope", "ring", "sheet"], scope="module")
def film(request: pytest.FixtureRequest) -> list[Scene]:
    rng = np.random.default_rng(5)
    make: dict[str, Any] = {
        "rope": lambda: moving_rope(rng, 6.0, FRAMES),
        "ring": lambda: moving_blob(rng, turn=0.03, speed=2.0, hole=True, frames=FRAMES),
        "sheet": lambda: moving_sheet(rng, 6.0, FRAMES),
    }
    drawn = list(make[request.param]())
    steps = [np.linalg.norm(truth_of(b) - truth_of(a), axis=1).max() for a, b in pairwise(drawn)]
    if request.param != "ring":
        np.testing.assert_allclose(steps, 6.0, atol=1e-6)  # the speed of the fastest point
    return [*photographs(np.random.default_rng(1), drawn, hand=True, tilt=0.3)]


def test_visible_points_are_in_the_mask_and_hidden_ones_are_not(film: list[Scene]):
    square = np.ones((7, 7), np.uint8)  # rounding to pixels, at the border of the object and of the hand
    for scene in film:
        column, row = np.rint(scene.pixels).astype(int).T
        assert cv2.dilate(scene.mask, square)[row, column][~scene.hidden].all()
        assert not cv2.erode(scene.mask, square)[row, column][scene.hidden].any()
        cut = cv2.inRange(cv2.cvtColor(scene.rgb, cv2.COLOR_RGB2HSV), np.array(BLUE.low), np.array(BLUE.high))
        assert np.count_nonzero(cut != scene.mask) < 0.002 * cut.size
    hidden = [scene.hidden.any() for scene in film]
    assert any(hidden)
    assert not any(hidden[:4] + hidden[-4:])


def test_the_measured_surface_is_that_of_the_points_in_space(film: list[Scene]):
    for scene in film[::5]:
        np.testing.assert_allclose(scene.camera.project(scene.points), scene.pixels, atol=1e-6)
        middle = scene.points.mean(axis=0)
        normal = np.linalg.svd(scene.points - middle, full_matrices=False)[2][2]
        assert np.abs((scene.points - middle) @ normal).max() < 1e-9
        row, column = np.nonzero((scene.mask > 0) & (scene.depth > 0))
        depth = scene.depth[row, column]
        measured = scene.camera.deproject(np.stack([column, row], axis=1), depth * 1e-3)
        off = (measured - middle) @ normal
        sigma = 0.7**2 * 0.08 / (386 * 0.095)  # of a D455
        assert abs(off.mean()) < 0.2 * sigma
        assert off.std() == pytest.approx(sigma, rel=0.2)


def faults(scene, true):
    """Yield a name, found curves, and how many of them are wrong."""
    for k, width in enumerate(scene.widths):
        rest, one = true[:k] + true[k + 1 :], true[k]
        along = np.gradient(one, axis=0)
        yield "cut tip", [*rest, one[round(1.5 * width) :]], 1
        yield "half", [*rest, one[: len(one) // 2]], 1
        yield "next to the rope", [*rest, one + 0.6 * width * np.stack([-along[:, 1], along[:, 0]], axis=1)], 1
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
