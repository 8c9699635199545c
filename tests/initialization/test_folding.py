"""The folded outline of a ribbon against the axis that the ribbon was made from."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shape_obs.initialization.folding import fold_outline, unexplained_share

ANGLE = np.linspace(0, 2 * np.pi, 200, endpoint=False)
CIRCLE = 50 * np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=1)


def ribbon(bend, width, length=240.0, turn=0.3, coiled=1.0):
    """Return axis and outline of a ribbon with round ends, whose heading changes by ``bend`` radians."""
    heading = turn + bend * (np.linspace(0, 1, 400) ** coiled - 0.5)
    axis = 320 + length / 400 * np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    side = np.stack([-np.sin(heading), np.cos(heading)], axis=1) * width / 2
    cap = np.linspace(np.pi / 2, -np.pi / 2, 20)[1:-1]

    def end(place, direction):
        return place + width / 2 * np.stack([np.cos(direction + cap), np.sin(direction + cap)], axis=1)

    outline = [axis + side, end(axis[-1], heading[-1]), (axis - side)[::-1], end(axis[0], heading[0] + np.pi)]
    return axis, np.concatenate(outline)


def distances(points, others):
    return np.linalg.norm(points[:, None] - others, axis=2).min(axis=1)


@given(
    bend=st.floats(-2.5, 2.5),
    width=st.floats(6, 24),
    turn=st.floats(0, 6.28),
    start=st.integers(0, 800),
    backwards=st.booleans(),
)
def test_the_centreline_of_a_ribbon_is_its_axis(bend, width, turn, start, backwards):
    axis, outline = ribbon(bend, width, turn=turn)
    outline = np.roll(outline, start, axis=0)[:: -1 if backwards else 1]
    line = fold_outline(np.ascontiguousarray(outline), width)
    assert line.shape == (96, 2)
    inner = distances(line, axis[[0, -1]]) > 1.5 * width  # the caps are not part of the axis
    assert distances(line[inner], axis).max() < 0.08 * width
    assert distances(axis, line).max() < 2.5  # half a step, which is longest at a cap
    tips = [axis[0] + (axis[0] - axis[1]) / 0.6 * width / 2, axis[-1] + (axis[-1] - axis[-2]) / 0.6 * width / 2]
    ends = line[[0, -1]]
    apart = min(np.linalg.norm(ends - tips, axis=1).max(), np.linalg.norm(ends[::-1] - tips, axis=1).max())
    assert apart < 0.25 * width


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("turns", [2, 4])
def test_a_coil_is_folded_along_its_axis_though_its_outer_side_is_longer(turns, backwards):
    width = 8.0
    axis, outline = ribbon(2 * np.pi * turns, width, length=240.0 * turns, coiled=0.5)
    line = fold_outline(np.ascontiguousarray(outline[:: -1 if backwards else 1]), width)
    inner = distances(line, axis[[0, -1]]) > 1.5 * width
    assert distances(line[inner], axis).max() < 0.2 * width


def test_a_ribbon_of_one_pixel_is_that_pixel():
    line = fold_outline(np.full((4, 2), 7.0), 1.0)
    assert line.shape == (96, 2)
    assert (line == 7.0).all()


@given(seed=st.integers(0, 2**32 - 1), reach=st.floats(0, 10), part=st.integers(2, 200))
def test_the_share_of_an_outline_far_from_a_curve(seed, reach, part):
    outline = CIRCLE + np.random.default_rng(seed).normal(0, 3, CIRCLE.shape)
    curve = np.ascontiguousarray(CIRCLE[:part])
    widest = np.linalg.norm(np.diff(curve, axis=0), axis=1).max()
    away = distances(outline[::2], curve) > reach + widest / 2
    assert unexplained_share(outline, curve, reach) == pytest.approx(np.mean(away))
