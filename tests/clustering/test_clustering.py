"""The centres of every clusterer, in order along the shape."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shape_obs import Centerline, Contour, ShapeDetector, Surface
from shape_obs.bench.scenes import Sheet, draw_sheet, moving_blob, moving_rope
from shape_obs.clustering.base import Clusterer
from shape_obs.clustering.fcm import FuzzyCMeans
from shape_obs.clustering.gmm import GaussianMixture
from shape_obs.clustering.kmeans import KMeans
from shape_obs.clustering.kohonen import Kohonen
from shape_obs.geometry.observed import Samples
from shape_obs.geometry.topology import Chain
from shape_obs.metrics import calinski_harabasz, distance, nearest, spacing_cv
from tests.benchmarks.scores import outline_score, score, score_sheet
from tests.scenes.blobs import random_blob
from tests.scenes.clouds import ring_cloud, rope_cloud, sheet_cloud
from tests.scenes.ropes import random_rope
from tests.scenes.sheets import random_sheet

NAMES = ("kmeans", "gmm", "fcm", "kohonen")
ALL: tuple[Clusterer, ...] = (KMeans(), GaussianMixture(), FuzzyCMeans(), Kohonen())
IDS: Any = lambda clusterer: clusterer.kind  # noqa: E731


def mask_pixels(mask: np.ndarray) -> np.ndarray:
    return np.argwhere(mask)[:, ::-1]


def counted(points: np.ndarray) -> Samples:
    return Samples(np.asarray(points, dtype=np.float64), np.ones(len(points)), 1.0)


def small_sheet(degrees: float) -> Sheet:
    """Return a cloth of 2 : 1 in 256 x 192 pixels."""
    return draw_sheet(0.4 * random_sheet(np.random.default_rng(0), 2.0, degrees).points, (192, 256))


@pytest.fixture(scope="module")
def blobs() -> np.ndarray:
    """Return five round heaps of samples in a row, 200 each."""
    rng = np.random.default_rng(0)
    return np.concatenate([rng.normal((100.0 * k, 50), 4, (200, 2)) for k in range(5)])


class TestCentres:
    @pytest.mark.parametrize("clusterer", [KMeans(), GaussianMixture(), FuzzyCMeans()], ids=IDS)
    def test_heaps_are_found(self, clusterer, blobs):
        found = clusterer.centres(counted(blobs), Chain(5), 0)
        expected = blobs.reshape(5, 200, 2).mean(axis=1)
        places = found.places[np.argsort(found.places[:, 0])]
        np.testing.assert_allclose(places, expected, atol=0.2)
        assert found.settled
        assert found.steps >= 1

    @pytest.mark.parametrize("clusterer", ALL, ids=IDS)
    @settings(max_examples=5)
    @given(seed=st.integers(0, 2**31), dimension=st.integers(2, 3))
    def test_equal_seeds_give_equal_centres_in_any_unit(self, clusterer, seed, dimension):
        points = np.random.default_rng(seed).uniform(0, 100, (300, dimension))
        found = clusterer.centres(counted(points), Chain(7), seed).places
        np.testing.assert_array_equal(clusterer.centres(counted(points), Chain(7), seed).places, found)
        metres = clusterer.centres(counted(points / 1000 + 2), Chain(7), seed).places
        np.testing.assert_allclose((metres - 2) * 1000, found, atol=1e-3)
        assert found.shape == (7, dimension)
        assert found.min() >= points.min()
        assert found.max() <= points.max()

    def test_fuzzy_c_means_rests_where_bezdek_says(self, blobs):
        places = FuzzyCMeans(tolerance=1e-6, max_iter=1000).centres(counted(blobs), Chain(5), 0).places
        square = np.sum((blobs[:, None] - places) ** 2, axis=2)
        share = (1 / square) / (1 / square).sum(axis=1, keepdims=True)
        np.testing.assert_allclose((share**2).T @ blobs / (share**2).sum(axis=0)[:, None], places, atol=1e-3)

    def test_samples_in_one_place_are_no_error(self):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            for clusterer in ALL:
                found = clusterer.centres(counted(np.tile([[3.0, 4.0], [5.0, 4.0]], (20, 1))), Chain(6), 0)
                assert np.all(np.isfinite(found.places)), clusterer


@pytest.mark.parametrize("clustering", NAMES)
class TestShapes:
    def test_a_ropes_centres_run_along_it(self, clustering, wave):
        shape = ShapeDetector([Centerline(n=12)], clustering=clustering).detect_mask(wave.mask).shapes[0]
        judged = score(shape.pixels, wave.curve, "centers")
        assert shape.ok
        assert shape.visible.all()
        assert (judged.ordered, judged.flipped) == (True, False)
        assert judged.distance < 2.0
        pixels = mask_pixels(wave.mask)
        even = ShapeDetector([Centerline(n=12)]).detect_mask(wave.mask).shapes[0].pixels
        ours, equal = (calinski_harabasz(pixels, nearest(pixels, places)) for places in (shape.pixels, even))
        assert ours > 0.8 * equal
        assert spacing_cv(shape.pixels, shape.layout) > 0.01, "they are the clusterer's, not ours"

    def test_an_outlines_centres_run_around_it(self, clustering):
        blob = random_blob(np.random.default_rng(1))
        shape = ShapeDetector([Contour(n=24)], clustering=clustering).detect_mask(blob.mask).shapes[0]
        judged = outline_score(shape.pixels, blob.outline)
        even = ShapeDetector([Contour(n=24)]).detect_mask(blob.mask).shapes[0].pixels
        assert judged.ordered
        assert judged.clockwise
        assert judged.distance < 3
        gap = np.linalg.norm(np.diff(even, axis=0), axis=1).mean()
        assert np.linalg.norm(shape.pixels[0] - even[0]) < 1.2 * gap, "it begins where ours does"

    def test_a_sheets_centres_keep_near_their_places(self, clustering):
        sheet = small_sheet(10.0)
        shape = ShapeDetector([Surface(rows=3, cols=6)], clustering=clustering).detect_mask(sheet.mask).shapes[0]
        assert score_sheet(shape.pixels, sheet, 3, 6, "centers", 0).slip < 1.2
        assert shape.visible.all()

    def test_indices_follow_the_track(self, clustering):
        detector = ShapeDetector([Centerline(n=10)], clustering=clustering)
        first = None
        for rope in moving_rope(np.random.default_rng(4), 12, 25, length=200, width=9):
            shape = detector.detect_mask(rope.mask).shapes[0]
            judged = score(shape.pixels, rope.curve, "centers")
            first = judged.flipped if first is None else first
            assert (judged.ordered, judged.flipped) == (True, first)

    def test_depth_lifts_the_centres(self, clustering, wave, intrinsics):
        depth = np.full(wave.mask.shape, 0.8, np.float32)
        depth[:, :80] = 0
        detector = ShapeDetector([Centerline(n=12)], clustering=clustering)
        shape: Any = detector.detect_mask(wave.mask, depth, intrinsics).shapes[0]
        assert not shape.valid[0]
        assert shape.valid[3:].all()
        assert shape.visible.all()
        np.testing.assert_allclose(shape.points3d[shape.valid, 2], 0.8)
        back = intrinsics.project(shape.points3d[shape.valid].astype(float))
        np.testing.assert_allclose(back, shape.pixels[shape.valid], atol=0.01)

    def test_clouds_are_clustered_point_by_point(self, clustering):
        rng = np.random.default_rng(0)
        rope, ring, sheet = rope_cloud(rng, count=1500), ring_cloud(rng, count=1500), sheet_cloud(rng, count=1500)
        for cloud, spec in ((rope, Centerline(n=12)), (ring, Contour(n=16)), (sheet, Surface(rows=3, cols=4))):
            shape: Any = ShapeDetector([spec], clustering=clustering).detect_cloud(cloud.points).shapes[0]
            assert shape.ok
            assert shape.points2d is None
            if spec.kind == "centerline":
                assert score(shape.points3d, rope.curve, "centers", directed=False).ordered
            if spec.kind == "contour":
                assert distance(shape.points3d, ring.curve, closed=True).max() < 0.02

    def test_fewer_pixels_than_points_are_reported(self, clustering):
        mask = np.zeros((60, 120), np.uint8)
        mask[30:34, 10:110] = 255
        shape = ShapeDetector([Centerline(n=500)], clustering=clustering).detect_mask(mask).shapes[0]
        assert not shape.ok
        assert shape.reason == "the mask has 400 pixels to cluster, 500 points need as many"


def test_a_centre_that_passes_the_start_of_a_ring_takes_no_index_with_it():
    detector = ShapeDetector([Contour(n=16)], clustering="kmeans")
    before, moved = None, []
    for blob in moving_blob(np.random.default_rng(0), turn=0.03, frames=30):
        points = detector.detect_mask(blob.mask).shapes[0].pixels.astype(float)
        if before is not None:
            gap = np.linalg.norm(np.diff(points, axis=0), axis=1).mean()
            moved.append(np.linalg.norm(points - before, axis=1).mean() / gap)
        before = points
    assert np.median(moved) < 0.4
    assert np.mean(np.array(moved) > 0.9) < 0.1


@pytest.mark.parametrize("kind", ["smooth", "u", "s", "loop"])
def test_centers_cluster_the_mask_as_well_as_kmeans(kind):
    from sklearn.cluster import KMeans as TheirKMeans

    rope = random_rope(np.random.default_rng(5), kind)
    pixels = np.argwhere(rope.mask)[:, ::-1].astype(float)
    ours = ShapeDetector([Centerline(n=20, ends="centers")]).detect_mask(rope.mask).shapes[0].points2d
    theirs = TheirKMeans(20, n_init="auto", init="random", random_state=0).fit(pixels)
    expected = calinski_harabasz(pixels, np.asarray(theirs.labels_))
    assert calinski_harabasz(pixels, nearest(pixels, ours)) >= 0.98 * expected
    assert score(ours, rope.curve, "centers", directed=False).gap_cv <= 0.01
