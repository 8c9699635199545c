"""Ropes that are refused where others meet them, instead of being given wrong."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from shape_obs import Centerline, Detection, ShapeDetector
from shape_obs.initialization.strand_doubts import sharpest_turn

Mask = npt.NDArray[np.uint8]
Place = tuple[float, float]


def lines(*ends: tuple[Place, Place], width: int = 9) -> Mask:
    mask = np.zeros((300, 400), np.uint8)
    for start, end in ends:
        cv2.line(mask, (round(start[0]), round(start[1])), (round(end[0]), round(end[1])), 255, width)
    return mask


def detect(mask: Mask) -> Detection:
    return ShapeDetector([Centerline(name="rope", n=60, count="all", ends="tips")]).detect_mask(mask)


def beside(angle: float, long: float = 110.0) -> tuple[Place, Place]:
    """Return a rope that ends on one along v = 200, at an angle in degrees."""
    way = np.deg2rad(angle)
    return (200.0, 200.0), (200.0 + long * np.cos(way), 200.0 - long * np.sin(way))


@pytest.mark.parametrize("angle", [90, 80, 105])
def test_a_rope_that_ends_on_another_one_at_a_wide_angle_is_found(angle):
    found = detect(lines(((30, 200), (370, 200)), beside(angle)))
    assert [shape.ok for shape in found] == [True, True]


@pytest.mark.parametrize("angle", [40, 50, 130])
def test_a_rope_that_ends_on_another_one_aslant_is_refused_alone(angle):
    found = detect(lines(((30, 200), (370, 200)), beside(angle)))
    assert sorted(shape.ok for shape in found) == [False, True]
    assert any("it ends on another rope, and may as well go on there" in shape.reason for shape in found)


def test_a_rope_that_ends_on_another_one_with_a_bump_beyond_is_refused():
    """The bump may be the rope's own tip."""
    mask = lines(((30, 200), (370, 200)), beside(90))
    cv2.line(mask, (200, 200), (200, 210), 255, 9)
    found = detect(mask)
    assert sorted(shape.ok for shape in found) == [False, True]
    assert any("something sticks out beyond it" in shape.reason for shape in found)


def test_two_ropes_that_end_on_a_third_next_to_each_other_are_refused():
    mask = lines(((30, 200), (370, 200)), ((190, 60), (190, 200)), ((214, 200), (214, 290)))
    found = detect(mask)
    assert sum(shape.ok for shape in found) <= 2
    assert not any(shape.ok and 60 < shape.pixels[:, 1].mean() < 190 for shape in found) or len(found) == 2


def test_a_rope_goes_on_beyond_another_one_over_a_gap_beside_it():
    mask = lines(((30, 200), (370, 200)), ((200, 40), (200, 186)), ((200, 200), (200, 280)))
    found = detect(mask)
    assert [shape.ok for shape in found] == [True, True]
    across = min((shape.pixels for shape in found), key=lambda points: float(np.ptp(points[:, 0])))
    assert float(np.ptp(across[:, 1])) > 225


def test_a_rope_that_bends_in_a_gap_of_the_mask_is_refused():
    mask = lines(((60, 200), (190, 200)), ((204, 192), (300, 115)))
    found = detect(mask)
    assert not any(shape.ok and np.ptp(shape.pixels[:, 0]) > 200 for shape in found)


def test_the_sharpest_turn_is_measured_over_chords():
    straight = np.stack([np.linspace(0, 100, 101), np.zeros(101)], axis=1)
    assert sharpest_turn(straight, 10.0) == pytest.approx(0.0, abs=1e-9)
    corner = np.concatenate([straight, [100.0, 0.0] + np.linspace(0, 60, 61)[1:, None] * [0.0, 1.0]])
    assert np.rad2deg(sharpest_turn(corner, 10.0)) == pytest.approx(90, abs=15)
    angle = np.linspace(0, np.pi, 200)[:, None]
    arc = 40 * np.concatenate([np.cos(angle), np.sin(angle)], axis=1)
    assert sharpest_turn(arc, 10.0) == pytest.approx(10 / 40, abs=0.02)
    assert sharpest_turn(straight[:10], 10.0) == 0.0
