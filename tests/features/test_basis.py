"""Fourier, elliptic Fourier, Bezier and B-spline: closed forms, moved shapes, missing points, recorded shapes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import interpolate

from shape_obs import Feature, Shape, SpecError
from shape_obs.features import Bezier, BSpline, EllipticFourier, FeatureContext, Fourier
from shape_obs.geometry.topology import Chain, Grid, Ring, Topology

VIEW = FeatureContext(160, 120)
ROPE, OUTLINE, SHEET = Chain(20), Ring(32), Grid(4, 8)
FITS: list[tuple[Any, Topology]] = [
    (Fourier(), ROPE),
    (Bezier(), ROPE),
    (BSpline(), ROPE),
    (EllipticFourier(), OUTLINE),
    (BSpline(), OUTLINE),
    (Fourier(), SHEET),
    (Bezier(degree=3), SHEET),
    (BSpline(coefficients=5), SHEET),
]
each_fit = pytest.mark.parametrize(("feature", "layout"), FITS, ids=lambda value: getattr(value, "kind", repr(value)))
seeds = st.integers(0, 2**32 - 1)


def shape(points: Any, layout: Topology, known: Any = None) -> Shape:
    known = np.ones(layout.size, bool) if known is None else np.asarray(known)
    return Shape("it", np.zeros((layout.size, 2), np.float32), np.asarray(points, np.float32), known, known, layout)


def fit(feature: Any, points: Any, layout: Topology, known: Any = None) -> np.ndarray:
    """Return the coefficients, (K, 3)."""
    return feature.compute(shape(points, layout, known), VIEW).reshape(-1, 3)


def rebuilt(feature: Any, points: Any, layout: Topology, known: Any = None) -> np.ndarray:
    """Return the points that the coefficients describe, (N, 3)."""
    return feature.reconstruct(fit(feature, points, layout, known), layout, VIEW)


def draw(layout: Topology, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return irregular points, a fifth of them unknown."""
    rng = np.random.default_rng(seed)
    points, known = rng.uniform(-0.3, 0.3, (layout.size, 3)), rng.permutation(layout.size) >= layout.size // 5
    points[~known & (rng.random(layout.size) < 0.5)] = np.nan
    return points, known


class TestClosedForms:
    @pytest.mark.parametrize("axes", [(0.2, 0.2), (0.3, 0.1)], ids=["circle", "ellipse"])
    def test_an_ellipse_is_its_centre_and_half_axes_alone(self, axes):
        angle, turn = 2 * np.pi * np.arange(32) / 32, np.array([[0.8, -0.6], [0.6, 0.8]])
        ellipse = np.full((32, 3), 0.7)
        ellipse[:, :2] = [0.1, -0.3] + (np.stack([np.cos(angle), np.sin(angle)], axis=1) * axes) @ turn.T
        expected = np.zeros((9, 3))
        expected[0], expected[1:3, :2] = [0.1, -0.3, 0.7], np.diag(axes) @ turn.T
        np.testing.assert_allclose(fit(EllipticFourier(), ellipse, OUTLINE), expected, atol=1e-6)

    @pytest.mark.parametrize("feature", [Bezier(degree=1), Bezier(), BSpline(), BSpline(coefficients=5, degree=2)])
    def test_a_straight_line_is_kept_exactly(self, feature):
        line = np.linspace([0.1, 0.2, 0.5], [0.5, -0.1, 0.7], 20)
        assert feature.error(shape(line, ROPE), VIEW) < 1e-7
        ends = fit(feature, line, ROPE)[[0, -1]]
        np.testing.assert_allclose(ends, line[[0, -1]], atol=1e-6)
        np.testing.assert_allclose(rebuilt(feature, line, ROPE, np.arange(20) < 13), line, atol=1e-4)

    @given(seeds)
    def test_a_spline_gives_its_own_control_points_back(self, seed):
        control, place = np.random.default_rng(seed).uniform(-1, 1, (8, 3)), np.linspace(0, 1, 20)
        knots = np.array([0, 0, 0, 0, 2, 3, 4, 5, 7, 7, 7, 7]) / 7
        cases = [
            (BSpline(), ROPE, control, interpolate.BSpline(knots, control, 3)(place)),
            (Bezier(degree=5), ROPE, control[:6], interpolate.BPoly(control[:6, None], [0, 1])(place)),
        ]
        turn = np.arange(-3, 12.0)
        closed = interpolate.BSpline(turn, np.concatenate([control, control[:3]]), 3)
        cases.append((BSpline(), OUTLINE, control, closed(np.arange(32) / 4)))
        for feature, layout, expected, points in cases:
            np.testing.assert_allclose(fit(feature, points, layout), expected, atol=3e-5)


