"""Outlines and sheets on both backends: kernel by kernel, and frame by frame."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
import pytest

from shape_obs import Contour, ShapeDetector, Surface
from shape_obs.bench.synthetic.blobs import KINDS, moving_blob, random_blob
from shape_obs.bench.synthetic.sheets import moving_sheet, random_sheet, turning_sheet
from shape_obs.compiled import NUMPY, choose
from shape_obs.geometry.form import Curve
from shape_obs.geometry.outline import Border
from shape_obs.tracking.occlusion import strayed_corner, strays
from shape_obs.tracking.registration import blend, lag

pytest.importorskip("numba", reason="compares the backends: pip install 'shape-obs[fast]'")
NUMBA = choose("numba")


def blob(seed: int = 0) -> np.ndarray:
    """(P,2) the traced outline of a drawn blob."""
    mask = random_blob(np.random.default_rng(seed)).mask
    contours = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    return np.asarray(max(contours, key=len), dtype=np.float64).reshape(-1, 2)


def sheet(seed: int = 0) -> Border:
    """The border of a drawn cloth."""
    rng = np.random.default_rng(seed)
    mask = random_sheet(rng, 1.5, rng.uniform(0, 360)).mask
    contours = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    return Border(np.asarray(max(contours, key=len), dtype=np.float64).reshape(-1, 2))


class TestOutlines:
    def test_masks_are_traced_as_opencv_does(self):
        rng = np.random.default_rng(0)
        for _ in range(300):
            height, width = rng.integers(1, 40, 2)
            noise = cv2.GaussianBlur(rng.normal(size=(height, width)).astype(np.float32), (0, 0), rng.uniform(0.3, 3))
            mask = (noise > 0).astype(np.uint8)
            count, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
            if count < 2:
                continue
            piece = np.ascontiguousarray((labels == 1 + np.argmax(stats[1:, 4])).astype(np.uint8))
            runs, _, box, _ = NUMPY.survey(piece, 5, -3, 1, 0)
            outline, length, holes = NUMPY.traced(piece, runs, 5, -3, box)
            again = NUMBA.traced(piece, runs, 5, -3, box)
            np.testing.assert_array_equal(again[0], outline)
            np.testing.assert_allclose(again[1:], (length, holes))

    @pytest.mark.parametrize("hole", [False, True])
    def test_borders(self, hole):
        traced = blob()
        found = NUMPY.border(traced, hole)
        np.testing.assert_allclose(NUMBA.border(traced, hole), found, atol=1e-9)
        backwards = NUMPY.border(traced[::-1].copy(), hole)
        np.testing.assert_allclose(Curve(found[0], np.zeros(len(traced), bool), True).size,
                                   Curve(backwards[0], np.zeros(len(traced), bool), True).size)  # fmt: skip
        for points in (traced, traced[:-1], traced[:1]):
            np.testing.assert_allclose(NUMBA.pairs(points), NUMPY.pairs(points))

    @pytest.mark.parametrize("pieces", [1, 4])
    def test_rings(self, pieces):
        points, smooth = NUMPY.border(blob(1), False)
        found, miss = NUMPY.ring(points, smooth, smooth[7] + 0.2, 60, 0.4, pieces)
        again, missed = NUMBA.ring(points, smooth, smooth[7] + 0.2, 60, 0.4, pieces)
        np.testing.assert_allclose(again, found, atol=1e-9)
        assert missed == pytest.approx(miss, rel=1e-9)
        if pieces > 1:
            samples = NUMPY.pairs(points)
            size = Curve(found, np.zeros(len(found), bool), True).size
            assert NUMPY.miss(samples, found, size) == pytest.approx(miss, rel=1e-6)
            assert NUMBA.miss(samples, found, size) == pytest.approx(miss, rel=1e-6)

    def test_phases(self):
        curve = Curve(NUMPY.border(blob(2), False)[1], np.zeros(len(blob(2)), bool), True)
        reference = curve.begun_at(31.4).even(90)
        predicted, angle = reference + (3, -2), 0.3
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        found = curve.even(90) @ turn
        # Of points in space the covariances are what they are, so a plane in it tells what the plane's way must tell.
        space = [np.pad(points, ((0, 0), (0, 1))) for points in (reference, predicted, found)]
        behind = lag(space[0], space[1], space[2])
        for kernels in (NUMPY, NUMBA):
            assert kernels.lag(reference, predicted, found) == pytest.approx(behind, abs=1e-6)
            np.testing.assert_allclose(
                kernels.blend(reference, found, 0.05), blend(space[0], space[2], 0.05)[:, :2], atol=1e-9
            )
            points, arc, nodes, blended = kernels.followed(curve.points @ turn, reference, predicted, 0.05)
            np.testing.assert_allclose(arc, Curve(points, np.zeros(len(points), bool), True).arc)
            np.testing.assert_allclose(nodes, Curve(points, np.zeros(len(points), bool), True).even(90), atol=1e-6)
            np.testing.assert_allclose(nodes, reference @ turn, atol=0.2)
            np.testing.assert_allclose(blended, blend(reference, nodes, 0.05), atol=1e-6)


class TestSheets:
    def test_corners_and_patches(self):
        for seed in range(5):
            outline = sheet(seed).smooth
            rim, again = NUMPY.rim(outline), NUMBA.rim(outline)
            for one, other in zip(rim, again, strict=True):
                np.testing.assert_allclose(other, one, atol=1e-8)
            points, turn, candidates, step, grain = rim
            nodes = np.random.default_rng(seed).uniform(100, 400, (8, 8, 2))
            expected = NUMPY.outer_corners(nodes)
            np.testing.assert_allclose(NUMBA.outer_corners(nodes), expected)
            corners = NUMPY.corners_near(points, candidates, step, expected)
            np.testing.assert_array_equal(NUMBA.corners_near(points, candidates, step, expected), corners)
            corners = candidates[np.linspace(0, len(candidates) - 1, 4).round().astype(int)]
            lattice, kink = NUMPY.laid(points, turn, corners, step, grain)
            assert NUMBA.laid(points, turn, corners, step, grain)[1] == pytest.approx(kink)
            np.testing.assert_allclose(NUMBA.laid(points, turn, corners, step, grain)[0], lattice, atol=1e-9)
            patch = lattice.reshape(25, 25, 2)
            np.testing.assert_allclose(NUMBA.assessed(patch), NUMPY.assessed(patch), rtol=1e-6, atol=1e-8)
            gauges = NUMPY.gauges(patch)
            for one, other in zip(gauges, NUMBA.gauges(patch), strict=True):
                np.testing.assert_allclose(other, one)
            for size in ((4, 8, True), (3, 2, False)):
                found = NUMPY.sampled(patch, *gauges, *size)
                np.testing.assert_allclose(NUMBA.sampled(patch, *gauges, *size), found, atol=1e-9)
            for kernels in (NUMPY, NUMBA):
                near = kernels.sampled(patch, *gauges, 8, 8, True).reshape(8, 8, 2)
                np.testing.assert_allclose(kernels.tracked(*rim, near)[0], lattice, atol=1e-9)
                assert kernels.tracked(*rim, near[::-1].copy())[0].shape == (0, 2)  # mirrored

    def test_corners_out_of_order_and_no_candidates(self):
        points, _, candidates, step, _ = NUMPY.rim(sheet().smooth)
        for expected in (points[[0, 100, 200, 300]], points[[0, 300, 200, 100]], points[[5, 5, 200, 300]]):
            for some in (candidates, candidates[:0], candidates[:1]):
                found = NUMPY.corners_near(points, some, step, expected)
                np.testing.assert_array_equal(NUMBA.corners_near(points, some, step, expected), found)

    def test_straying_corners(self):
        rng = np.random.default_rng(0)
        for _ in range(20):
            nodes, lattice = rng.uniform(0, 200, (4, 5, 2)), rng.uniform(0, 200, (2, 2, 2))
            expected, corners = NUMPY.outer_corners(nodes), lattice[[0, 0, 1, 1], [0, 1, 1, 0]]
            away = [np.sum((np.roll(corners, -quarters, axis=0) - expected) ** 2) for quarters in range(4)]
            for kernels in (NUMPY, NUMBA):
                quarters, corner, share = kernels.strayed(nodes, lattice)
                assert quarters == np.argmin(away)
                assert strays(corner, share) == strayed_corner(expected, np.roll(corners, -quarters, axis=0))


def agree(spec: Contour | Surface, masks: Iterable[np.ndarray], *, tracked: bool) -> None:
    """Both backends put the points of a shape at the same places, and say the same of them."""
    one, other = (ShapeDetector([spec], backend=backend, on_missing="nan") for backend in ("numpy", "numba"))
    for mask in masks:
        first, second = one.detect_mask(mask).shapes[0], other.detect_mask(mask).shapes[0]
        assert first.reason == second.reason
        assert first.quality == pytest.approx(second.quality, abs=1e-6)
        np.testing.assert_allclose(second.points2d, first.points2d, atol=1e-3)
        np.testing.assert_array_equal(second.visible, first.visible)
        if not tracked:
            one.reset()
            other.reset()


@pytest.mark.parametrize("turn", [0.0, 0.1])
def test_moving_outlines_agree(turn):
    masks = [b.mask for b in moving_blob(np.random.default_rng(1), turn=turn, speed=6, swell=0.3, frames=25)]
    agree(Contour(n=32), masks, tracked=True)


@pytest.mark.parametrize("kind", KINDS)
def test_cold_outlines_agree(kind):
    rng = np.random.default_rng(2)
    agree(Contour(n=24), [random_blob(rng, kind).mask for _ in range(4)], tracked=False)


def test_outlines_of_holes_agree():
    masks = [b.mask.copy() for b in moving_blob(np.random.default_rng(3), turn=0.05, speed=3, swell=0.2, frames=15)]
    for mask in masks:
        u, v, width, height = cv2.boundingRect(mask)
        cv2.circle(mask, (u + width // 2, v + height // 2), 25, 0, -1)
    agree(Contour(n=16, hole=0), masks, tracked=True)
    agree(Contour(n=32), masks, tracked=True)


@pytest.mark.parametrize("ends", ["centers", "tips"])
def test_moving_cloths_agree(ends):
    masks = [s.mask for s in moving_sheet(np.random.default_rng(4), 8, 25)]
    agree(Surface(rows=4, cols=8, ends=ends), masks, tracked=True)


def test_turning_and_cold_cloths_agree():
    masks = [s.mask for s in turning_sheet(np.random.default_rng(5), 1.5, 12.0)]
    agree(Surface(rows=3, cols=5), masks, tracked=True)
    agree(Surface(rows=3, cols=5, epochs=1), masks[:8], tracked=True)
    agree(Surface(rows=4, cols=8), masks[::5], tracked=False)
