"""Tangents, bending, moments, length, centroid and orientation: closed forms, bounds, and shapes with holes."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from drawn_shapes import OVERHEAD, PAIRS, VIEW, angles, bends, circle, drawn, rectangle, shape, turned
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from shape_obs import Feature
from shape_obs.features import (
    Centroid,
    ContourMoments,
    Curvature,
    Length,
    Orientation,
    RegionMoments,
    Tangents,
    TurningAngles,
)
from shape_obs.geometry.topology import Chain, Grid, Ring


class TestPromises:
    @pytest.mark.parametrize("frame", ["pixels", "normalized", "camera", "base"])
    @pytest.mark.parametrize(("layout", "make"), PAIRS)
    def test_bounds_units_and_values_are_of_one_size(self, layout, make, frame):
        feature = make(frame=frame)
        low, high = feature.bounds(layout, VIEW)
        values = feature.compute(shape(drawn(layout, np.ones(4)), layout), VIEW)
        assert low.shape == high.shape == values.shape == (len(feature.units(layout, VIEW)),)
        assert np.isfinite([low, high]).all()
        assert (low < high).all()
        assert np.isfinite(values).all()
        assert feature.needs_depth == (frame in ("camera", "base"))
        assert Feature.from_dict(feature.to_dict()) == feature

    @pytest.mark.parametrize(("layout", "make"), PAIRS)
    @settings(max_examples=8)
    @given(data=st.data())
    def test_points_within_their_box_give_values_within_their_bounds(self, layout, make, data):
        frame = data.draw(st.sampled_from(["pixels", "normalized", "camera", "base"]))
        share = data.draw(hnp.arrays(np.float64, (layout.size, 3), elements=st.floats(0, 1)))
        unknown = data.draw(st.lists(st.integers(0, layout.size - 1), max_size=layout.size))
        pixels = np.array([-0.5, -0.5]) + share[:, :2] * [320, 240]
        points = np.array(VIEW.workspace[0]) + share * np.subtract(VIEW.workspace[1], VIEW.workspace[0])  # type: ignore[index]
        seen = shape(OVERHEAD.from_base(points), layout, unknown)
        pixels[unknown] = np.nan
        feature = make(frame=frame)
        values = feature.compute(replace(seen, points2d=pixels.astype(np.float32)), VIEW)
        low, high = feature.bounds(layout, VIEW)
        room = 1e-5 * (high - low)
        assert (np.isnan(values) | ((values >= low - room) & (values <= high + room))).all()

    @pytest.mark.parametrize(("layout", "make"), PAIRS)
    def test_what_cannot_be_computed_is_nan(self, layout, make):
        nothing = shape(np.zeros((layout.size, 2)), layout, unknown=range(layout.size))
        assert np.isnan(make().compute(nothing, VIEW)).all()
        one_place = make().compute(shape(np.full((layout.size, 2), 0.1), layout), VIEW)
        if make not in (Centroid, Length):
            assert np.isnan(one_place).all()

    def test_what_does_not_exist_raises_an_error(self):
        with pytest.raises(ValueError, match=r"'region_moments' is for the region inside .* got"):
            RegionMoments().bounds(Chain(20), VIEW)
        with pytest.raises(ValueError, match=r"is for a line, a Chain .* got Grid\(rows=4, cols=8\).*'region_moments'"):
            ContourMoments().bounds(Grid(4, 8), VIEW)
        with pytest.raises(ValueError, match="'curvature' needs at least three points, got Chain"):
            Curvature().bounds(Chain(2), VIEW)
        with pytest.raises(ValueError, match="max_curvature must be a positive number, got 0"):
            Curvature(max_curvature=0)
        with pytest.raises(ValueError, match="max_elongation must be a number from 1 on, got 0"):
            RegionMoments(max_elongation=0)
        with pytest.raises(ValueError, match="order: unknown value 4"):
            ContourMoments(order=4)  # type: ignore[arg-type]
        with pytest.raises(ValueError, match="cannot be turned back into points"):
            Length().error(shape(circle(20), Chain(20)), VIEW)


class TestClosedForms:
    def test_a_straight_line_does_not_bend(self):
        line = shape(np.outer(np.arange(20), [0.012, 0.016]), Chain(20))
        np.testing.assert_allclose(TurningAngles().compute(line, VIEW), np.zeros(18), atol=1e-5)
        np.testing.assert_allclose(Curvature().compute(line, VIEW), np.zeros(18), atol=1e-3)
        np.testing.assert_allclose(Tangents().compute(line, VIEW), np.tile([0.6, 0.8, 0], 20), atol=1e-5)
        np.testing.assert_allclose(Length().compute(line, VIEW), [0.38], rtol=1e-6)
        for axis in ("heading", "principal"):
            np.testing.assert_allclose(Orientation(axis=axis).compute(line, VIEW), [0.6, 0.8], atol=1e-5)

    @pytest.mark.parametrize("n", [5, 20, 32])
    def test_a_circle_bends_by_one_over_its_radius(self, n):
        ring, arc = shape(circle(n), Ring(n)), shape(circle(n, arc=2, closed=False), Chain(n))
        np.testing.assert_allclose(Curvature().compute(ring, VIEW), np.full(n, 10.0), rtol=1e-4)
        np.testing.assert_allclose(Curvature().compute(arc, VIEW), np.full(n - 2, 10.0), rtol=1e-3)
        np.testing.assert_allclose(TurningAngles().compute(ring, VIEW), np.full(n, 2 * np.pi / n), atol=1e-5)
        np.testing.assert_allclose(TurningAngles().compute(arc, VIEW), np.full(n - 2, 2 / (n - 1)), atol=1e-4)
        around = np.stack([-circle(n)[:, 1], circle(n)[:, 0], np.zeros(n)], axis=1)
        np.testing.assert_allclose(Tangents().compute(ring, VIEW), (10 * around).ravel(), atol=1e-5)

    def test_clockwise_as_seen_is_positive_in_the_image_and_negative_from_above(self):
        ring = shape(circle(32), Ring(32))
        assert (TurningAngles(frame="pixels").compute(ring, VIEW) > 0).all()
        assert (TurningAngles(frame="base").compute(ring, VIEW) < 0).all()
        np.testing.assert_allclose(TurningAngles(frame="base").compute(ring, VIEW).sum(), -2 * np.pi, atol=1e-5)

    def test_the_region_of_a_rectangle(self):
        w, h = 0.3, 0.1
        expected = [w * h, w / 2, h / 2, w / h / 12, 0, h / w / 12, 0, 0, 0, 0]
        values = RegionMoments(order=3).compute(shape(rectangle(w, h), Ring(20)), VIEW)
        np.testing.assert_allclose(values, expected, atol=1e-6)

    @given(bends, st.sampled_from([Chain(20), Ring(32)]))
    def test_moments_of_a_line_are_those_of_many_points_on_it(self, bend, layout):
        points = drawn(layout, bend).astype(np.float32).astype(np.float64)
        corners = np.concatenate([points, points[:1]]) if isinstance(layout, Ring) else points
        share = (np.arange(200)[:, None] + 0.5) / 200
        many = np.concatenate([a + share * (b - a) for a, b in pairwise(corners)])
        weight = np.repeat(np.linalg.norm(np.diff(corners, axis=0), axis=1), 200) / 200
        total = weight.sum()
        x, y = ((many - weight @ many / total) / total).T
        products = [x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3]
        expected = [total, *weight @ many / total, *(weight @ product / total for product in products)]
        np.testing.assert_allclose(ContourMoments(order=3).compute(shape(points, layout), VIEW), expected, atol=1e-5)

    @given(angles, st.floats(-1.4, 1.4))
    def test_an_ellipse_lies_along_its_longer_axis_to_the_side_of_point_0(self, angle, start):
        at = start + 2 * np.pi * np.arange(32) / 32
        ring = shape(turned(np.stack([0.2 * np.cos(at), 0.1 * np.sin(at)], axis=1), angle), Ring(32))
        principal = Orientation(axis="principal").compute(ring, VIEW)
        np.testing.assert_allclose(principal, [np.cos(angle), np.sin(angle)], atol=1e-4)
        heading = turned(np.array([[0.2 * np.cos(start), 0.1 * np.sin(start)]]), angle)[0]
        np.testing.assert_allclose(Orientation().compute(ring, VIEW), heading / np.linalg.norm(heading), atol=1e-4)


losses = st.sets(st.integers(0, 19), max_size=4)


class TestUnknownPoints:
    @given(losses)
    def test_bends_are_those_of_the_known_points(self, lost):
        for layout, arc, closed in ((Ring(20), 2 * np.pi, True), (Chain(20), 3.0, False)):
            points = circle(20, arc=arc, closed=closed)
            part = shape(points, layout, unknown=lost)
            whole = shape(points, layout)
            expected = TurningAngles().compute(whole, VIEW)
            np.testing.assert_allclose(TurningAngles().compute(part, VIEW), expected, atol=1e-4)
            np.testing.assert_allclose(Curvature().compute(part, VIEW), Curvature().compute(whole, VIEW), rtol=0.06)

    @given(losses)
    def test_length_is_that_of_equal_edges(self, lost):
        for layout, points in ((Ring(20), circle(20)), (Chain(20), circle(20, arc=4, closed=False))):
            whole = Length().compute(shape(points, layout), VIEW)
            np.testing.assert_allclose(Length().compute(shape(points, layout, unknown=lost), VIEW), whole, rtol=1e-5)