class TestMoved:
    """The effect of moving a shape on its coefficients, with a fifth of the points missing."""

    @each_fit
    @given(seed=seeds)
    def test_moving_shifts_and_turning_turns(self, feature, layout, seed):
        points, known = draw(layout, seed)
        rng = np.random.default_rng(seed)
        turn, shift, scale = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.uniform(-1, 1, 3), rng.uniform(0.5, 2)
        before = fit(feature, points, layout, known)
        after = fit(feature, scale * points @ turn.T + shift, layout, known)
        ones = fit(feature, np.ones((layout.size, 3)), layout)[:, :1]
        np.testing.assert_allclose(after, scale * before @ turn.T + ones * shift, atol=2e-4)
        harmonic = isinstance(feature, (Fourier, EllipticFourier))
        np.testing.assert_allclose(ones[:, 0], np.eye(len(ones))[0] if harmonic else 1.0, atol=1e-5)


class TestMissing:
    @each_fit
    @given(seed=seeds)
    def test_two_points_are_enough_for_finite_values_one_is_not(self, feature, layout, seed):
        rng = np.random.default_rng(seed)
        points, order = rng.uniform(-0.3, 0.3, (layout.size, 3)), rng.permutation(layout.size)
        for known, finite in ((2, True), (1, False)):
            points[order[known:]] = np.nan
            values = fit(feature, points, layout, ~np.isnan(points[:, 0]))
            assert (np.isfinite(values) == finite).all()


@each_fit
@given(seed=seeds)
def test_no_points_in_view_leave_the_bounds(feature, layout, overhead, seed):
    view = FeatureContext(320, 240, overhead)
    low, high = feature.bounds(layout, view)
    assert np.isfinite([low, high]).all()
    assert (low < high).all()
    rng = np.random.default_rng(seed)
    corners = rng.choice([0, 1], (layout.size, 3)) if rng.random() < 0.5 else rng.random((layout.size, 3))
    points = overhead.intrinsics.deproject(corners[:, :2] * [319, 239], 2 * corners[:, 2])
    values = feature.compute(shape(points, layout), view)
    assert feature.units(layout, view) == len(values) * ("m",)
    slack = 1e-5 * (high - low)
    assert (values >= low - slack).all()
    assert (values <= high + slack).all()


@pytest.mark.parametrize(
    ("feature", "layout", "message"),
    [
        (Fourier(), OUTLINE, "'fourier' is for open curves, but the shape is a ring: use 'elliptic_fourier'"),
        (EllipticFourier(), ROPE, r"'elliptic_fourier' is for rings, got Chain\(count=20\): use 'fourier'"),
        (Fourier(harmonics=4), Chain(8), "'fourier' has 9 functions here, but the shape has 8 points: use fewer"),
        (Fourier(), Grid(2, 3), r"at least 9 points on a lattice, got Grid\(rows=2, cols=3\): use more points"),
    ],
)
def test_what_a_layout_does_not_have_raises_an_error(feature, layout, message):
    with pytest.raises(ValueError, match=message):
        feature.compute(shape(np.zeros((layout.size, 3)), layout), VIEW)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ({"kind": "fourier", "harmonics": 0}, "fourier: needs at least 1 harmonic, got 0"),
        ({"kind": "bezier", "degree": 0}, "bezier: needs a degree of at least 1, got 0"),
        ({"kind": "bspline", "coefficients": 3}, "more coefficients than that, got degree=3 and coefficients=3"),
    ],
)
def test_numbers_that_make_no_basis_raise_an_error(spec, message):
    with pytest.raises(SpecError, match=message):
        Feature.from_dict(spec)
