"""What speaks against the curves of several ropes."""

from __future__ import annotations

import numpy as np
import pytest

from shape_obs.geometry.curve import FittedCurve
from shape_obs.tracking.exchanges import exchange_gain, meetings
from shape_obs.tracking.scene_doubt import (
    changed_sides,
    doubtful_area,
    doubtful_turns,
    more_bent,
    nearest_distances,
    taken_over,
)

WIDTH = 8.0


def path(*corners, count=200):
    corners = np.array(corners, float)
    arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at = np.linspace(0, arc[-1], count)
    return np.stack([np.interp(at, arc, corners[:, d]) for d in (0, 1)], axis=1)


def curve(points, hidden=()):
    flags = np.zeros(len(points), bool)
    if hidden:
        flags[slice(*hidden)] = True
    return FittedCurve.through(np.ascontiguousarray(points), flags)


def circle(radius):
    angle = np.linspace(0, 1.5 * np.pi, 200)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1) + 200


def test_a_sharp_turn_is_counted_and_a_bend_is_not():
    assert doubtful_turns(curve(path((0, 0), (100, 0), (100, 100))), WIDTH) == 1
    assert doubtful_turns(curve(path((0, 0), (100, 0), (100, 60), (10, 60))), WIDTH) == 2
    assert doubtful_turns(curve(path((0, 0), (100, 0), (170, 70))), WIDTH) == 0
    assert doubtful_turns(curve(circle(2 * WIDTH)), WIDTH) == 0
    assert doubtful_turns(curve(circle(0.7 * WIDTH)), WIDTH) > 0


def test_what_was_not_seen_is_doubtful():
    straight = path((0, 0), (200, 0))
    assert doubtful_area(curve(straight), WIDTH) == 0
    assert doubtful_area(curve(straight, (100, 150)), WIDTH) == pytest.approx(50 * WIDTH, rel=0.05)
    assert doubtful_area(curve(path((0, 0), (100, 0), (100, 100))), WIDTH) == pytest.approx(3 * WIDTH**2)


def test_points_near_another_rope_are_taken_over():
    own, other = path((0, 0), (100, 0), count=10), path((0, 50), (100, 50), count=10)
    assert taken_over(path((0, 2), (100, 2)), own, [other], WIDTH) == 0
    assert taken_over(path((0, 48), (100, 48)), own, [other], WIDTH) == 1
    assert taken_over(path((0, 0), (100, 60)), own, [other], WIDTH) == pytest.approx(0.45, abs=0.1)
    assert taken_over(path((0, 48), (100, 48)), own, [], WIDTH) == 0


def test_distances_from_a_polyline():
    found = nearest_distances(np.array([[5.0, 3.0], [-3.0, 4.0], [10.0, 0.0]]), np.array([[0.0, 0.0], [10.0, 0.0]]))
    np.testing.assert_allclose(found, [3, 5, 0])


def test_sides_change_only_where_ropes_lie_side_by_side():
    left, right = path((0, 0), (0, 100), count=12), path((12, 0), (12, 100), count=12)
    assert changed_sides(left, right, left + (24, 0), right, WIDTH)
    assert not changed_sides(left, right, left + (3, 0), right, WIDTH)
    assert not changed_sides(left, right, left + (16, 0), right, WIDTH)  # it lies over the other one
    far = right + (80, 0)
    assert not changed_sides(left, far, left, far - (300, 0), WIDTH)
    beyond = path((12, 200), (12, 300), count=12)
    assert not changed_sides(left, beyond, left + (24, 0), beyond, WIDTH)


def test_bending_grows_with_a_kink():
    straight = path((0, 0), (200, 0), count=20)
    bent = path((0, 0), (100, 0), (170, 70), count=20)
    assert more_bent(bent, straight, WIDTH) > 0.1
    assert more_bent(straight, bent, WIDTH) == 0
    assert more_bent(straight, straight[:-1], WIDTH) == 0
    assert more_bent(bent + 5, bent, WIDTH) == pytest.approx(0, abs=1e-9)


def test_kinks_that_an_exchange_of_ends_would_take_away():
    first, second = curve(path((0, 0), (100, 50), (0, 100))), curve(path((200, 0), (106, 50), (200, 100)))
    assert exchange_gain(first, second, WIDTH) > 0.5
    straight = curve(path((0, 0), (100, 50), (200, 100))), curve(path((200, 0), (100, 50), (0, 100)))
    assert exchange_gain(*straight, WIDTH) == 0
    apart = curve(path((0, 0), (200, 0))), curve(path((0, 90), (200, 90)))
    assert exchange_gain(*apart, WIDTH) == 0
    ending = curve(path((0, 0), (100, 50))), second
    assert exchange_gain(*ending, WIDTH) == 0


def test_meetings_by_brute_force():
    rng = np.random.default_rng(5)
    found = 0
    for _ in range(40):
        first, second = (np.cumsum(rng.normal(0, 3, (int(rng.integers(1, 90)), 2)), axis=0) for _ in range(2))
        away = np.linalg.norm(first[:, None] - second[None], axis=2)
        near = np.concatenate([[0], away.min(axis=1) < 4.0, [0]])
        starts, stops = np.flatnonzero(np.diff(near) > 0), np.flatnonzero(np.diff(near) < 0)
        nearest = away.argmin(axis=1)
        expected = [(a, b - 1, nearest[a:b].min(), nearest[a:b].max()) for a, b in zip(starts, stops, strict=True)]
        np.testing.assert_array_equal(meetings(first, second, 4.0), np.reshape(expected, (-1, 4)))
        found += len(expected)
    assert found > 50
