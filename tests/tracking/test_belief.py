"""The error that is expected of each point: its parts, its bounds, and what it says of drawn ropes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from shape_obs import Centerline, ShapeDetector
from shape_obs.bench.synthetic.ropes import random_rope, resample
from shape_obs.geometry.topology import Chain, Grid, Ring
from shape_obs.tracking.belief import (
    MAX_SIGMA,
    aged,
    arc_to_nearest,
    expected_error,
    stereo_noise,
    stretches,
    unevenness,
)


@pytest.mark.parametrize("layout", [Chain(1), Chain(2), Chain(40), Ring(3), Ring(41), Grid(5, 8)], ids=repr)
@pytest.mark.parametrize("dimension", [2, 3])
def test_the_way_to_the_nearest_known_point_is_the_shortest_along_the_layout(layout, dimension):
    rng = np.random.default_rng(layout.size)
    for share in (0.05, 0.3, 0.9):
        points, known = rng.normal(size=(layout.size, dimension)), rng.random(layout.size) < share
        known[rng.integers(layout.size)] = True
        edges = layout.edges().astype(np.int32)  # as old versions of SciPy take them
        length = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
        graph = coo_array((length, edges.T), shape=(layout.size, layout.size)).tocsr()
        oracle = dijkstra(graph, directed=False, indices=np.flatnonzero(known).astype(np.int32), min_only=True)
        np.testing.assert_allclose(arc_to_nearest(points, layout, known), oracle)


def test_where_nothing_is_known_there_is_no_way():
    points = np.zeros((4, 2))
    assert np.isinf(arc_to_nearest(points, Chain(4), np.zeros(4, bool))).all()
    assert not arc_to_nearest(points, Chain(4), np.ones(4, bool)).any()


def test_errors_grow_away_from_what_is_visible_up_to_the_bound():
    away = np.array([0.0, 4.0, 40.0, 1e9, np.inf, np.nan])
    sigma = expected_error(away, away, 0.6, 200.0)
    assert sigma.dtype == np.float32
    assert sigma[0] == pytest.approx(0.6)
    assert (np.diff(sigma[:4]) > 0).all()
    assert sigma[3:].tolist() == [200.0, 200.0, 200.0]


def test_in_space_two_axes_come_from_the_image_and_one_from_depth():
    nothing, z = np.zeros(2), np.array([0.5, 2.0])
    noise = stereo_noise(z, 636.0, 1280)
    np.testing.assert_allclose(noise, z**2 * 0.08 / (636.0 * 0.095))  # 0.33 and 5.3 mm
    residual = 0.7 * z / 636.0
    sigma = expected_error(nothing, nothing, residual, MAX_SIGMA, depth_noise=noise)
    np.testing.assert_allclose(sigma, np.sqrt((2 * residual**2 + noise**2) / 3), rtol=1e-6)
    hole = expected_error(nothing, np.array([0.0, 0.03]), residual, MAX_SIGMA, depth_noise=noise)
    assert hole[0] == sigma[0]
    assert hole[1] > sigma[1]
    steep = expected_error(nothing, nothing, residual, MAX_SIGMA, stretch=3.0, depth_noise=noise)
    np.testing.assert_allclose(steep, np.sqrt((10 * residual**2 + noise**2) / 3), rtol=1e-6)


def test_a_small_image_has_the_noise_of_the_camera_that_it_comes_from():
    z = np.array([0.7])
    assert stereo_noise(z, 386.0, 640) == stereo_noise(z, 386.0 / 4, 160)
    assert stereo_noise(z, 2 * 386.0, 1280) == stereo_noise(z, 386.0, 640) / 2


def test_an_object_is_longer_than_it_looks_where_it_is_seen_aslant():
    angle, z = np.radians(60), 0.7
    flat = np.arange(5)[:, None] * [0.01, 0.0, 0.0]
    points = np.array([0.0, 0.0, z]) + flat * [np.cos(angle), 0, 0] + flat[:, [1, 2, 0]] * np.sin(angle)
    pixels = flat[:, :2] * np.cos(angle) * 600 / z
    scale = np.full(5, z / 600)
    np.testing.assert_allclose(stretches(pixels, points, Chain(5).edges(), scale), 2.0)
    np.testing.assert_allclose(stretches(pixels * 3, points, Chain(5).edges(), scale), 1.0)


def test_unequal_gaps_show_where_a_lattice_is_off():
    lattice = np.stack([*np.meshgrid(np.arange(8.0), np.arange(4.0)), np.zeros((4, 8))], axis=-1) * 0.02
    assert unevenness(lattice.reshape(-1, 3), Grid(4, 8)) == pytest.approx(0)
    lattice[1, 3, 0] += 0.004
    off = unevenness(lattice.reshape(-1, 3), Grid(4, 8)).reshape(4, 8)
    assert off.argmax() == 8 + 3
    assert 0.001 < off.max() < 0.008
    assert off.min() > 0


def test_what_is_not_seen_may_move():
    sigma = np.array([0.001, 0.1], np.float32)
    np.testing.assert_array_equal(aged(sigma, 0.0, MAX_SIGMA), sigma)
    assert aged(sigma, 0.4, MAX_SIGMA).tolist() == pytest.approx([0.1, 0.1414], abs=1e-3)
    assert aged(sigma, 1e300, MAX_SIGMA).tolist() == [1.0, 1.0]


def test_visible_points_of_ropes_lie_within_it():
    """Of smooth ropes at least 85 % of the points lie within 2.15 sigma, and sigma is small."""
    rng, inside, sigmas = np.random.default_rng(0), [], []
    for _ in range(8):
        rope = random_rope(rng, "smooth")
        shape = ShapeDetector(Centerline(n=20, ends="tips")).detect_mask(rope.mask).shapes[0]
        fine = resample(rope.curve, 0.1)
        true = fine[np.round(np.linspace(0, 1, 20) * (len(fine) - 1)).astype(int)]
        away = min((np.linalg.norm(shape.points2d - order, axis=1) for order in (true, true[::-1])), key=np.mean)
        inside.append(away <= 2.15 * shape.sigma)
        sigmas.append(shape.sigma)
    assert np.mean(inside) >= 0.85
    assert np.max(sigmas) < 2


class TestSigmaOfADetector:
    def test_under_a_finger_it_is_larger(self, wave, intrinsics):
        mask = wave.mask.copy()
        mask[:, 150:190] = 0
        detector, depth = ShapeDetector(Centerline(n=40)), np.full(mask.shape, 0.7)
        frames: list[Any] = [(mask,), (mask, depth, intrinsics)]
        for frame in frames:
            detector.reset()
            shape = detector.detect_mask(*frame).shapes[0]
            assert 3 < np.count_nonzero(~shape.visible) < 10
            assert shape.sigma[~shape.visible].min() > shape.sigma[shape.visible].max()
            assert shape.sigma.max() > 2 * shape.sigma.min()
        assert detector.detect_mask(*frames[1]).shapes[0].sigma.max() < 0.02, "metres"

    def test_without_depth_at_a_point_it_is_larger(self, wave, intrinsics):
        depth = np.full(wave.mask.shape, 0.7)
        depth[:, 200:] = 0
        shape = ShapeDetector().detect_mask(wave.mask, depth, intrinsics).shapes[0]
        assert 0 < np.count_nonzero(shape.valid) < 20
        assert (np.diff(shape.sigma[~shape.valid]) > 0).all()

    def test_depth_farther_away_is_less_sure(self, wave, intrinsics):
        near, far = (
            ShapeDetector().detect_mask(wave.mask, np.full(wave.mask.shape, z), intrinsics).shapes[0].sigma
            for z in (0.5, 2.0)
        )
        assert (far > 4 * near).all()

    def test_a_lost_shape_is_less_and_less_sure_up_to_the_bound(self, wave, intrinsics):
        empty, depth = np.zeros_like(wave.mask), np.full(wave.mask.shape, 0.7)
        frames: list[Any] = [((empty,), np.hypot(240, 320)), ((empty, depth, intrinsics), MAX_SIGMA)]
        for frame, bound in frames:
            detector = ShapeDetector()
            last = detector.detect_mask(wave.mask, *frame[1:], stamp=0.0).shapes[0].sigma
            for stamp in (0.1, 0.2, 0.5, 1.0, 100.0):
                sigma = detector.detect_mask(*frame, stamp=stamp).shapes[0].sigma
                assert (sigma > last).all()
                last = sigma
            np.testing.assert_allclose(last, bound, rtol=1e-6)

    def test_what_was_never_found_may_be_anywhere(self, wave, intrinsics):
        empty = np.zeros_like(wave.mask)
        assert (ShapeDetector().detect_mask(empty).shapes[0].sigma == np.float32(400)).all()
        shape = ShapeDetector().detect_mask(empty, np.full(empty.shape, 0.7), intrinsics).shapes[0]
        assert (shape.sigma == 1).all()

    def test_pixels_are_not_metres(self, wave, intrinsics):
        """A shape found without depth and lost with it is held in pixels; where it is in space is not known."""
        detector, depth = ShapeDetector(), np.full(wave.mask.shape, 0.7)
        detector.detect_mask(wave.mask)
        assert (detector.detect_mask(np.zeros_like(wave.mask), depth, intrinsics).shapes[0].sigma == 1).all()
