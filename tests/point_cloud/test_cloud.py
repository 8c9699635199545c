"""Test detection in clouds: ropes, rings and sheets in space, the cloud under a mask, anchors, and bad input."""

from __future__ import annotations

import re
import warnings
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from shape_obs import CameraModel, Centerline, Contour, Intrinsics, ShapeDetector, Surface
from shape_obs.metrics import distance, spacing_cv
from tests.scenes.clouds import SheetCloud, ring_cloud, rope_cloud, sheet_cloud

TIPS = Centerline(ends="tips")


@pytest.fixture(autouse=True)
def _no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def one(detector: ShapeDetector, points: Any, **kwargs: Any) -> Any:
    return detector.detect_cloud(points, **kwargs).shapes[0]


def straight(count: int = 3000, start: float = -0.3, end: float = 0.3, y: float = 0.0, z: float = 1.0) -> np.ndarray:
    """Return a cloud of a rope along x with 4 mm noise."""
    draw = np.random.default_rng(1)
    points = draw.normal(0, 0.004, (count, 3)) + (0, y, z)
    points[:, 0] = draw.uniform(start, end, count)
    return points


class TestDetectCloud:
    def test_a_shape_of_a_cloud_has_no_pixels(self):
        shape = one(ShapeDetector(Centerline(n=7)), straight())
        assert shape.points2d is None
        assert shape.points3d.shape == (7, 3)
        assert shape.points3d.dtype == np.float32
        assert shape.visible.all()
        assert shape.valid.all()
        np.testing.assert_allclose(shape.points3d, np.linspace([-0.3, 0, 1], [0.3, 0, 1], 15)[1::2], atol=2e-3)
        with pytest.raises(ValueError, match="was found in a cloud and has no points2d: use points3d"):
            _ = shape.pixels

    def test_every_float_and_an_organised_cloud_are_the_same(self):
        points = straight(3000)
        expected = one(ShapeDetector(TIPS), points).points3d
        organised = np.full((60, 60, 3), np.nan)
        organised.reshape(-1, 3)[np.random.default_rng(0).choice(3600, 3000, replace=False)] = points
        for given_points in (points.astype(np.float32), organised, np.asfortranarray(points)):
            np.testing.assert_allclose(one(ShapeDetector(TIPS), given_points).points3d, expected, atol=4e-3)

    def test_points_that_are_none_change_nothing(self):
        points = straight()
        none = np.array([[np.nan, 0, 1], [np.inf, 0, 1], [0, -np.inf, 1], [0, 0, 0], [1e30, 0, 0], [0, 0, 2e6]])
        mixed = np.concatenate([none, points[:1000], none, points[1000:]])
        np.testing.assert_array_equal(one(ShapeDetector(), mixed).points3d, one(ShapeDetector(), points).points3d)

    def test_a_gap_is_bridged_and_reported(self):
        points = np.concatenate([straight(2000, -0.3, -0.05), straight(2000, 0.07, 0.3)])
        shape = one(ShapeDetector(Centerline(n=31, ends="tips")), points)
        true = np.linspace([-0.3, 0, 1], [0.3, 0, 1], 31)
        inside = (true[:, 0] > -0.025) & (true[:, 0] < 0.045)
        outside = (true[:, 0] < -0.055) | (true[:, 0] > 0.075)
        assert shape.ok
        assert not shape.visible[inside].any()
        assert np.isnan(shape.points3d[inside]).all()
        assert shape.valid[outside].all()
        np.testing.assert_allclose(shape.points3d[outside], true[outside], atol=4e-3)
        filled = one(ShapeDetector(Centerline(n=31, ends="tips"), on_invalid="interpolate"), points)
        np.testing.assert_allclose(filled.points3d, true, atol=5e-3)
        assert not filled.valid[inside].any()

    def test_radius_gives_the_axis_behind_the_visible_half(self):
        rope = rope_cloud(np.random.default_rng(5), side="front", holes=0, noise=0.001)
        found = {
            radius: one(ShapeDetector(Centerline(ends="tips", radius=radius)), rope.points).points3d
            for radius in (0.0, rope.radius)
        }
        nearest = [np.linalg.norm(rope.curve[:, None] - p, axis=2).min(axis=0)[1:-1].mean() for p in found.values()]
        assert nearest[0] > 0.6 * rope.radius
        assert nearest[1] < 0.25 * rope.radius

    def test_order_is_kept_from_frame_to_frame_and_image_order_is_not(self):
        tracked, image = ShapeDetector(TIPS), ShapeDetector(TIPS, order="image")
        points, swapped = straight() - (0, 0, 1), 0
        for degrees in range(20, 200, 6):
            angle = np.radians(degrees)
            turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
            cloud = points @ turn.T + (0, 0, 1)
            true = np.array([-0.3, 0, 0]) @ turn.T + (0, 0, 1)
            np.testing.assert_allclose(one(tracked, cloud).points3d[0], true, atol=0.01)
            swapped += np.linalg.norm(one(image, cloud).points3d[0] - true) > 0.1
        assert swapped > 5

    def test_a_detector_that_is_given_masks_and_clouds_in_turn_starts_again(self, wave, intrinsics):
        detector = ShapeDetector(TIPS)
        for _ in range(2):
            assert one(detector, straight()).ok
            assert one(detector, np.zeros((0, 3))).points2d is None
            seen = detector.detect_mask(wave.mask).shapes[0]
            assert (seen.ok, seen.new, seen.points3d) == (True, True, None)
            assert detector.detect_mask(np.zeros_like(wave.mask)).shapes[0].points2d is not None


