"""Ropes under a hand: visible points keep their index, hidden ends keep their length and are flagged."""

from __future__ import annotations

import numpy as np
import pytest

from shape_obs import Centerline, ShapeDetector
from tests.benchmarks.hidden import track
from tests.benchmarks.scenes.hidden_ropes import Cover, hidden_rope, hidden_ropes
from tests.benchmarks.tables import Row


def test_the_hidden_end_is_not_stretched_over_the_rest():
    detector = None
    for frame in hidden_rope(np.random.default_rng(4), 4.0, 0.25, "end", frames=60):
        curve = frame.rope.curve
        if detector is None:
            detector = ShapeDetector([Centerline(n=20, ends="tips", anchor=tuple(curve[0]))])
        shape = detector.detect_mask(frame.mask).shapes[0]
        gaps = np.linalg.norm(np.diff(shape.points2d, axis=0), axis=1)
        assert gaps.sum() == pytest.approx(frame.rope.length, rel=0.03)
        if frame.share:
            assert 3 <= (~shape.visible).sum() <= 6
            assert not shape.visible[-3:].any()
            assert shape.visible[:14].all()
            assert shape.ok
            assert 0.6 < shape.quality < 0.85


def passed(seed: int, cover: Cover, approach: float, speed: float, *, depth: bool) -> Row:
    """Track a rope while something passes over it."""
    rng = np.random.default_rng([seed, round(2 * approach), round(speed)])
    return track(hidden_ropes(rng, cover, approach, speed, share=float(rng.uniform(0.15, 0.45))), depth=depth)


@pytest.mark.parametrize(
    ("seed", "cover", "depth"),
    [
        # Under a bar for long: were it deeper than what is seen, the visible points would lie too close together.
        (521, "bar", True),
        # Back in part after a long loss: its nodes are out of date, and nothing shows which end a hand still covers.
        (20, "hand", False),
    ],
)
def test_what_was_hidden_for_long_moves_no_visible_point(seed, cover, depth):
    row = passed(seed, cover, 1.0, 3.0, depth=depth)
    assert row.slips <= 2, row
    assert row.frames > 250


@pytest.mark.parametrize(("seed", "speed"), [(104, 0.0), (106, 3.0)])
def test_a_bar_that_comes_over_the_other_end_too_moves_no_point(seed, speed):
    """Both tips look cut then, and little is missing of the second one yet."""
    row = passed(seed, "bar", 4.0, speed, depth=False)
    assert row.slips == 0, row
    assert row.ok >= 0.8 * row.due


def test_an_end_that_leaves_while_a_bar_lies_over_the_middle_makes_no_gap_longer():
    row = passed(104, "bar", 1.0, 0.0, depth=False)
    assert row.slips <= 2, row


def test_a_gap_under_a_slow_bar_makes_no_rope_shorter():
    """Both tips are free for hundreds of frames, and the way under the bar is bridged straight."""
    row = passed(200, "bar", 0.5, 0.0, depth=True)
    assert row.slips == 0, row
    assert row.frames > 900


def test_a_tip_that_looks_like_the_ropes_own_shows_where_the_rope_lies():
    """Nothing of it was in sight for a while, and it was still refused when only one end was out of sight."""
    row = passed(102, "bar", 1.0, 0.0, depth=False)
    assert (row.slips, row.ok) == (0, row.due), row


def test_a_rope_that_came_back_in_a_wrong_place_is_put_right_by_its_own_tip():
    """It was out of sight for a while, and what came back first had no end: it was put 2 gaps from its place."""
    row = passed(6, "bar", 1.0, 0.0, depth=False)
    assert row.slips == 0, row
    assert row.ok >= 0.95 * row.due, row
