"""`ends="centers"` gives cluster centres: as good as K-means', but ordered and equidistant."""

import numpy as np
import pytest
from sklearn.cluster import KMeans
from sklearn.metrics import calinski_harabasz_score

from shape_obs import Centerline, ShapeDetector
from tests.benchmarks.scenes.ropes import random_rope
from tests.benchmarks.scores import score


@pytest.mark.parametrize("kind", ["smooth", "u", "s", "loop"])
def test_centers_cluster_the_mask_as_well_as_kmeans(kind):
    rope = random_rope(np.random.default_rng(5), kind)
    pixels = np.argwhere(rope.mask)[:, ::-1].astype(float)
    ours = ShapeDetector([Centerline(n=20, ends="centers")]).detect_mask(rope.mask).shapes[0].points2d
    theirs = KMeans(20, n_init="auto", init="random", random_state=0).fit(pixels)
    nearest = np.argmin(((pixels[:, None] - ours[None]) ** 2).sum(axis=-1), axis=1)
    assert calinski_harabasz_score(pixels, nearest) >= 0.98 * calinski_harabasz_score(pixels, theirs.labels_)
    assert score(ours, rope.curve, "centers", directed=False).gap_cv <= 0.01
