"""Features: dimension, units, frames, bounds, unknown points, clipped values; crossings as a feature."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from shape_obs import CameraModel, Centerline, Shape
from shape_obs.features import (
    Age,
    Crossings,
    FeatureContext,
    FeatureVector,
    New,
    Ok,
    Points2D,
    Points2DNormalized,
    Points3D,
    Sigma,
    Valid,
    read_features,
)
from shape_obs.geometry.crossings import Crossing
from shape_obs.geometry.topology import Chain, Ring

WORKSPACE = ((-0.5, -0.4, -0.1), (0.5, 0.4, 0.3))


def shape(points2d: Any = ((0, 0), (10, 20)), points3d: Any = ((0, 0, 1), (0.1, 0.2, 0.9)), **rest: Any) -> Shape:
    points2d = np.array(points2d, np.float32)
    known = np.ones(len(points2d), bool)
    points3d = None if points3d is None else np.array(points3d, np.float32)
    given = {"visible": known, "valid": known, "layout": Chain(len(known)), **rest}
    return Shape("rope", points2d, points3d, **given)


@pytest.fixture
def view(overhead) -> FeatureContext:
    return FeatureContext(320, 240, overhead, WORKSPACE, max_age=0.5, anchor=(0.1, 0.0, 0.2))


ALL = [
    Points2D(),
    Points2DNormalized(),
    Points3D(),
    Points3D(frame="base"),
    Points3D(frame="anchor"),
    Ok(),
    Age(),
    Valid(),
    Sigma(),
    Sigma(frame="pixels"),
    New(),
]


def test_metres_in_three_frames(view):
    # the camera hangs one metre above the base's origin and looks straight down
    points = shape(points3d=[[0.1, 0.2, 0.9], [0, 0, 1]])
    camera = Points3D().compute(points, view)
    np.testing.assert_allclose(camera, [0.1, 0.2, 0.9, 0, 0, 1], atol=1e-6)
    base = Points3D(frame="base").compute(points, view)
    np.testing.assert_allclose(base, [0.1, -0.2, 0.1, 0, 0, 0], atol=1e-6)
    anchor = Points3D(frame="anchor").compute(points, view)
    np.testing.assert_allclose(anchor, base - np.tile([0.1, 0.0, 0.2], 2), atol=1e-6)


@given(st.floats(0, 319), st.floats(0, 239), st.floats(0.01, 2.0))
def test_every_point_in_view_is_within_bounds(overhead, u, v, z):
    view = FeatureContext(320, 240, overhead)
    point = overhead.intrinsics.deproject([[u, v]], [z])
    for frame in ("camera", "base"):
        low, high = Points3D(frame=frame).bounds(Chain(1), view)
        values = Points3D(frame=frame).compute(shape([[u, v]], point), view)
        assert (values >= low - 1e-6).all()
        assert (values <= high + 1e-6).all()


def test_trust_as_numbers(view):
    lost = shape(ok=False, age=0.3, valid=np.array([True, False]))
    assert Ok().compute(lost, view).tolist() == [0.0]
    assert Ok().compute(shape(), view).tolist() == [1.0]
    assert Age().compute(lost, view).tolist() == [0.3]
    assert Age().compute(shape(age=7.0), view).tolist() == [0.5]
    assert Age().bounds(Chain(2), view)[1].tolist() == [0.5]
    assert Valid().compute(lost, view).tolist() == [1.0, 0.0]
    assert New().compute(lost, view).tolist() == [0.0]
    assert New().compute(shape(new=True), view).tolist() == [1.0]


def test_errors_are_in_metres_or_in_pixels(view):
    sigma = np.array([0.002, 1.0], np.float32)
    in_space, flat = shape(sigma=sigma), shape(points3d=None, sigma=[0.5, 400.0])
    metres, pixels = Sigma(), Sigma(frame="pixels")
    assert metres.compute(in_space, view).tolist() == pytest.approx([0.002, 1.0])
    focal = view.camera.intrinsics.fx  # type: ignore[union-attr]
    assert pixels.compute(in_space, view).tolist() == pytest.approx([0.002 * focal, min(focal / 0.9, 400.0)])
    assert pixels.compute(flat, view).tolist() == [0.5, 400.0]
    assert (metres.unit, metres.needs_depth, pixels.unit, pixels.needs_depth) == ("m", True, "px", False)
    assert metres.bounds(Chain(2), view)[1].tolist() == [1.0, 1.0]
    assert pixels.bounds(Chain(2), view)[1].tolist() == [400.0, 400.0]
    unknown = np.full((2, 3), np.nan)
    assert pixels.compute(shape(points3d=unknown, sigma=sigma), view).tolist() == [400.0, 400.0]
    half = shape(points3d=[(0, 0, 0.5), (np.nan, np.nan, np.nan)], sigma=[0.01, 0.01])
    assert pixels.compute(half, view).tolist() == pytest.approx([0.02 * focal] * 2)
    with pytest.raises(ValueError, match="'sigma' in metres needs depth and a camera; without them, frame='pixels'"):
        metres.compute(flat, view)
    with pytest.raises(ValueError, match="in pixels of points in space needs a camera model"):
        pixels.compute(in_space, replace(view, camera=None))


def test_what_is_needed_is_named_in_the_error(view):
    with pytest.raises(ValueError, match="feature 'points3d' needs a camera model: let the env publish `camera_model`"):
        Points3D().bounds(Chain(2), replace(view, camera=None))
    with pytest.raises(ValueError, match="feature 'points3d' in frame 'base' needs transform_camera_to_base"):
        Points3D(frame="base").bounds(Chain(2), replace(view, camera=CameraModel(view.camera.intrinsics)))
    with pytest.raises(ValueError, match="relative to the anchor needs a shape anchored to a base-frame point"):
        Points3D(frame="anchor").compute(shape(), replace(view, anchor=None))
    with pytest.raises(ValueError, match="needs depth and a camera, but the shape has no points3d"):
        Points3D().compute(shape(points3d=None), view)


class TestVector:
    def vector(self, view, features, *shapes):
        return FeatureVector(read_features(features), shapes or [Centerline(n=2)], view)

    def test_blocks_follow_one_another_shape_after_shape(self, view):
        a, b = shape([[1, 2], [3, 4]]), shape([[5, 6], [7, 8], [9, 10]], ok=False)
        values = self.vector(view, ["points2d", "ok"], Centerline(n=2), Centerline(n=3, name="b")).compute(
            [a, b], [view, view]
        )
        assert values.dtype == np.float32
        np.testing.assert_array_equal(values, [1, 2, 3, 4, 1, 5, 6, 7, 8, 9, 10, 0])

    def test_what_is_unknown_sits_at_the_centre_of_its_bounds(self, view):
        vector = self.vector(view, [Points2D(), Points3D(frame="base"), Ok()])
        nothing = shape(np.full((2, 2), np.nan), np.full((2, 3), np.nan), ok=False)
        np.testing.assert_allclose(
            vector.compute([nothing], [view]), [159.5, 119.5] * 2 + [0, 0, 0.1] * 2 + [0], atol=1e-6
        )
        half = shape([[1, 2], [np.nan, 4]], [[0, 0, 1], [np.nan] * 3])
        np.testing.assert_allclose(vector.compute([half], [view])[:4], [1, 2, 159.5, 4])

    def test_what_is_out_of_bounds_is_clipped_with_one_warning(self, view):
        vector = self.vector(view, "points2d")
        away = shape([[-9, 500], [1e9, -np.inf]])
        with pytest.warns(UserWarning, match=r"3 of 4 values lie outside their bounds .* set workspace="):
            values = vector.compute([away], [view])
        np.testing.assert_array_equal(values, [-0.5, 239.5, 319.5, 119.5])
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            np.testing.assert_array_equal(vector.compute([away], [view]), values)

    @pytest.mark.filterwarnings("error::UserWarning")
    def test_a_little_noise_is_clipped_without_a_word(self, view):
        values = self.vector(view, "points2d").compute([shape([[-3, 0], [10, 242]])], [view])
        np.testing.assert_array_equal(values, [-0.5, 0, 10, 239.5])

    @given(hnp.arrays(np.float32, (4, 2)), hnp.arrays(np.float32, (4, 3)), st.booleans(), st.floats(0, 1e9))
    def test_no_shape_leaves_the_bounds(self, overhead, points2d, points3d, ok, age):
        view = FeatureContext(320, 240, overhead, WORKSPACE, anchor=(0, 0, 0))
        vector = FeatureVector(ALL, [Centerline(n=4)], view)
        with np.errstate(over="ignore", invalid="ignore"):
            values = vector.compute([shape(points2d, points3d, ok=ok, age=age)], [view])
        assert values.dtype == vector.low.dtype == np.float32
        assert (values >= vector.low).all()
        assert (values <= vector.high).all()


FLAT = FeatureContext(320, 240)
SCENE = (
    Crossing(("a", "a"), (0.125, 0.5), (10.0, 20.0), 1, 1),
    Crossing(("a", "b"), (0.25, 0.875), (30.0, 20.0), 0, -1),
    Crossing(("b", "a"), (0.25, 0.75), (30.0, 50.0), None, 1),
    Crossing(("c", "a"), (0.625, 0.875), (90.0, 50.0), 0, 1),
)


def rope(name, crossings):
    points, known = np.zeros((5, 2), np.float32), np.ones(5, bool)
    own = tuple(c for c in crossings if name in c.slots)
    return Shape(name, points, None, known, known, Chain(5), crossings=own)


def test_counts_and_passages():
    values = Crossings(passages=6).compute(rope("a", SCENE), FLAT)
    np.testing.assert_array_equal(values[:4], [1, 1, 1, 1])
    np.testing.assert_array_equal(
        values[4:].reshape(-1, 2), [[0.125, -1], [0.25, 1], [0.5, 1], [0.75, 0], [0.875, -1], [0, 0]]
    )
    values = Crossings(passages=1).compute(rope("b", SCENE), FLAT)
    np.testing.assert_array_equal(values, [0, 0, 1, 1, 0.25, 0])


def test_values_are_within_their_bounds():
    for feature in (Crossings(), Crossings(passages=0, max_count=1)):
        low, high = feature.bounds(Chain(5), FLAT)
        for scene in ((), SCENE, 50 * SCENE):
            values = feature.compute(rope("a", scene), FLAT)
            assert values.shape == low.shape == high.shape
            assert ((low <= values) & (values <= high)).all()
        assert (low < high).all()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Crossings().bounds(Ring(5), FLAT), "is for a Chain"),
        (lambda: Crossings(passages=-1), "passages must be at least 0"),
        (lambda: Crossings(max_count=0), "max_count must be at least 1"),
    ],
)
def test_crossings_that_cannot_be_counted_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
