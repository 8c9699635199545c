"""Images of any layout: converted once when a frame is made, and nothing is compiled for them in a live frame."""

from __future__ import annotations

import numpy as np
import pytest
from numba.core import event

from shape_obs import Centerline, Contour, GrayRange, Intrinsics, ShapeDetector, Surface
from shape_obs.frame import Frame
from tests.scenes.ropes import random_rope
from tests.scenes.sheets import random_sheet

CAMERA = Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)
LAYOUTS = {
    "as it is": lambda image: image,
    "Fortran": np.asfortranarray,
    "strided": lambda image: np.repeat(image, 2, axis=1)[:, ::2],
    "reversed": lambda image: image[::-1].copy()[::-1],
    "read-only": lambda image: np.frombuffer(image.tobytes(), image.dtype).reshape(image.shape),
}


class Compiled(event.Listener):
    def __init__(self) -> None:
        self.names: list[str] = []

    def on_start(self, event):
        self.names.append(event.data["dispatcher"].py_func.__name__)

    def on_end(self, event):
        pass


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_depth_that_needs_no_conversion_is_not_copied(dtype):
    depth = np.ones((480, 640), dtype)
    assert Frame(depth=depth).depth is depth
    assert depth.flags.writeable


@pytest.mark.parametrize("spec", [Centerline(spacing="m"), Contour(), Surface(), Centerline(lift="cloud")])
def test_no_layout_and_dtype_compiles_anything_or_changes_the_points(spec):
    rng = np.random.default_rng(3)
    mask = (random_sheet(rng, 1.5, 20.0) if isinstance(spec, Surface) else random_rope(rng)).mask
    depth, rgb = np.full(mask.shape, 0.75), np.repeat(mask[..., None], 3, axis=2)
    detectors = {"mask": ShapeDetector([spec]), "image": ShapeDetector([spec], GrayRange(low=128))}
    expected = np.asarray(detectors["mask"].detect_mask(mask, depth.astype(np.float32), CAMERA).shapes[0].points3d)
    assert np.isfinite(expected).all()
    listener, before = Compiled(), [image.copy() for image in (mask, depth, rgb)]
    event.register("numba:compile", listener)
    try:
        for layout in LAYOUTS.values():
            for given in (depth, depth.astype(np.float32), (1000 * depth).astype(np.uint16)):
                for each in (mask, mask > 0):
                    detectors["mask"].reset()
                    found = detectors["mask"].detect_mask(layout(each), layout(given), CAMERA).shapes[0]
                    np.testing.assert_allclose(np.asarray(found.points3d), expected, atol=1e-5)
            detectors["image"].reset()
            found = detectors["image"].detect(layout(rgb), layout(depth), CAMERA).shapes[0]
            np.testing.assert_allclose(np.asarray(found.points3d), expected, atol=1e-5)
    finally:
        event.unregister("numba:compile", listener)
    assert listener.names == []
    for image, kept in zip((mask, depth, rgb), before, strict=True):  # nothing is written into what is given
        np.testing.assert_array_equal(image, kept)
