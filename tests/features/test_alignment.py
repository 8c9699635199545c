"""Features of shapes that are moved, turned, scaled or reversed, or have unknown points."""

from __future__ import annotations

import numpy as np
import pytest
from drawn_shapes import PAIRS, VIEW, angles, bends, circle, drawn, shape, shifts, turned
from hypothesis import given, settings
from hypothesis import strategies as st

from shape_obs import Feature
from shape_obs.features import Curvature, Length, Orientation, TurningAngles
from shape_obs.geometry.topology import Chain, Ring, Topology


def transformed(feature: Feature, values: np.ndarray, angle: float, shift: np.ndarray, scale: float) -> np.ndarray:
    """Return the expected feature of ``scale * turned(points, angle) + shift``."""
    if feature.kind in ("turning_angles", "curvature", "length"):
        power = {"turning_angles": 0, "curvature": -1, "length": 1}[feature.kind]
        return values * scale**power
    if feature.kind in ("tangents", "orientation"):
        return turned(values.reshape(-1, 2), angle).ravel()
    if feature.kind == "centroid":
        return turned(scale * values[None], angle)[0] + shift
    c, s = np.cos(angle), np.sin(angle)
    rotation = np.array([[c, -s], [s, c]])
    (xx, xy, yy), (xxx, xxy, xyy, yyy) = values[3:6], values[6:]
    second = np.einsum("ia,jb,ab->ij", rotation, rotation, [[xx, xy], [xy, yy]])
    cubes = [[[xxx, xxy], [xxy, xyy]], [[xxy, xyy], [xyy, yyy]]]
    third = np.einsum("ia,jb,kc,abc->ijk", rotation, rotation, rotation, cubes)
    size = values[0] * scale ** (1 if feature.kind == "contour_moments" else 2)
    place = rotation @ values[1:3] * scale + shift
    return np.array([size, *place, *second[[0, 0, 1], [0, 1, 1]], *third[[0, 0, 0, 1], [0, 0, 1, 1], [0, 1, 1, 1]]])


MOVED = [pair for pair in PAIRS if "moments" not in str(pair.id) or pair.values[1]().order == 3]  # type: ignore[attr-defined]


class TestSymmetries:
    @pytest.mark.parametrize(("layout", "make"), MOVED)
    @settings(max_examples=10)
    @given(bends, angles, shifts, st.floats(0.5, 2))
    def test_moved_turned_and_scaled(self, layout, make, bend, angle, shift, scale):
        feature = make(frame="pixels", **({"max_curvature": 1e3} if make is Curvature else {}))
        points = drawn(layout, bend)
        if feature.kind == "orientation" and _ambiguous(points, feature, layout):
            return
        before = feature.compute(shape(points, layout), VIEW)
        after = feature.compute(shape(scale * turned(points, angle) + shift, layout), VIEW)
        np.testing.assert_allclose(after, transformed(feature, before, angle, shift, scale), atol=1e-3, rtol=1e-3)


def _ambiguous(points: np.ndarray, feature: Feature, layout: Topology) -> bool:
    """Return whether a principal axis, or its direction, depends on the last digit."""
    away = points - points.mean(axis=0)
    large, small = np.linalg.eigvalsh(away.T @ away)[::-1]
    heading = Orientation(frame="pixels").compute(shape(points, layout), VIEW)
    axis = Orientation(frame="pixels", axis="principal").compute(shape(points, layout), VIEW)
    return feature.to_dict()["axis"] == "principal" and (large < 1.1 * small or not heading @ axis > 0.05)


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
