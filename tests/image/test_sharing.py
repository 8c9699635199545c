"""The pixels of one mask shared among ribbons, against brute force."""

from __future__ import annotations

import cv2
import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.distance import cdist

from shape_obs.image.find_region import find_region
from shape_obs.image.roi import Window
from shape_obs.image.sharing import part_of, share_pixels


def line(start, end, count=60):
    return np.linspace(start, end, count)


def shared(mask, curves, radius, reach, slack, spread=0, at=(0, 0)):
    left, top = at
    stops = np.cumsum([len(curve) for curve in curves])
    points = np.ascontiguousarray(np.concatenate(curves), dtype=np.float64)
    runs = find_region(mask, Window(left, top, mask.shape[1], mask.shape[0]), 0, 0.0).runs
    return share_pixels(mask, runs, left, top, points, stops, np.full(len(curves), float(radius)), reach, slack, spread)


@settings(max_examples=40)
@given(
    mask=hnp.arrays(np.uint8, (20, 30), elements=st.sampled_from([0, 255])),
    ends=hnp.arrays(np.float64, (3, 2, 2), elements=st.floats(2, 18)),
    slack=st.sampled_from([0.5, 2.0, -1.5]),
)
def test_pixels_go_to_the_nearest_ribbons(mask, ends, slack):
    assume(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).min() > 6)
    radius, reach = 2.5, 4.0
    curves = [line(*each) for each in ends]
    owners, contested, beyond = shared(mask, curves, radius, reach, slack)
    rows, columns = np.nonzero(mask)
    pixels = np.stack([columns, rows], axis=1).astype(float)
    assert (owners[mask == 0] == 0).all()
    away = np.stack([cdist(pixels, curve).min(axis=1) for curve in curves], axis=1)
    clear = np.ones(len(pixels), bool)
    for start, end in ends:  # what is beyond a tip has a rule of its own
        for tip, other in ((start, end), (end, start)):
            clear &= ((pixels - tip) @ (tip - other) <= 0) | (np.linalg.norm(pixels - tip, axis=1) > 2 * radius + reach)
    excess = np.where(away <= radius + reach, np.maximum(away - radius, 0), np.inf)
    for at in np.flatnonzero(clear):
        own = {k for k in range(3) if owners[rows[at], columns[at]] >> k & 1}
        order = np.sort(excess[at])
        if abs(away[at] - radius - reach).min() < 0.1:
            continue
        if order[0] == np.inf:
            assert own == set()
        elif slack >= 0:
            assert {k for k in range(3) if excess[at, k] <= slack - 0.1} <= own
            assert any(excess[at, k] <= order[0] + 0.1 for k in own)
        elif order[1] - order[0] >= -slack + 0.1:
            assert own == {int(np.argmin(excess[at]))}
        elif order[1] - order[0] < -slack - 0.1:
            assert own == set()
    far = (away > radius + reach + 0.1).all(axis=1).sum(), (away > radius + reach - 0.1).all(axis=1).sum()
    assert far[0] <= beyond <= far[1]
    assert (contested >= 0).all()


def test_what_sticks_out_goes_along_the_mask_so_far():
    mask = np.zeros((40, 60), np.uint8)
    mask[18:23, 5:55] = 255
    mask[4:18, 30:33] = 255
    ribbon = [line((5, 20), (54, 20))]
    for spread in (0, 5, 40):
        owners, _, _ = shared(mask, ribbon, 3.0, 1.0, 0.5, spread)
        assert owners[17, 31] == 1
        assert (owners[6, 31] == 1) == (spread == 40)
        assert (owners[12, 31] == 1) == (spread >= 5)


def test_a_ribbon_ends_at_its_tip_where_another_one_goes_on():
    mask = np.zeros((60, 80), np.uint8)
    cv2.line(mask, (5, 30), (40, 30), 255, 7)
    cv2.line(mask, (40, 5), (40, 55), 255, 7)
    curves = [line((5, 30), (36, 30)), line((40, 5), (40, 55), 90)]
    owners, _, _ = shared(mask, curves, 3.5, 3.0, 0.5)
    assert owners[30, 20] == 1
    assert owners[30, 42] == 2
    assert owners[33, 40] == 2


def test_a_part_is_a_region_of_its_own():
    mask = np.zeros((60, 80), np.uint8)
    cv2.line(mask, (10, 10), (70, 10), 255, 5)
    cv2.line(mask, (10, 40), (70, 50), 255, 5)
    region = find_region(mask, Window(100, 50, 80, 60), 10, 0.0)
    curves = [line((110, 60), (170, 60)), line((110, 90), (170, 100))]
    owners, _, _ = shared(region.mask, curves, 3.0, 1.0, 0.5, at=(100, 50))
    parts = [part_of(region, owners, [k], 10, 0.0) for k in (0, 1)]
    assert parts[0].area + parts[1].area == region.area
    assert parts[0].box.top < 65 < 85 < parts[1].box.top
    both = part_of(region, owners, [0, 1], 10, 0.0)
    assert (both.area, both.box) == (region.area, region.box)
    assert part_of(region, owners, [5], 10, 0.0).refusal == "the mask is empty"
