"""The ends of a chain of nodes, lengthened to the tips of a drawn rope."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shape_obs.bench.scenes import draw_rope
from shape_obs.image.rope_tip import extend_chain

SIZE, FINE = 400, 4  # pixels; cv2 draws at a fraction 1 / 2**FINE of a pixel
LEFT, TOP = 30, -20  # of the mask in the image


def rope(bend, width, length=220.0, turn=0.3):
    """Return the axis of a rope in image pixels, and its mask, whose tips are round."""
    heading = turn + bend * np.linspace(-0.5, 0.5, 221)
    axis = np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0) * length / 220
    axis += SIZE / 2 - axis.mean(axis=0)
    mask = np.zeros((SIZE, SIZE), np.uint8)
    cv2.polylines(mask, [np.rint(axis * 2**FINE).astype(np.int32)], False, 1, width, shift=FINE)
    return axis + (LEFT, TOP), mask


def extended(nodes, mask, width):
    return extend_chain(np.ascontiguousarray(nodes), mask, LEFT, TOP, width)


def off_axis(points, axis):
    return np.linalg.norm(points[:, None] - axis, axis=2).min(axis=1)


@given(bend=st.floats(-2, 2), width=st.integers(4, 20), turn=st.floats(0, 6.28), short=st.floats(0.2, 3.5))
def test_a_chain_that_is_too_short_ends_on_the_tips(bend, width, turn, short):
    axis, mask = rope(bend, width, turn=turn)
    cut = int(short * width)
    nodes = axis[cut : len(axis) - cut : width]
    nodes = nodes if len(nodes) >= 3 else axis[[90, 110, 130]]
    chain = extended(nodes, mask, float(width))
    begin = np.flatnonzero((chain == nodes[0]).all(axis=1))[0]
    np.testing.assert_array_equal(chain[begin : begin + len(nodes)], nodes)  # what was known stays
    out = axis[[0, -1]] - axis[[1, -2]]
    ahead = np.arange(1, width / 2 + 1e-9, 0.5) * (out / np.linalg.norm(out, axis=1, keepdims=True))[..., None]
    head, tail = axis[[0, -1]][:, None] + ahead.swapaxes(1, 2)  # the axis within the round tips
    assert np.linalg.norm(chain[[0, -1]] - [head[-1], tail[-1]], axis=1).max() < 0.2 * width + 2
    assert off_axis(chain, np.concatenate([head, axis, tail])).max() < 0.1 * width + 2


@pytest.mark.parametrize(("bend", "turn", "short"), [(0.105, 3.202, 1.3), (0.472, 0.098, 2.412)])
def test_the_way_to_the_tip_of_a_thin_rope_does_not_turn_round(bend, turn, short):
    width = 5
    axis, mask = rope(bend, width, turn=turn)
    cut = int(short * width)
    chain = extended(axis[cut : len(axis) - cut : width], mask, float(width))
    assert np.linalg.norm(chain[[0, -1]] - axis[[0, -1]], axis=1).max() < width


@pytest.mark.parametrize("width", [1.2, 1.5])
def test_the_tips_of_a_thin_rope_lie_where_it_ends(width):
    off = []
    for turn in np.arange(0, 6.28, 0.13):
        heading = turn + np.linspace(-0.2, 0.2, 201)
        axis = np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0) / 2
        drawn = draw_rope(axis - axis.mean(axis=0) + 80, width, size=(160, 160))
        chain = extend_chain(np.ascontiguousarray(axis[20:-20:8] - axis.mean(axis=0) + 80), drawn.mask, 0, 0, width)
        for tip, end, inner in ((chain[0], drawn.curve[0], 9), (chain[-1], drawn.curve[-1], -10)):
            ahead = end - drawn.curve[inner]
            off.append((tip - end) @ ahead / np.linalg.norm(ahead))
    assert abs(np.mean(off)) < 0.2
    assert np.std(off) < 0.5
