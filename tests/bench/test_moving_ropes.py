"""Moving ropes keep their material points, their length and their speed, and do what their kind says."""

from itertools import pairwise

import cv2
import numpy as np
import pytest
from scipy.spatial.distance import cdist

from tests.benchmarks.scenes.layouts import intersections
from tests.benchmarks.scenes.moving_ropes import MOTIONS, moving_ropes

FASTEST = 15.0


@pytest.fixture(scope="module")
def runs():
    return {kind: list(moving_ropes(np.random.default_rng(5), kind=kind, fastest=FASTEST)) for kind in MOTIONS}


@pytest.mark.parametrize("kind", MOTIONS)
def test_points_are_material_and_not_too_fast(runs, kind):
    moments = runs[kind]
    assert len(moments) == 180
    speeds = []
    for before, after in pairwise(moments):
        speeds.append(
            max(np.linalg.norm(a - b, axis=1).max() for a, b in zip(before.curves, after.curves, strict=True))
        )
    assert max(speeds) <= FASTEST
    assert speeds[0] < 3
    assert min(speeds) < 0.1
    for moment in moments[::20]:
        for curve in moment.curves:
            assert abs(np.linalg.norm(np.diff(curve, axis=0), axis=1) - 1).max() < 0.01


@pytest.mark.parametrize("kind", MOTIONS)
def test_the_mask_shows_what_is_visible(runs, kind):
    for moment in runs[kind][::12]:
        assert not moment.mask[moment.hand].any()
        for curve, visible in zip(moment.curves, moment.visible, strict=True):
            at = np.round(curve[visible]).astype(int)
            assert (moment.mask[at[:, 1], at[:, 0]] == 0).sum() <= 2


def crossings(moment):
    pairs = [(0, 1), (0, 2), (1, 2)]
    return [len(intersections(moment.curves[i], moment.curves[j])) for i, j in pairs]


def test_ropes_cross_and_part_again(runs):
    many = np.array([sum(crossings(moment)) for moment in runs["crossing"][::3]])
    assert many[0] == 0
    first = int(np.argmax(many > 0))
    assert many.max() >= 1
    assert (many[first:] == 0).any()


def test_ropes_touch_and_part_without_overlap(runs):
    moments = runs["touching"][::3]
    gaps = []
    for moment in moments:
        distances = [cdist(moment.curves[i], moment.curves[j]).min() for i, j in ((0, 1), (0, 2), (1, 2))]
        gaps.append(min(distances) / moment.widths[0])
    gaps = np.array(gaps)
    pieces = [cv2.connectedComponents(moment.mask)[0] - 1 for moment in moments]
    assert gaps.min() > 0.85
    assert min(pieces) == 2
    assert max(pieces) == 3
    assert gaps[0] > 2


@pytest.mark.parametrize("kind", ["slow hand", "fast hand"])
def test_a_hand_hides_ropes_and_goes(runs, kind):
    shares = np.array([[visible.mean() for visible in moment.visible] for moment in runs[kind]])
    assert (shares[0] == 1).all()
    assert shares.min() < 0.5


def test_a_rope_leaves_and_comes_back_and_another_enters(runs):
    shares = np.array([[visible.mean() for visible in moment.visible] for moment in runs["leaving"]])
    assert any((share[0] == 1) and share.min() == 0 and share[-1] > 0 for share in shares.T)
    assert any((share[0] == 0) and share.max() == 1 for share in shares.T)


def test_pictures_are_drawn_on_request():
    moment = next(moving_ropes(np.random.default_rng(0), count=2, frames=1, size=(240, 320), pictures=True))
    assert moment.rgb is not None
    assert moment.rgb.shape == (240, 320, 3)
