"""Ropes under a hand, in noise, on ragged masks, in uneven light; `shape-obs bench claims` measures more of them."""

import numpy as np
import pytest

from shape_obs import Centerline, ShapeDetector
from shape_obs.bench.rope_claims import ropes_in_noise, ropes_under_hands
from shape_obs.bench.synthetic.images import hidden_rope
from shape_obs.bench.synthetic.ropes import moving_rope


@pytest.fixture(scope="module")
def under_hands():
    return list(ropes_under_hands(seeds=(50,), speeds=(10,)))


def test_both_ends_are_hidden_by_10_and_25_percent_at_once_and_slowly(under_hands):
    assert len(under_hands) == 8
    assert {(r.where, r.share, r.creep > 0) for r in under_hands} == {
        (where, share, slowly) for where in ("start", "end") for share in (0.1, 0.25) for slowly in (False, True)
    }
    assert all(result.frames == 180 for result in under_hands)


def test_visible_points_never_slip_under_a_hand(under_hands):
    for result in under_hands:
        assert (result.slips, result.lost) == (0, 0), result
        assert result.worst_slip < 0.5


def test_hidden_points_are_told(under_hands):
    for result in under_hands:
        assert result.called_hidden <= 0.005, result
        assert result.called_visible == 0, result


def test_a_hand_over_the_middle_keeps_both_ends_on_their_material():
    results = list(ropes_under_hands(seeds=(50, 51), speeds=(10,), shares=(0.1,), places=("middle",)))
    assert [(r.slips, r.lost) for r in results] == [(0, 0)] * 4


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


@pytest.mark.parametrize("speed", [10, 40])
def test_an_object_that_is_gone_for_a_while_comes_back_the_right_way_round(speed):
    detector = None
    for index, rope in enumerate(moving_rope(np.random.default_rng(9), speed, 60)):
        if detector is None:
            detector = ShapeDetector([Centerline(n=20, ends="tips", anchor=tuple(rope.curve[0]))], max_age=0.5)
        gone = index % 20 >= 14  # 6 frames at 30 frames a second: 0.2 s
        shape = detector.detect_mask(np.zeros_like(rope.mask) if gone else rope.mask).shapes[0]
        assert shape.ok
        assert bool(shape.reason) is gone
        if not gone:
            ends = np.linalg.norm(shape.points2d[[0, -1]] - rope.curve[[0, -1]], axis=1)
            assert ends.max() < 3


def test_order_is_right_in_noise_on_ragged_masks_and_in_uneven_light():
    results = list(ropes_in_noise(per_kind=4, seed=3))
    assert {result.disturbance.split(",")[0] for result in results} == {"salt and pepper", "ragged edges", "light"}
    for result in results:
        assert result.ordered >= 0.95, result
