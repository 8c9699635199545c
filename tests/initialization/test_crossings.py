"""Ropes that cross themselves, are cut by an occluder, or run side by side, found without a previous frame."""

from __future__ import annotations

from functools import partial

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from shape_obs import Centerline, Shape, ShapeDetector
from shape_obs.bench.scenes import draw_rope, resample
from tests.benchmarks.rope_scores import is_traversed
from tests.benchmarks.scenes.tangles import crossing_rope, cut_rope, touching_rope

TANGLES = {
    "1 crossing": partial(crossing_rope, crossings=1),
    "3 crossings": partial(crossing_rope, crossings=3),
    "cut, 16 px": partial(cut_rope, crossings=0, band=16),
    "crossing and cut, 50 px": partial(cut_rope, crossings=1, band=50),
    "side by side": touching_rope,
}


def detected(mask: npt.NDArray[np.uint8]) -> Shape:
    return ShapeDetector([Centerline(n=60)]).detect_mask(mask).shapes[0]


def strip(*points: tuple[float, float], width: float = 10.0) -> npt.NDArray[np.uint8]:
    return draw_rope(resample(np.array(points, dtype=np.float64), 1.0), width).mask


@pytest.mark.parametrize("draw", TANGLES.values(), ids=list(TANGLES))
def test_a_tangle_is_found_as_it_runs_or_refused(draw):
    """Points of a rope that was found right are not visible deep under what hides it."""
    rng, right, count, hidden, called_visible = np.random.default_rng(12), 0, 6, 0, 0
    for _ in range(count):
        tangle = draw(rng)
        shape = detected(tangle.mask)
        if not shape.ok:
            continue
        assert is_traversed(shape.pixels, tangle)
        right += 1
        nearest = np.linalg.norm(shape.pixels[:, None] - tangle.curve[None], axis=2).argmin(axis=1)
        under = tangle.hidden[nearest]
        under &= np.roll(under, 1) & np.roll(under, -1)
        hidden, called_visible = hidden + under.sum(), called_visible + (under & shape.visible).sum()
    assert right >= 0.8 * count
    assert called_visible <= 0.05 * hidden


def test_all_points_of_a_rope_that_crosses_itself_are_visible():
    tangle = crossing_rope(np.random.default_rng(11), 2)
    shape = detected(tangle.mask)
    assert shape.ok, shape.reason
    assert is_traversed(shape.pixels, tangle)
    assert shape.visible.all()


def test_a_mask_that_branches_is_refused():
    fork = strip((100, 100), (300, 200)) | strip((300, 200), (500, 100)) | strip((300, 200), (300, 400))
    shape = detected(fork)
    assert not shape.ok
    assert "branches" in shape.reason


def test_a_small_knob_is_left_out():
    rope = strip((100, 200), (500, 200)) | strip((300, 200), (300, 222), width=6)
    shape = detected(rope)
    assert shape.ok
    off = np.abs(shape.pixels[:, 1] - 200)
    assert np.mean(off < 1) > 0.9
    assert off.max() < 10


def test_a_closed_ring_is_refused():
    ring = np.zeros((300, 300), np.uint8)
    cv2.circle(ring, (150, 150), 90, (255,), 10)
    shape = detected(ring)
    assert not shape.ok
    assert "ring" in shape.reason
