"""Ropes that lay over each other are known again by how they are bent and how long they are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shape_obs.geometry.curve import Length
from shape_obs.geometry.topology import Chain
from shape_obs.slots.passages import Lying, Passages, better, change_of_headings, moved
from shape_obs.tracking.prediction import Track

WIDTH = 8.0


def bent(much, middle, *, count=20, length=200.0):
    """Return a rope whose heading turns by ``much`` from end to end."""
    heading = np.linspace(-much / 2, much / 2, count - 1)
    steps = length / (count - 1) * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    points = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return np.ascontiguousarray(points - points.mean(axis=0) + middle)


def lying(nodes, visible=0.0, known=200.0):
    return Lying(nodes, nodes, visible, Length(known, 0.0, 0.002, 0.0, 50.0, 0.0))


def after(before, over, frames=5):
    """Return passages that saw two ropes first as they were, then as they lay over or next to each other."""
    passages = Passages()
    passages.add(before, WIDTH)
    for _ in range(frames):
        passages.add(over, WIDTH)
    return passages


@given(much=st.floats(-3, 3), other=st.floats(-3, 3), turn=st.floats(-6, 6), count=st.integers(12, 40))
def test_bends_are_compared_whatever_the_place_the_rotation_and_the_number_of_nodes(much, other, turn, count):
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    one, second = bent(much, (0, 0)), bent(other, (0, 0), count=count)
    change = change_of_headings(np.ascontiguousarray(second @ rotation + (40, 90)), one)
    # The difference of two headings that turn evenly is a ramp: its RMS is the range over the root of 12.
    assert change == pytest.approx(
        abs(much - other) / np.sqrt(12), abs=0.04 * (1 + abs(much - other)) * max(abs(much), abs(other), 0.1)
    )
    assert change_of_headings(one, one) == 0


def test_ropes_that_are_bent_as_each_other_was_are_doubtful():
    bow, straight = bent(1.5, (100, 100)), bent(0.0, (100, 140))
    passages = after([lying(bow), lying(straight)], [lying(straight), lying(straight + 2)])
    assert not passages.doubtful([lying(bow + 5), lying(straight)])
    ropes = [lying(straight), lying(bow + 5)]
    doubtful = passages.doubtful(ropes)
    assert list(doubtful) == [(0, 1)]
    assert passages.strangeness(ropes[::-1], (0, 1)) < 0.1 < doubtful[0, 1]
    passages.refuse((0, 1), doubtful[0, 1])
    assert not passages.doubtful(ropes)  # nothing new


def test_ropes_that_lay_next_to_each_other_may_bend_alike_but_grow_no_longer():
    bow, straight = bent(1.5, (100, 100)), bent(0.0, (100, 140))
    touching = [lying(straight), lying(straight + (0, WIDTH))]
    passages = after([lying(bow, 200, 200), lying(straight, 180, 180)], touching)
    assert not passages.doubtful([lying(straight, 200), lying(bow, 180)])
    assert not passages.doubtful([lying(bow, 150), lying(straight, 120)])  # something hides a part of them
    assert passages.doubtful([lying(bow, 180), lying(straight, 200)])
    assert not passages.doubtful([lying(bow), lying(straight)])  # where they meet, no length is certain


def test_ropes_that_never_met_and_those_that_parted_long_ago_are_not_in_doubt():
    bow, straight = bent(1.5, (100, 100)), bent(0.0, (100, 300))
    apart = [lying(bow), lying(straight)]
    assert not after(apart, apart).doubtful([lying(straight), lying(bow)])
    passages = after(apart, [lying(straight), lying(straight + 2)])
    for _ in range(6):
        passages.add(apart, WIDTH)
    assert not passages.doubtful([lying(straight), lying(bow)])
    passages = after(apart, [lying(straight), None])
    assert not passages.doubtful([lying(straight), None])


def test_an_exchange_has_to_explain_what_is_strange_and_to_fit():
    assert better(1.0, 0.0, 20.0, 3.0)
    assert better(1.0, 2.0, 20.0, 0.0)
    assert not better(1.0, 6.0, 20.0, 40.0)  # another fit that is doubtful is no evidence
    assert not better(15.0, 0.0, 20.0, 3.0)
    assert not better(1.0, 4.9, 8.0, 0.0)


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("back", [False, True])
def test_a_rope_keeps_its_bends_where_another_one_lies(dimensions, back):
    bow = np.pad(bent(1.5, (100, 100)), ((0, 0), (0, dimensions - 2)))
    place = np.pad(bent(0.3, (300, 50), count=15), ((0, 0), (0, dimensions - 2)))
    place = place[::-1].copy() if back else place
    velocity = np.ones_like(place)
    own = Track(bow + 7, np.zeros_like(bow), 0.1, 200, 0.0, Chain(len(bow)))
    track = moved(own, Track(place, velocity, 0.1, 200, 0.0, Chain(len(place))), Lying(bow, bow[:, :2], 0, Length()))
    assert change_of_headings(np.ascontiguousarray(track.nodes[:, :2]), bow[:, :2].copy()) < 1e-6
    np.testing.assert_allclose(track.nodes.mean(axis=0), place.mean(axis=0), atol=2)
    assert (track.nodes[-1] - track.nodes[0]) @ (bow[-1] - bow[0]) > 0  # not turned round
    np.testing.assert_allclose(track.velocity, 1)
