"""The folded outline of a ribbon against the axis that the ribbon was made from."""

from __future__ import annotations

import numpy as np
import pytest

from shape_obs.initialization.folding import fold_outline


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


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("turns", [2, 4])
def test_a_coil_is_folded_along_its_axis_though_its_outer_side_is_longer(turns, backwards):
    width = 8.0
    axis, outline = ribbon(2 * np.pi * turns, width, length=240.0 * turns, coiled=0.5)
    line = fold_outline(np.ascontiguousarray(outline[:: -1 if backwards else 1]), width)
    inner = distances(line, axis[[0, -1]]) > 1.5 * width
    assert distances(line[inner], axis).max() < 0.2 * width
