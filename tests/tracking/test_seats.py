"""Which object takes which slot."""

from __future__ import annotations

import numpy as np

from shape_obs.geometry.curve import FittedCurve
from shape_obs.initialization.objects import SceneObject
from shape_obs.tracking.seats import add_pieces, near_tracks, seat_others, seat_tracked


def rope(start, end):
    points = np.linspace(start, end, 40)
    return SceneObject(FittedCurve.through(points, np.zeros(len(points), bool)), 8.0)


HIGH, LOW, SLANT = rope((10, 10), (200, 10)), rope((10, 100), (150, 100)), rope((10, 60), (100, 80))
UNKNOWN = [np.inf] * 3


def test_objects_go_to_the_tracks_that_are_nearest_overall():
    tracks = [LOW.curve.points + 3, None, HIGH.curve.points[::-1] - 2]
    assert seat_tracked([HIGH, LOW, SLANT], tracks, [50, 50, 50], UNKNOWN) == [1, -1, 0]
    assert seat_tracked([HIGH, LOW, SLANT], tracks, [2, 50, 2], UNKNOWN) == [-1, -1, -1]
    assert seat_tracked([], tracks, [50, 50, 50], UNKNOWN) == [-1, -1, -1]
    assert seat_tracked([HIGH], [None, None], [50, 50], UNKNOWN) == [-1, -1]


def test_a_track_keeps_a_rope_of_which_a_part_is_hidden():
    part = rope((100, 12), (200, 12))
    assert seat_tracked([part, LOW], [HIGH.curve.points, LOW.curve.points], [40, 40], UNKNOWN) == [0, 1]


def test_a_track_that_was_lost_for_long_takes_no_rope_of_another_track():
    tracks = [HIGH.curve.points + (0, 8), HIGH.curve.points]  # the first one may be anywhere by now
    assert seat_tracked([HIGH, rope((10, 150), (60, 150))], tracks, [120, 20], UNKNOWN) == [-1, 0]
    assert seat_tracked([HIGH, LOW], tracks, [120, 20], UNKNOWN) == [1, 0]


def test_what_is_longer_than_a_rope_was_is_another_rope():
    tracks = [HIGH.curve.points + (0, 4), HIGH.curve.points + (0, 5)]
    assert seat_tracked([HIGH], tracks, [50, 50], UNKNOWN) == [0, -1]
    assert seat_tracked([HIGH], tracks, [50, 50], [150, 190]) == [-1, 0]
    assert seat_tracked([HIGH], tracks, [50, 50], [100, 100]) == [-1, -1]


def test_the_largest_take_free_slots_in_the_order_of_the_image():
    objects = [HIGH, LOW, SLANT]
    assert seat_others(objects, [-1, -1], [None, None], [0, 1], ()) == [0, 1]
    assert seat_others(objects[::-1], [-1, -1, -1], [None] * 3, [0, 1, 2], ()) == [2, 0, 1]
    assert seat_others(objects, [1, -1], [None, None], [1], ()) == [1, 0]
    assert seat_others(objects, [-1, -1], [None, None], [0, 1], {0}) == [2, 1]


def test_anchors_come_first():
    targets = [None, np.array([150.0, 100.0])]
    assert seat_others([HIGH, LOW, SLANT], [-1, -1], targets, [0, 1], ()) == [0, 1]
    targets = [np.array([11.0, 62.0]), np.array([12.0, 60.0])]
    assert seat_others([HIGH, SLANT], [-1, -1], targets, [0, 1], ()) in ([0, 1], [1, 0])


def test_pieces_go_to_the_rope_that_they_lie_on():
    piece, other, between = rope((160, 11), (190, 11)), rope((20, 101), (60, 101)), rope((20, 55), (60, 55))
    tracks = [HIGH.curve.points, LOW.curve.points]
    objects = [HIGH, LOW, piece, other, between]
    assert add_pieces(objects, [0, 1], tracks, 12.0) == [[0, 2], [1, 3]]
    assert add_pieces(objects, [-1, 1], tracks, 12.0) == [[0, 2], [1, 3]]


def test_what_lies_near_a_track_is_no_new_rope():
    assert near_tracks([HIGH, LOW, SLANT], [HIGH.curve.points + 4, None], 10.0) == {0}
