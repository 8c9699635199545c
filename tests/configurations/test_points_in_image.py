"""Points that the fused stage of a tracked frame lays: the same as those that are laid step by step."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from shape_obs import Centerline, Contour, Intrinsics, Shape, ShapeDetector, Surface
from shape_obs import tracker as way

CAMERA = Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5)
SPECS = {
    "centres": Centerline(n=20),
    "tips, even in space": Centerline(n=12, ends="tips", spacing="m", radius=0.004),
    "outline": Contour(n=24),
    "outline, even in space": Contour(n=24, spacing="m"),
    "sheet": Surface(rows=3, cols=5),
    "sheet, tips": Surface(rows=4, cols=4, ends="tips", radius=0.002),
}


def seen(spec: Any, k: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return the mask and the depth of an object that moves, tilted, with noise."""
    mask = np.zeros((240, 320), np.uint8)
    if isinstance(spec, Centerline):
        along = np.linspace(0, 1, 60)
        line = np.stack([50 + 200 * along + 2 * k, 120 + k + 40 * np.sin(5 * along)], axis=1)
        cv2.polylines(mask, [np.round(line * 16).astype(np.int32)], False, 255, 10, cv2.LINE_8, 4)
    else:
        corners = np.array([(70 + k, 50), (240 + k, 70), (230 + k, 180 + k / 2), (60 + k, 170)])
        cv2.fillPoly(mask, [np.round(corners * 16).astype(np.int32)], 255, cv2.LINE_8, 4)
    depth = 600 + 0.2 * np.arange(320) + rng.normal(0, 1, (240, 320))
    return mask, np.where(mask, depth, 900).astype(np.uint16)


@pytest.mark.parametrize("with_depth", [False, True])
@pytest.mark.parametrize("name", SPECS)
def test_points_of_the_fused_stage_are_those_of_the_single_steps(
    name: str, with_depth: bool, monkeypatch: pytest.MonkeyPatch
):
    spec, rng, pairs = SPECS[name], np.random.default_rng(3), []
    if spec.spacing == "m" and not with_depth:
        pytest.skip("equal gaps in space need depth")
    shape_of = way.shape_of

    def both(spec: Any, found: Any, *rest: Any) -> Shape:
        shape = shape_of(spec, found, *rest)
        if found.laid is not None and len(found.laid[1][0]):
            pairs.append((shape, shape_of(spec, found._replace(laid=None), *rest)))
        return shape

    monkeypatch.setattr(way, "shape_of", both)
    detector = ShapeDetector([spec])
    for k in range(12):
        mask, depth = seen(spec, k, rng)
        shape = (
            detector.detect_mask(mask, depth, CAMERA).shapes[0] if with_depth else detector.detect_mask(mask).shapes[0]
        )
        assert shape.ok, shape.reason
    assert len(pairs) >= 10  # of the 11 frames after the first
    for fused, single in pairs:
        np.testing.assert_array_equal(fused.visible, single.visible)
        np.testing.assert_array_equal(fused.valid, single.valid)
        np.testing.assert_allclose(fused.points2d, single.points2d, atol=1e-4)
        np.testing.assert_allclose(fused.sigma, single.sigma, rtol=1e-4)
        assert (fused.points3d is None) == (not with_depth) == (single.points3d is None)
        if fused.points3d is not None:
            np.testing.assert_allclose(fused.points3d, single.points3d, atol=1e-6)
