"""The pixels of one mask shared among ribbons, against brute force."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial.distance import cdist

from shape_obs.image.find_region import find_region
from shape_obs.image.roi import Window
from shape_obs.image.sharing import Reach, part_of, share, share_pixels


def line(start, end, count=60):
    return np.linspace(start, end, count)


def shared(mask, curves, radius, reach, slack, spread=0):
    stops = np.cumsum([len(curve) for curve in curves])
    points = np.ascontiguousarray(np.concatenate(curves), dtype=np.float64)
    runs = find_region(mask, Window(0, 0, mask.shape[1], mask.shape[0]), 0, 0.0).runs
    radii = np.full(len(curves), float(radius))
    owners, contested, beyond = share_pixels(runs, points, stops, radii, reach, slack, spread)
    image = np.zeros(mask.shape, np.uint32)
    image[mask != 0] = owners  # the runs are in the order of the pixels
    return image, contested, beyond


@pytest.mark.parametrize("slack", [0.5, 2.0, -1.5])
def test_pixels_go_to_the_nearest_ribbons(slack):
    """Compare with brute force, but for pixels beyond tips, which have a rule of their own."""
    radius, reach, rng = 2.5, 4.0, np.random.default_rng(3)
    same = total = 0
    for _ in range(30):
        mask = np.where(rng.random((40, 60)) < 0.7, np.uint8(255), np.uint8(0))
        ends = [rng.uniform((5, 5), (55, 35), (2, 2)) for _ in range(3)]
        curves = [line(*each, count=120) for each in ends]
        owners, contested, beyond = shared(mask, curves, radius, reach, slack)
        rows, columns = np.nonzero(mask)
        pixels = np.stack([columns, rows], axis=1).astype(float)
        away = np.stack([cdist(pixels, curve).min(axis=1) for curve in curves], axis=1)
        excess = np.where(away <= radius + reach, np.maximum(away - radius, 0), np.inf)
        order = np.sort(excess, axis=1)
        nearest = excess == order[:, :1]
        if slack >= 0:
            own = (excess < np.inf) & (nearest | (excess <= slack))
        else:
            own = nearest & (order[:, :1] < np.inf) & (order[:, 1:2] - order[:, :1] >= -slack)
        clear = np.ones(len(pixels), bool)
        for start, end in ends:
            for tip, other in ((start, end), (end, start)):
                far = np.linalg.norm(pixels - tip, axis=1) > 2 * radius + reach
                clear &= ((pixels - tip) @ (tip - other) <= 0) | far
        found = (owners[rows, columns][:, None] >> np.arange(3)) & 1 == 1
        same += np.count_nonzero((found == own).all(axis=1) & clear)
        total += np.count_nonzero(clear)
        assert abs(beyond - np.count_nonzero(order[:, 0] == np.inf)) <= 0.02 * len(pixels)
        assert (contested > 0).sum() != 1
    assert total > 10000
    assert same >= 0.97 * total


def test_a_part_is_a_region_of_its_own():
    mask = np.zeros((60, 80), np.uint8)
    cv2.line(mask, (10, 10), (70, 10), 255, 5)
    cv2.line(mask, (10, 40), (70, 50), 255, 5)
    region = find_region(mask, Window(100, 50, 80, 60), 10, 0.0)
    curves = [line((110, 60), (170, 60)), line((110, 90), (170, 100))]
    owners = share(region, curves, [5.0, 5.0], Reach(1.0, 0.5))[0]
    parts = [part_of(region, owners, [k], 10, 0.0) for k in (0, 1)]
    assert parts[0].area + parts[1].area == region.area
    assert parts[0].box.top < 65 < 85 < parts[1].box.top
    both = part_of(region, owners, [0, 1], 10, 0.0)
    assert (both.area, both.box) == (region.area, region.box)
    assert part_of(region, owners, [5], 10, 0.0).refusal == "the mask is empty"
