"""Degenerate masks, depth and lenses: no warning, no undeclared exception, and no NaN that is not declared."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from fuzzing.inputs import random_inputs_run, run_case

from shape_obs import Centerline, Contour, Intrinsics, ShapeDetector, Surface
from shape_obs.frame import depth_images
from shape_obs.image.connected_runs import near_mask
from shape_obs.point_cloud.local_depth import median_depth

EVERYTHING: dict[str, Any] = {"segmentation": {"kind": "gray", "min_area": 1, "min_share": 0}, "on_invalid": "nan"}


@pytest.fixture(autouse=True)
def _no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*(Give metres|check the unit)")  # places may lie anywhere here
        yield


@pytest.mark.parametrize("count", [20, pytest.param(5_000, marks=[pytest.mark.nightly, pytest.mark.timeout(1800)])])
def test_random_inputs_break_no_promise(count):
    inputs, failures = random_inputs_run(count, seed=11)
    assert failures == []
    assert inputs >= count


def test_an_outline_without_extent_is_no_sheet():
    """A lens of 0.1 px puts specks hundreds of metres apart. The random inputs found this case."""
    assert run_case(5, 93) == (8, [])


def thin_masks() -> dict[str, np.ndarray]:
    masks = {name: np.zeros((48, 64), np.uint8) for name in ("row", "column", "two rows", "diagonal", "dots", "edge")}
    masks["row"][20, 3:60] = 1
    masks["column"][3:45, 30] = 1
    masks["two rows"][20:22] = 1
    np.fill_diagonal(masks["diagonal"], 1)
    masks["dots"][::4, ::4] = 1  # 192 pieces: joining them would take seconds
    masks["edge"][[0, -1]] = masks["edge"][:, [0, -1]] = 1
    return masks


@pytest.mark.parametrize("lift", ["points", "cloud"])
@pytest.mark.parametrize("name", list(thin_masks()))
def test_thin_masks_over_any_depth(name, lift):
    mask, rng = thin_masks()[name], np.random.default_rng(0)
    lenses: list[dict[str, Any]] = [
        {}, {"fx": 1e-3, "fy": 1e-3}, {"fx": 1e9, "fy": 1e9}, {"cx": 1e7, "cy": -1e7},
        {"model": "brown_conrady", "coeffs": (0.0, 0.0, 3.0, -2.0, 0.0)},
        {"model": "inverse_brown_conrady", "coeffs": (-3.0, 40.0, 0.1, 0.1, 1e5)},
    ]  # fmt: skip
    specs = [Centerline(n=5, lift=lift), Contour(n=6, lift=lift), Surface(rows=2, cols=2, lift=lift)]
    detector = ShapeDetector(specs, **EVERYTHING)
    for lens in lenses:
        camera = Intrinsics(**{"width": 64, "height": 48, "fx": 60.0, "fy": 60.0, "cx": 31.5, "cy": 23.5, **lens})
        for depth in (rng.uniform(0, 3, mask.shape), np.full(mask.shape, 0.7), np.full(mask.shape, 1e-300)):
            detector.detect_mask(mask, depth, camera)  # the contract of a detection is checked
        detector.reset()


def test_pixels_that_no_image_holds_lie_off_the_mask():
    """In compiled code, an integer made of NaN or 1e30 would read memory outside the image."""
    mask, depth = np.ones((9, 12), np.uint8), np.full((9, 12), 0.5, np.float32)
    off = [np.nan, np.inf, -np.inf, 1e30, -1e30, 2.0**62, -(2.0**63)]
    points = np.array([[5.0, 4.0], *([x, 4.0] for x in off), *([5.0, x] for x in off), *([x, x] for x in off)])
    for left, top in ((0, 0), (100, 50)):
        at = points + (left, top)
        on = near_mask(mask, left, top, at, 1)
        np.testing.assert_array_equal(on, np.arange(len(points)) == 0)
        image = np.zeros((80, 120), np.float32)
        image[top : top + 9, left : left + 12] = depth
        z, _ = median_depth(depth_images(image), mask, left, top, at, 1, 0.25, True)
        np.testing.assert_array_equal(np.isfinite(z), on)


@pytest.mark.parametrize("model", ["brown_conrady", "inverse_brown_conrady"])
@pytest.mark.parametrize("coeffs", [(0.0, 0.0, 9.0, 9.0, 0.0), (-3.0, 0.0, 0.0, 0.0, 0.0)], ids=["beyond", "folded"])
def test_pixels_to_which_the_lens_has_no_ray_have_no_points(model, coeffs):
    """The iteration that undoes the distortion diverges for the first lens, and oscillates for the second."""
    camera = Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5, model, coeffs)
    rays = camera.rays(np.array([[159.5, 119.5], [162.0, 119.5], [0.0, 0.0], [319.0, 239.0]]))
    np.testing.assert_array_equal(np.isnan(rays).all(axis=1), [False, False, True, True])
    assert np.isfinite(rays[:2]).all()
    mask = np.zeros((240, 320), np.uint8)
    mask[116:123, 20:310] = 1
    shape = ShapeDetector(Centerline(n=9)).detect_mask(mask, np.full(mask.shape, 0.7), camera).shapes[0]
    assert shape.ok
    assert shape.points3d is not None
    assert 0 < np.count_nonzero(shape.valid) < 9
    np.testing.assert_array_equal(np.isfinite(shape.points3d).all(axis=1), shape.valid)
    assert np.isfinite(shape.points2d).all()


def test_points_next_to_or_behind_the_camera_have_no_pixels():
    camera = Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5, "brown_conrady", (0.1, 0.1, 0.0, 0.0, 0.1))
    pixels = camera.project([[0, 0, 1], [0.1, 0, 1], [0, 0, 0], [0, 0, -1], [1, 0, 1e-300], [1e300, 0, 1]])
    np.testing.assert_array_equal(np.isfinite(pixels).all(axis=1), [True, True, False, False, False, False])
    assert np.isnan(pixels[2:]).all()


@pytest.mark.parametrize("interval", [5e-324, 1e-300, 1e-12, 0.0])
def test_stamps_that_nearly_stand_still_lose_no_moving_rope(wave, interval):
    detector = ShapeDetector()
    shapes = [detector.detect_mask(np.roll(wave.mask, 3 * i, axis=0), stamp=i * interval).shapes[0] for i in range(4)]
    assert all(shape.ok and not shape.reason for shape in shapes)
    moved = [(shape.points2d - shapes[0].points2d)[:, 1].mean() for shape in shapes]
    assert moved == pytest.approx([0, 3, 6, 9], abs=0.3)