@pytest.mark.parametrize("seed", range(2))
def test_points_lie_on_ropes_rings_and_sheets_with_equal_gaps(seed):
    rng = np.random.default_rng(seed)
    rope, ring, sheet = rope_cloud(rng, side="front"), ring_cloud(rng), sheet_cloud(rng)
    for cloud, spec in ((rope, Centerline(n=20)), (ring, Contour(n=24)), (sheet, Surface(rows=4, cols=6))):
        shape = one(ShapeDetector(spec), cloud.points)
        assert shape.ok
        assert shape.quality > 0.5
        assert shape.valid.mean() > 0.9
        assert spacing_cv(shape.points3d, shape.layout) < 0.04
        if not isinstance(cloud, SheetCloud):
            off = distance(shape.points3d, cloud.curve, closed=isinstance(spec, Contour))
            assert off.mean() < (0.6 * cloud.radius if spec.kind == "centerline" else 0.003) + 0.003


class TestAnchors:
    POSE = CameraModel(
        Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5),
        np.array([[0.0, -1, 0, 3], [1, 0, 0, 4], [0, 0, 1, 5], [0, 0, 0, 1]]),
    )

    @pytest.mark.parametrize("end", [-0.3, 0.3])
    def test_a_point_in_the_clouds_frame(self, end):
        for anchor in ((end, 0, 1), "hand"):
            shape = one(
                ShapeDetector(Centerline(ends="tips", anchor=anchor)), straight(), anchors={"hand": (end, 0, 1)}
            )
            np.testing.assert_allclose(shape.points3d[0], (end, 0, 1), atol=4e-3)

    @pytest.mark.parametrize("end", [-0.3, 0.3])
    def test_a_point_in_the_base_frame(self, end):
        point = tuple(float(value) for value in self.POSE.to_base((end, 0, 1)))
        detector = ShapeDetector(Centerline(ends="tips", anchor="hand"))
        shape = one(detector, straight(), camera=self.POSE, anchors={"hand": point})
        np.testing.assert_allclose(shape.points3d[0], (end, 0, 1), atol=4e-3)

    @pytest.mark.parametrize(
        ("anchor", "camera", "message"),
        [
            ((1, 2), None, r"anchor \(1.0, 2.0\) is a pixel, and a cloud has none: give \(x, y, z\)"),
            ("hnd", None, "anchor 'hnd' was not given; did you mean 'hand'"),
            ((1, 2, 3), POSE.intrinsics, "in the base frame needs the camera's place there: give camera=CameraModel"),
        ],
    )
    def test_one_that_cannot_be_resolved_is_reported(self, anchor, camera, message):
        detector = ShapeDetector(anchor=anchor)
        with pytest.raises(ValueError, match=message):
            detector.detect_cloud(straight(), camera=camera, anchors={"hand": (1, 2, 3)})


class TestRefusals:
    """Clouds that are no rope are refused with a reason."""

    @pytest.mark.parametrize(
        ("points", "reason"),
        [
            (np.random.default_rng(0).normal(0, 0.05, (2000, 3)) + (0, 0, 1), "too stout for a rope"),
            (ring_cloud(np.random.default_rng(0)).points, "of the curve lies off the cloud"),
            (np.concatenate([straight(), straight(y=0.1)]), "no single rope joins: a gap of 0.100 m at a sharp turn"),
            (np.concatenate([straight(), straight()[:, [1, 0, 2]] + (0, 0, 0)]), "lies off the cloud|no single rope"),
            (np.zeros((0, 3)), "the cloud is empty"),
            (np.array([[0.1, 0.2, 1]]), "the cloud has 1 points, at least 16 are needed"),
            (np.tile([[0.1, 0.2, 1]], (500, 1)), "too stout for a rope"),
            (np.random.default_rng(0).normal(0, 1, (500, 3)) * 1e300, "the cloud is empty"),
            (np.repeat(np.random.default_rng(0).normal(size=(3, 3)), 30, axis=0), "of the curve would be gaps"),
        ],
    )
    def test_a_reason_is_given(self, points, reason):
        shape = one(ShapeDetector(), points)
        assert not shape.ok
        assert not shape.valid.any()
        assert np.isnan(shape.points3d).all()
        assert re.search(reason, shape.reason), shape.reason


@pytest.mark.parametrize(
    ("points", "error", "message"),
    [
        (None, TypeError, "points: expected a numpy array of floating metres, got NoneType"),
        ([[1.0, 2.0, 3.0]], TypeError, "got list"),
        (np.zeros((9, 3), np.int16), TypeError, "got an array of int16; scale millimetres by 0.001"),
        (np.zeros(9, [("x", "f4"), ("y", "f4"), ("z", "f4")]), TypeError, "stack the fields of a PointCloud2"),
        (np.zeros((9, 4)), ValueError, r"points: expected shape \(M, 3\) or \(H, W, 3\), got \(9, 4\); of \(M, 4\)"),
        (np.zeros((2, 2, 2, 3)), ValueError, r"got \(2, 2, 2, 3\)"),
    ],
)
def test_a_wrong_cloud_is_reported(points, error, message):
    detector = ShapeDetector()
    with pytest.raises(error, match=message):
        detector.detect_cloud(points)
    assert one(detector, straight()).ok


_SPECS = [Centerline(n=5), Contour(n=9), Surface(rows=2, cols=3)]


@settings(max_examples=60)
@given(
    points=hnp.arrays(
        st.sampled_from([np.float16, np.float32, np.float64]),
        st.tuples(st.integers(0, 60), st.just(3)),
        elements=st.one_of(st.floats(width=16), st.sampled_from([0.0, 0.5, 1.0])),
        fill=st.sampled_from([0.25, float("nan")]),
    ),
    repeats=st.integers(1, 9),
)
def test_no_cloud_crashes(points, repeats):
    detection = ShapeDetector(_SPECS).detect_cloud(np.repeat(points, repeats, axis=0))
    assert len(detection) == 3  # its contract is checked
