"""Ropes that disappear for a while, in noise, on ragged masks, in uneven light, and bent narrowly."""

from __future__ import annotations

import numpy as np
import pytest

from shape_obs import Centerline, ShapeDetector
from shape_obs.bench.scenes import moving_rope


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


def test_a_frame_that_shows_far_more_than_the_rope_is_refused_and_the_rope_found_again():
    """A skeleton of all of it would take longer than a control loop waits."""
    detector, comb = ShapeDetector([Centerline(n=20, ends="tips")]), np.zeros((480, 640), np.uint8)
    comb[::32], comb[:, :16] = 255, 255
    for row in range(16):
        comb[row::32] = 255
    masks = [rope.mask for rope in moving_rope(np.random.default_rng(9), 4.0, 20)]
    for mask in masks[:15]:
        assert not detector.detect_mask(mask).shapes[0].reason
    assert "times as many pixels as the rope" in detector.detect_mask(comb).shapes[0].reason
    for mask in masks[15:]:
        assert not detector.detect_mask(mask).shapes[0].reason
