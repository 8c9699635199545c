"""Silhouette and Calinski-Harabasz are scikit-learn's; spacing, distance, coverage and order against known truth."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as st_numpy

from shape_obs.geometry.topology import Chain, Grid, Ring
from shape_obs.metrics import calinski_harabasz, coverage, distance, in_order, silhouette, spacing_cv


def mask_pixels(mask: np.ndarray) -> np.ndarray:
    """Return the pixels (u, v) of a mask, ``(M, 2)``."""
    return np.argwhere(mask)[:, ::-1]


@st.composite
def clusterings(draw):
    """Return (M, D) points, many of them in one place, and (M,) labels with gaps in their numbers."""
    dimension = draw(st.integers(1, 3))
    count = draw(st.integers(4, 60))
    values = st.one_of(st.integers(-3, 3).map(float), st.floats(-1e3, 1e3).map(lambda x: round(x, 3)))
    points = draw(st_numpy.arrays(np.float64, (count, dimension), elements=values))
    labels = draw(st_numpy.arrays(np.int64, count, elements=st.sampled_from((-1, 0, 2, 7))))
    labels[:2] = (0, 2)
    return points, labels


@given(clusterings())
def test_scores_are_those_of_scikit_learn_on_anything(clustering):
    metrics = pytest.importorskip("sklearn.metrics")
    points, labels = clustering
    assert silhouette(points, labels) == pytest.approx(metrics.silhouette_score(points, labels), abs=1e-6)
    assert calinski_harabasz(points, labels) == pytest.approx(metrics.calinski_harabasz_score(points, labels), rel=1e-6)


@pytest.mark.parametrize("score", [silhouette, calinski_harabasz])
@pytest.mark.parametrize(
    ("points", "labels", "message"),
    [
        (np.zeros((5, 2)), np.zeros(5), "expected 2 clusters or more, and fewer than points; got 1 of 5"),
        (np.eye(4), np.arange(4), "got 4 of 4 points"),
        (np.zeros((4, 2)), np.zeros(3), r"expected points \(M, D\) and labels \(M,\), got \(4, 2\) and \(3,\)"),
    ],
)
def test_clusters_without_a_score_are_refused(score, points, labels, message):
    with pytest.raises(ValueError, match=message):
        score(points, labels)


class TestSpacing:
    def test_equal_gaps_vary_by_nothing(self):
        at = np.arange(5.0)
        assert spacing_cv(np.stack([3 * at, 4 * at], axis=1), Chain(5)) == pytest.approx(0)
        angle = 2 * np.pi * np.arange(12) / 12
        assert spacing_cv(np.stack([np.cos(angle), np.sin(angle)], axis=1), Ring(12)) == pytest.approx(0)
        grid = np.stack(np.meshgrid(np.arange(4.0) * 7, np.arange(3.0)), axis=-1).reshape(-1, 2)
        assert spacing_cv(grid, Grid(3, 4)) == pytest.approx(0), "rows and columns have separate gaps"

    @given(st.lists(st.floats(0.1, 10), min_size=2, max_size=20))
    def test_gaps_along_a_line_are_reported(self, gaps):
        points = np.stack([np.append(0, np.cumsum(gaps)), np.zeros(len(gaps) + 1)], axis=1)
        assert spacing_cv(points, Chain(len(points))) == pytest.approx(np.std(gaps) / np.mean(gaps), abs=1e-9)


class TestDistance:
    def test_it_is_to_the_line_not_to_its_points(self):
        corner = np.array([[0.0, 0], [10, 0], [10, 10]])
        np.testing.assert_allclose(distance([[5, 3], [12, 5], [0, 10], [-3, -4]], corner), [3, 2, 10, 5])
        assert distance([[0, 10]], corner, closed=True) == pytest.approx(50**0.5)


class TestCoverage:
    def test_a_rope_is_covered_by_its_axis(self, wave):
        pixels, reach = mask_pixels(wave.mask), wave.width / 2 + 1
        axis = wave.curve[:: len(wave.curve) // 60]
        assert coverage(np.concatenate([axis, wave.curve[-1:]]), Chain(len(axis) + 1), pixels, reach) == 1
        half = wave.curve[: len(wave.curve) // 2 : 4]
        assert coverage(half, Chain(len(half)), pixels, reach) == pytest.approx(0.5, abs=0.03)

    @pytest.mark.parametrize("height", [None, 0.0, 0.4])
    def test_a_lattice_covers_its_cells(self, height):
        lattice = np.stack(np.meshgrid(np.arange(5.0) * 4, np.arange(3.0) * 4), axis=-1).reshape(-1, 2)
        pixels = np.stack(np.meshgrid(np.arange(0.5, 24), np.arange(0.5, 8)), axis=-1).reshape(-1, 2)
        if height is not None:
            lattice, pixels = (np.insert(xy, 2, z, axis=1) for xy, z in ((lattice, 0.0), (pixels, height)))
        assert coverage(lattice, Grid(3, 5), pixels, 0.45) == pytest.approx(16 / 24)
        if height:
            assert coverage(lattice, Grid(3, 5), pixels, 0.3) == 0


class TestOrder:
    @settings(max_examples=50)
    @given(st.lists(st.integers(0, 359), min_size=3, max_size=12, unique=True), st.integers(0, 11))
    def test_around_a_ring_anywhere_may_be_the_first(self, places, begin):
        turned = np.roll(sorted(places), begin).astype(float)
        assert in_order(turned, period=360)
        assert not in_order(turned[::-1], period=360)
