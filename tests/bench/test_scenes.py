"""The truth of drawn scenes is true: points lie on the object and its depth, and hidden ones under the hand."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import cv2
import numpy as np
import pytest

from shape_obs.bench.photos import BLUE, Hand, Scene, photograph, photographs
from shape_obs.bench.scenes import draw_blob, draw_rope, draw_sheet, moving_blob, moving_rope, moving_sheet, truth_of

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


def test_an_area_is_the_one_that_geometry_gives():
    circle = 100 * np.stack([np.cos(a := np.linspace(0, 2 * np.pi, 721)[:-1]), np.sin(a)], axis=1) + (320.3, 240.1)
    ring = draw_blob(circle, (circle - (320.3, 240.1)) / 2 + (320.3, 240.1))
    assert np.count_nonzero(ring.mask) == pytest.approx(np.pi * (100**2 - 50**2), rel=1e-3)
    for caps, area in ((True, 300 * 20.0), (False, 300 * 20.0 + np.pi * 10**2)):
        straight = np.stack([np.arange(100.3, 401.0), np.full(301, 200.2)], axis=1)
        rope = draw_rope(straight, 20.0, flat_caps=caps)
        assert rope.length == pytest.approx(300 if caps else 320)
        # the border of what OpenCV fills belongs to it, which adds up to a quarter of a pixel on each side
        assert 0 <= np.count_nonzero(rope.mask) - area <= 0.5 * (300 + 20) * 2
    lattice = np.stack(np.meshgrid(np.linspace(50.3, 250.3, 65), np.linspace(60.3, 160.3, 65)), axis=-1)
    assert np.count_nonzero(draw_sheet(lattice).mask) == pytest.approx(200 * 100, rel=0.01)


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


def test_a_hand_covers_its_bar_and_lies_nearer_than_the_object():
    rope = next(moving_rope(np.random.default_rng(0), 0.0, 1))
    hand = Hand((320.0, 240.0), 0.0, 40.0)  # from the left to the middle
    probes = np.array([[320.0, 240.0], [339.0, 240.0], [341.0, 240.0], [10.0, 259.0], [10.0, 261.0]])
    assert hand.covers(probes).tolist() == [True, True, False, True, False]
    scene = photograph(np.random.default_rng(1), rope, hand=hand, distance=0.7)
    assert not scene.mask[240, :330].any()
    near = scene.depth[230:250, 20:300]
    assert np.median(near[near > 0]) == pytest.approx(640, abs=1)
