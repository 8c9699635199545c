"""The error that is expected of each point: its parts, its bounds, and what it says of drawn ropes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from shape_obs import Centerline, Intrinsics, ShapeDetector
from shape_obs.bench.scenes import resample
from shape_obs.geometry.topology import Chain, Grid
from shape_obs.tracking.belief import MAX_SIGMA, known_layout, point_errors, stereo_noise
from tests.scenes.ropes import random_rope

CAMERA = Intrinsics(1280, 720, 636.0, 636.0, 639.5, 359.5)


def expected(points3d, layout, visible=None, valid=None):
    """The errors of points in front of a camera that were fitted in its image, on an object of 300 pixels."""
    visible = np.ones(len(points3d), bool) if visible is None else visible
    places = np.asarray(points3d, np.float32)
    edges, across, shares = known_layout(layout)
    residual, noise = np.hypot(shares.resolution, shares.size * 300.0), shares.depth * stereo_noise(CAMERA.fx, 1280)
    return point_errors(
        places, CAMERA.project(places).astype(np.float32), visible, visible if valid is None else valid, edges, across,
        residual, shares.aslant, CAMERA.fx, noise, MAX_SIGMA,
    )  # fmt: skip


def line(count: int, z: float, degrees: float = 0.0, step: float = 0.01) -> np.ndarray:
    along = np.arange(count)[:, None] * step
    turn = np.radians(degrees)
    return along * [np.cos(turn), 0.0, np.sin(turn)] + [0.0, 0.0, z]


def test_two_axes_come_from_the_image_and_one_from_depth():
    residual = np.hypot(0.35, 0.15)  # pixels
    for z in (0.5, 2.0):
        noise = 1.8 * z**2 * 0.08 / (636.0 * 0.095)  # 0.6 and 9.5 mm
        sigma = expected(line(5, z), Chain(5))
        np.testing.assert_allclose(sigma, np.sqrt((2 * (residual * z / 636.0) ** 2 + noise**2) / 3), rtol=1e-4)
    hole = expected(line(5, 0.5), Chain(5), valid=np.arange(5) != 2)
    assert hole[2] > 1.5 * hole[0]


def test_what_is_seen_aslant_is_less_sure():
    flat, steep = expected(line(5, 1.0), Chain(5)), expected(line(5, 1.0, 75.0, 0.002), Chain(5))
    noise, residual = 1.8 * stereo_noise(636.0, 1280), np.hypot(0.35, 0.15) / 636.0
    assert flat[2] == pytest.approx(np.sqrt((2 * residual**2 + noise**2) / 3), rel=1e-3)
    stretch = 1 / np.cos(np.radians(75))
    along = 0.013 * 4 * 0.002 * (1 - 1 / stretch)  # of the length
    assert steep[2] == pytest.approx(np.sqrt(((1 + stretch**2) * residual**2 + noise**2 + along**2) / 3), rel=0.02)


def test_unequal_gaps_show_where_a_lattice_is_off():
    lattice = np.stack([*np.meshgrid(np.arange(8.0), np.arange(4.0)), np.full((4, 8), 35.0)], axis=-1) * 0.02
    even = expected(lattice.reshape(-1, 3), Grid(4, 8))
    assert np.ptp(even) < 1e-5
    lattice[1, 3, 0] += 0.004
    off = expected(lattice.reshape(-1, 3), Grid(4, 8))
    assert off.argmax() == 8 + 3
    assert 0.001 < off.max() < 0.008
    assert (off > even + 1e-5).all()


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

    def test_what_was_never_found_may_be_anywhere_and_pixels_are_not_metres(self, wave, intrinsics):
        """A shape found without depth and lost with it is held in pixels; where it is in space is not known."""
        empty, depth = np.zeros_like(wave.mask), np.full(wave.mask.shape, 0.7)
        assert (ShapeDetector().detect_mask(empty).shapes[0].sigma == np.float32(400)).all()
        detector = ShapeDetector()
        assert (detector.detect_mask(empty, depth, intrinsics).shapes[0].sigma == 1).all()
        detector.detect_mask(wave.mask)
        assert (detector.detect_mask(empty, depth, intrinsics).shapes[0].sigma == 1).all()
