"""The first form of a rope: crossings with itself, cuts by an occluder, strands side by side, coils."""

from __future__ import annotations

from functools import partial

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from shape_obs import Centerline, Shape, ShapeDetector
from shape_obs.bench.scenes import draw_rope, resample
from shape_obs.initialization.folding import fold_outline
from tests.benchmarks.rope_scores import is_traversed
from tests.scenes.tangles import crossing_rope, cut_rope, touching_rope

TANGLES = {
    "1 crossing": partial(crossing_rope, crossings=1),
    "3 crossings": partial(crossing_rope, crossings=3),
    "cut, 16 px": partial(cut_rope, crossings=0, band=16),
    "crossing and cut, 50 px": partial(cut_rope, crossings=1, band=50),
    "side by side": touching_rope,
}


def detected(mask: npt.NDArray[np.uint8]) -> Shape:
    return ShapeDetector([Centerline(n=60)]).detect_mask(mask).shapes[0]


def strip(*points: tuple[float, float], width: float = 10.0) -> npt.NDArray[np.uint8]:
    return draw_rope(resample(np.array(points, dtype=np.float64), 1.0), width).mask


@pytest.mark.parametrize("draw", TANGLES.values(), ids=list(TANGLES))
def test_a_tangle_is_found_as_it_runs_or_refused(draw):
    """Points of a rope that was found right are not visible deep under what hides it."""
    rng, right, count, hidden, called_visible = np.random.default_rng(12), 0, 6, 0, 0
    for _ in range(count):
        tangle = draw(rng)
        shape = detected(tangle.mask)
        if not shape.ok:
            continue
        assert is_traversed(shape.pixels, tangle)
        right += 1
        nearest = np.linalg.norm(shape.pixels[:, None] - tangle.curve[None], axis=2).argmin(axis=1)
        under = tangle.hidden[nearest]
        under &= np.roll(under, 1) & np.roll(under, -1)
        hidden, called_visible = hidden + under.sum(), called_visible + (under & shape.visible).sum()
    assert right >= 0.8 * count
    assert called_visible <= 0.05 * hidden


def test_all_points_of_a_rope_that_crosses_itself_are_visible():
    tangle = crossing_rope(np.random.default_rng(11), 2)
    shape = detected(tangle.mask)
    assert shape.ok, shape.reason
    assert is_traversed(shape.pixels, tangle)
    assert shape.visible.all()


def test_a_mask_that_branches_is_refused():
    fork = strip((100, 100), (300, 200)) | strip((300, 200), (500, 100)) | strip((300, 200), (300, 400))
    shape = detected(fork)
    assert not shape.ok
    assert "branches" in shape.reason


def test_a_small_knob_is_left_out():
    rope = strip((100, 200), (500, 200)) | strip((300, 200), (300, 222), width=6)
    shape = detected(rope)
    assert shape.ok
    off = np.abs(shape.pixels[:, 1] - 200)
    assert np.mean(off < 1) > 0.9
    assert off.max() < 10


def test_a_closed_ring_is_refused():
    ring = np.zeros((300, 300), np.uint8)
    cv2.circle(ring, (150, 150), 90, (255,), 10)
    shape = detected(ring)
    assert not shape.ok
    assert "ring" in shape.reason


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
