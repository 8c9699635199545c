"""Ropes that disappear for a while, in noise, on ragged masks, in uneven light, and bent narrowly."""

from __future__ import annotations

import numpy as np
import pytest

from shape_obs import Centerline, ShapeDetector
from shape_obs.bench.scenes import moving_rope
from tests.benchmarks.scores import score
from tests.scenes.ropes import random_rope


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


@pytest.mark.parametrize("kind", ["hairpin", "s", "omega", "waves", "spiral"])
@pytest.mark.parametrize("width", [4, 10])
def test_the_curve_is_faithful_however_narrow_its_bends_and_long_the_rope(kind, width):
    rope = random_rope(np.random.default_rng(2), kind, width=width)
    detector = ShapeDetector([Centerline(n=256, ends="tips")])
    for _ in range(3):
        shape = detector.detect_mask(rope.mask).shapes[0]
        assert not shape.reason
        found = score(shape.pixels, rope.curve, "tips", directed=False)
        assert found.ordered
        assert found.farthest < 0.5 * width
        assert found.slip < 2
