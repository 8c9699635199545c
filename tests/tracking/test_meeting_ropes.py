"""Where ropes meet and on which side of each other they lie, against brute force."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from shape_obs.geometry.polyline import nearest_on
from shape_obs.tracking.exchanges import meetings
from shape_obs.tracking.scene_doubt import sides_of


def _walk(seed, count):
    """Return a smooth random curve of uneven steps: ``(count, 2)`` pixels."""
    rng = np.random.default_rng(seed)
    heading = np.cumsum(rng.normal(0, 0.15, count)) + rng.uniform(0, 6)
    step = rng.uniform(0.5, 4, count)[:, None]
    return np.cumsum(step * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0) + rng.uniform(0, 60, 2)


@pytest.mark.parametrize("seed", range(20))
def test_meetings_are_the_stretches_nearer_than_a_distance(seed):
    points, other, near = _walk(seed, 150), _walk(seed + 100, 130), 9.0
    distance = cdist(points, other)
    meets = np.flatnonzero(distance.min(axis=1) < near)
    stretches = [each for each in np.split(meets, np.flatnonzero(np.diff(meets) > 1) + 1) if len(each)]
    nearest = [distance[each].argmin(axis=1) for each in stretches]
    expected = [[each[0], each[-1], at.min(), at.max()] for each, at in zip(stretches, nearest, strict=True)]
    assert meetings(points, other, near).tolist() == expected


def test_some_of_these_curves_meet():
    assert sum(len(meetings(_walk(seed, 150), _walk(seed + 100, 130), 9.0)) for seed in range(20)) > 10


@pytest.mark.parametrize("seed", range(5))
def test_distances_are_those_from_the_nearest_piece(seed):
    points, curve = _walk(seed, 60), _walk(seed + 50, 40)
    assert sides_of(points, curve)[0] == pytest.approx(nearest_on(curve, points)[1])


def test_a_point_lies_to_the_left_or_to_the_right_or_beyond_an_end():
    curve = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]])  # to the right, then down
    places = np.array([[5.0, -2.0], [5.0, 2.0], [12.0, 5.0], [8.0, 5.0], [-1.0, 1.0], [9.0, 11.0]])
    assert sides_of(places, curve)[1].tolist() == [-1, 1, -1, 1, 0, 0]
