"""Holes inside a rope, and gaps between strands."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from shape_obs.image.find_region import find_region
from shape_obs.image.roi import Window
from shape_obs.initialization.pinholes import without_pinholes


def filled(mask) -> int:
    region = find_region(mask, Window(0, 0, mask.shape[1], mask.shape[0]), 40, 0.02)
    return without_pinholes(region).area - region.area


@pytest.mark.parametrize("width", [8, 14, 24])
def test_a_hole_in_a_rope_is_filled(width):
    mask = np.zeros((200, 300), np.uint8)
    cv2.line(mask, (20, 100), (280, 100), 255, width)
    before = int((mask > 0).sum())
    cv2.ellipse(mask, (150, 100), (width // 2, width // 4), 0, 0, 360, 0, -1)
    assert filled(mask) == before - int((mask > 0).sum()) > 0


def test_a_hole_in_a_crossing_is_filled():
    mask = np.zeros((200, 300), np.uint8)
    cv2.line(mask, (20, 60), (280, 140), 255, 12)
    cv2.line(mask, (150, 10), (150, 190), 255, 12)
    cv2.circle(mask, (150, 100), 3, 0, -1)
    assert filled(mask) > 20


@pytest.mark.parametrize("gap", [3, 5, 9])
def test_a_gap_between_strands_stays(gap):
    mask = np.zeros((200, 300), np.uint8)
    cv2.line(mask, (20, 100), (280, 100), 255, 8)
    cv2.line(mask, (20, 109 + gap), (280, 109 + gap), 255, 8)
    cv2.line(mask, (60, 60), (60, 160), 255, 8)
    cv2.line(mask, (90, 60), (90, 160), 255, 8)
    assert filled(mask) == 0
