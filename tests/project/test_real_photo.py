"""A photo of a real blue rope: twenty points from one end to the other."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from shape_obs import Centerline, HSVRange, ShapeDetector

PHOTO = Path(__file__).parents[3] / "shared" / "data" / "real" / "blue_rope_640x480.png"
BLUE = HSVRange((90, 80, 20), (130, 255, 255), close=5)
ENDS = np.array([[573, 131], [560, 241]])  # read off the photo

pytestmark = pytest.mark.skipif(not PHOTO.exists(), reason=f"the shared data is not there: {PHOTO}")


@pytest.fixture(scope="module")
def rgb() -> np.ndarray:
    bgr = cv2.imread(str(PHOTO))
    assert bgr is not None
    return cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)


@pytest.mark.parametrize("ends", ["tips", "centers"])
def test_twenty_points_run_along_the_rope(rgb, ends):
    shape = ShapeDetector(Centerline(ends=ends), BLUE).detect(rgb).shapes[0]
    assert shape.ok, shape.reason
    assert shape.visible.all()
    assert shape.quality > 0.7
    gap = np.linalg.norm(np.diff(shape.points2d, axis=0), axis=1)
    assert gap.std() / gap.mean() < 0.02
    reach = 8 if ends == "tips" else 8 + gap.mean() / 2
    tips = shape.points2d[[0, -1]]
    assert min(np.linalg.norm(way - ENDS, axis=1).max() for way in (tips, tips[::-1])) < reach


def test_no_stretch_between_neighbours_leaves_the_rope_and_a_second_frame_gives_the_same_points(rgb):
    """Points that were on the rope but out of order would be joined by chords across the table."""
    detector = ShapeDetector(Centerline(n=60, ends="tips"), BLUE)
    points = detector.detect(rgb).shapes[0].points2d
    hsv = cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV)
    blue = cv2.dilate(np.asarray(cv2.inRange(hsv, np.array(BLUE.low), np.array(BLUE.high))), np.ones((5, 5)))
    parts = np.linspace(0, 1, 12)[None, :, None]
    between = (points[:-1, None] + parts * np.diff(points, axis=0)[:, None]).reshape(-1, 2)
    u, v = np.rint(between).astype(int).T
    assert (blue[v, u] > 0).mean() > 0.97
    again = detector.detect(rgb).shapes[0]
    assert again.ok
    np.testing.assert_allclose(again.points2d, points, atol=1.5)
