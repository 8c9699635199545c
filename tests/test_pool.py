"""Several cameras in one call: the same detections as one after the other, in order, and errors told by camera."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from shape_obs import (
    Centerline,
    DetectorPool,
    DetectorPoolError,
    GrayRange,
    HSVRange,
    Intrinsics,
    ShapeDetector,
    ShapeLostError,
)
from shape_obs.evaluation.motion import moving_rope

BLUE = HSVRange((100, 100, 60), (125, 255, 255))


@pytest.fixture(scope="module")
def videos():
    """Six frames of three cameras: (H,W,3) uint8."""
    colours = np.array([150, 150, 150], np.uint8), np.array([30, 60, 200], np.uint8)
    return [
        [colours[0] + (colours[1] - colours[0]) * (rope.mask[..., None] > 0) for rope in moving_rope(
            np.random.default_rng(seed), 6.0, 6, length=400.0, width=12.0)]
        for seed in (1, 2, 3)
    ]  # fmt: skip


def assert_equal(found, expected):
    assert len(found) == len(expected)
    for a, b in zip(found, expected, strict=True):
        assert a.stamp == b.stamp
        for shape, other in zip(a.shapes, b.shapes, strict=True):
            assert shape.ok == other.ok
            np.testing.assert_array_equal(shape.points2d, other.points2d)
            if other.points3d is not None:
                np.testing.assert_array_equal(shape.points3d, other.points3d)


def make(count=3, **options):
    return [ShapeDetector(Centerline(n=10), BLUE, **options) for _ in range(count)]


def test_a_pool_finds_what_its_detectors_find_one_after_the_other(videos):
    intrinsics = Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)
    depth = np.full((480, 640), 800, np.uint16)
    alone = make()
    with DetectorPool(make()) as pool:
        assert len(pool) == 3
        for i, images in enumerate(zip(*videos, strict=True)):
            found = pool.detect([(image, depth, intrinsics) for image in images], stamps=0.1 * i)
            expected = [
                detector.detect(image, depth, intrinsics, stamp=0.1 * i)
                for detector, image in zip(alone, images, strict=True)
            ]
            assert all(detection.shapes[0].ok for detection in found)
            assert_equal(found, expected)


def test_stamps_and_anchors_come_one_for_all_or_one_each(videos):
    images = [video[0] for video in videos]
    ends = [{"hand": tuple(make(1)[0].detect(image).shapes[0].pixels[end])} for image, end in zip(images, (0, -1, 0))]  # noqa: B905
    spec = Centerline(n=10, anchor="hand")
    with DetectorPool([ShapeDetector(spec, BLUE) for _ in images]) as pool:
        found = pool.detect(images, stamps=[1.0, 2.0, None], anchors=ends)
        assert [detection.stamp for detection in found] == [1.0, 2.0, 0.0]
        for detection, anchors in zip(found, ends, strict=True):
            assert np.linalg.norm(detection.shapes[0].pixels[0] - anchors["hand"]) < 3
        assert [d.stamp for d in pool.detect(images, stamps=3, anchors=ends[0])] == [3.0] * 3


def test_a_camera_that_fails_is_named_and_the_others_are_kept(videos):
    images = [video[0] for video in videos]
    bad = [images[0], images[1].astype(float), images[2][..., :2]]
    expected = make(1)[0].detect(images[0])
    with DetectorPool(make()) as pool:
        with pytest.raises(
            DetectorPoolError, match=r"^camera 1: TypeError: rgb: expected .*; camera 2: ValueError: rgb"
        ) as told:
            pool.detect(bad)
        assert list(told.value.errors) == [1, 2]
        assert isinstance(told.value.errors[1], TypeError)
        assert told.value.__cause__ is told.value.errors[1]
        assert told.value.detections[1:] == [None, None]
        assert_equal([told.value.detections[0]], [expected])
        assert [d.shapes[0].ok for d in pool.detect(images)] == [True] * 3  # and goes on


def test_a_lost_shape_is_an_error_where_it_shall_be(videos):
    with DetectorPool(make(2, on_missing="raise")) as pool, pytest.raises(DetectorPoolError, match="camera 1") as told:
        pool.detect([videos[0][0], np.zeros((480, 640, 3), np.uint8)])
    assert isinstance(told.value.errors[1], ShapeLostError)


def test_cameras_are_looked_at_side_by_side():
    """Each detector waits for the other: one after the other they would wait for ever."""
    both = threading.Barrier(2, timeout=20)

    class Waiting(GrayRange, kind="test_waiting"):
        def threshold(self, frame, window):
            both.wait()
            return super().threshold(frame, window)

    image = np.zeros((60, 90, 3), np.uint8)
    image[25:33, 10:80] = 255
    with DetectorPool([ShapeDetector(segmentation=Waiting(low=128)) for _ in range(2)]) as pool:
        assert [d.shapes[0].ok for d in pool.detect([image, image])] == [True, True]


def test_what_does_not_fit_is_told(videos):
    detector = make(1)[0]
    with pytest.raises(ValueError, match=r"a pool needs at least one detector, got none."):
        DetectorPool([])
    with pytest.raises(ValueError, match="a detector is given twice: each camera needs one of its own"):
        DetectorPool([detector, detector])
    with DetectorPool(make(2)) as pool:
        for arguments, name in (
            ({"frames": [videos[0][0]]}, "frames"),
            ({"frames": [videos[0][0]] * 2, "stamps": [1.0]}, "stamps"),
            ({"frames": [videos[0][0]] * 2, "anchors": [None] * 3}, "anchors"),
        ):
            with pytest.raises(ValueError, match=rf"{name}: expected one for each of the 2 cameras, got [13]\."):
                pool.detect(**arguments)


def test_reset_and_close(videos):
    images = [video[0] for video in videos]
    pool = DetectorPool(make())
    first = pool.detect(images, stamps=5.0)
    pool.reset()
    assert_equal(pool.detect(images, stamps=5.0), first)
    pool.close()
    with pytest.raises(RuntimeError, match="shutdown"):
        pool.detect(images)
    assert pool.detectors[0].detect(images[0]).shapes[0].ok
