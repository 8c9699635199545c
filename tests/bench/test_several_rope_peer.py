"""The peer that pairs branches by least bending finds what its paper says it finds."""

import numpy as np
import pytest

from tests.benchmarks.rope_scores import judge
from tests.benchmarks.scenes.several_ropes import several_ropes
from tests.benchmarks.several_rope_peer import is_installed, peer_ropes

pytestmark = pytest.mark.skipif(not is_installed(), reason="needs scikit-image and scikit-learn")


@pytest.mark.parametrize(("count", "crossings"), [(2, 0), (2, 1), (3, 3)])
def test_the_peer_finds_nearly_all_ropes_in_clean_masks(count, crossings):
    right = []
    for seed in range(8):
        rng = np.random.default_rng([seed, count, crossings])
        scene = several_ropes(rng, count, crossings, soft=0.6, ragged=0, specks=0, holes=0, smallest_angle=0.8)
        right += judge(peer_ropes(scene.mask), scene).right
    assert np.mean(right) >= 0.9


def test_the_peer_finds_nothing_in_an_empty_mask():
    assert peer_ropes(np.zeros((60, 80), np.uint8)) == []
