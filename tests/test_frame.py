"""Images of any layout and kind: converted once when a frame is made; nothing is compiled for them in a live frame."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

import numpy as np
import pytest
from numba.core import event
from PIL import Image

from shape_obs import Centerline, Contour, GrayRange, Intrinsics, ShapeDetector, Surface
from shape_obs.frame import Frame
from shape_obs.utils.arrays import read_depth
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


#: Arrays of other kinds with the same numbers.
KINDS = {
    "masked, nothing hidden": np.ma.array,
    "signed": lambda image: image.astype(np.int16) if image.dtype == np.uint16 else image,
    "big-endian": lambda image: image.astype(image.dtype.newbyteorder(">")),
    "PIL": lambda image: Image.fromarray(image),
    "tensor": lambda image: type("Tensor", (), {"__array__": lambda self, dtype=None, copy=None: image})(),
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


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_arrays_of_other_kinds_are_read(kind):
    mask = random_rope(np.random.default_rng(3)).mask
    depth, rgb = np.full(mask.shape, 750, np.uint16), np.repeat(mask[..., None], 3, axis=2)
    detector = ShapeDetector(Centerline(spacing="m"), GrayRange(low=128))
    expected = detector.detect(rgb, depth, CAMERA).shapes[0].points3d
    detector.reset()
    found = detector.detect(kind(rgb), kind(depth), CAMERA).shapes[0].points3d
    np.testing.assert_array_equal(np.asarray(found), np.asarray(expected))
    found = ShapeDetector(Centerline(spacing="m")).detect_mask(kind(mask), kind(depth), CAMERA).shapes[0].points3d
    np.testing.assert_array_equal(np.asarray(found), np.asarray(expected))


def test_a_file_of_signed_depth_is_read_and_time_differences_are_seconds(tmp_path):
    np.save(tmp_path / "z.npy", np.array([[-1, 0, 750]], np.int16))
    frame = Frame(depth=read_depth(tmp_path / "z.npy"), stamp=np.timedelta64(2500, "ms"))  # pyright: ignore[reportArgumentType]
    assert (np.asarray(frame.depth).tolist(), frame.stamp) == ([[0, 0, 750]], 2.5)
    assert Frame(stamp=timedelta(seconds=2.5)).stamp == 2.5  # pyright: ignore[reportArgumentType]


def test_what_a_mask_hides_is_no_depth_no_object_and_no_point():
    mask = random_rope(np.random.default_rng(3)).mask
    hidden = np.zeros(mask.shape, bool)
    hidden[:, : mask.shape[1] // 2] = True
    depth = np.ma.array(np.full(mask.shape, 750, np.uint16), mask=hidden)
    shape = ShapeDetector().detect_mask(mask, depth, CAMERA).shapes[0]
    assert 0 < shape.valid.sum() < shape.visible.sum()
    found = ShapeDetector().detect_mask(np.ma.array(mask, mask=hidden)).shapes[0]
    assert found.pixels[:, 0].min() > mask.shape[1] // 2 - 1
    cloud = np.random.default_rng(0).uniform(size=(2000, 3)) * (0.5, 0.02, 0.02) + (0, 0, 0.7)
    masked = np.ma.array(cloud, mask=np.repeat(cloud[:, :1] < 0.25, 3, axis=1))
    assert np.nanmin(np.asarray(ShapeDetector().detect_cloud(masked).shapes[0].points3d)[:, 0]) > 0.24


def test_arrays_with_units_or_on_a_gpu_are_refused_by_name():
    with_unit: Any = type("Quantity", (), {"__array__": lambda self: np.zeros((4, 4)), "units": "millimetre"})()
    with pytest.raises(TypeError, match="depth: the array carries the unit millimetre"):
        Frame(depth=with_unit)

    frame: Any = type("depth_frame", (), {"get_data": bytes, "get_units": float})()
    with pytest.raises(TypeError, match=r"depth: got a frame of librealsense; give .* \* frame.get_units\(\)"):
        Frame(depth=frame)

    class Cuda:
        def __array__(self, dtype=None, copy=None):
            raise TypeError("can't convert cuda:0 device type tensor to numpy. Use Tensor.cpu()")

    with pytest.raises(TypeError, match=r"rgb: this Cuda cannot be read as a NumPy array: .*Tensor.cpu\(\)"):
        Frame(rgb=Cuda())  # type: ignore[arg-type]
