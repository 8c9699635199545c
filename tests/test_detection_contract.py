"""The contract of a detection notices each way to break it, and costs little."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from shape_obs import Centerline, Detection, Shape, ShapeDetector
from shape_obs.geometry.topology import Chain
from tests.detection_contract import broken_detection, broken_shape, broken_tracks, watched

ONES = np.ones(3, bool)
FINE = Shape("it", np.ones((3, 2)), np.ones((3, 3), np.float32), ONES, ONES, Chain(3), track_id=1, new=True)
LOST = replace(FINE, visible=~ONES, valid=~ONES, ok=False, quality=0.0, reason="gone", age=0.5, new=False)
ONE_NAN = np.array([[1.0], [np.nan], [1.0]])


@pytest.mark.parametrize(
    ("shape", "change", "what"),
    [
        (FINE, {"points2d": np.zeros((2, 2))}, "points2d is float32 (2, 2)"),
        (FINE, {"points2d": None}, "points2d for images only"),
        (FINE, {"points2d": ONE_NAN * np.ones(2)}, "points2d finite if ok"),
        (LOST, {"points2d": ONE_NAN * np.ones(2)}, "points2d finite, or all of it NaN"),
        (FINE, {"points3d": None}, "points3d with depth and a camera only"),
        (FINE, {"points3d": ONE_NAN * np.ones(3)}, "points3d finite where valid"),
        (LOST, {"points3d": np.full((3, 3), np.inf)}, "points3d never infinite"),
        (FINE, {"points3d": -np.ones((3, 3))}, "points3d in front of the camera"),
        (FINE, {"visible": ~ONES}, "valid where visible only"),
        (LOST, {"visible": ONES}, "nothing visible with a reason"),
        (FINE, {"quality": np.nan}, "quality"),
        (LOST, {"quality": 0.5}, "quality"),
        (FINE, {"age": 0.1}, "age"),
        (LOST, {"age": -0.1}, "age"),
        (FINE, {"ok": False}, "ok, or a reason"),
        (FINE, {"sigma": np.array([0.1, np.nan, 0.1])}, "sigma from 0 to its bound"),
        (FINE, {"sigma": np.array([0.1, -0.1, 0.1])}, "sigma from 0 to its bound"),
        (FINE, {"sigma": np.array([0.1, 1.5, 0.1])}, "sigma from 0 to its bound"),
        (FINE, {"track_id": 0}, "a track if ok"),
        (LOST, {"new": True}, "new only if found"),
        (FINE, {"length": 0.0}, "a length above 0"),
    ],
)
def test_each_broken_promise_of_a_shape_is_named(shape, change, what):
    assert broken_shape(shape, 3, in_2d=True, in_3d=True) == []
    found = broken_shape(replace(shape, **change), 3, in_2d=True, in_3d=True)
    assert any(what in each for each in found), found


def test_arrays_that_can_be_written_and_pixels_that_differ_from_their_flags_are_named():
    open_one = replace(FINE)
    vars(open_one)["valid"] = ONES.copy()
    assert broken_shape(open_one, 3, in_2d=True, in_3d=True) == ["valid is writable"]
    flat = replace(FINE, points3d=None, valid=~ONES)
    assert broken_shape(flat, 3, in_2d=True, in_3d=False) == ["without depth, valid where visible"]
    assert broken_shape(replace(flat, valid=ONES, sigma=[9.0] * 3), 3, in_2d=True, in_3d=False, diagonal=5.0)


def test_tracks_are_numbered_upwards_and_a_new_number_is_called_new():
    assert broken_tracks((FINE,), {}) == broken_tracks((LOST,), {"it": 1}) == broken_tracks((FINE,), None) == []
    assert broken_tracks((FINE,), {"it": 1}) == ["it: track 1, then 1, new=True"]
    assert broken_tracks((FINE,), {"it": 2}) == ["it: track 2, then 1, new=True"]
    assert broken_tracks((LOST,), {"it": 2}) == ["it: was not found, and its track 2 is 1"]


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"shapes": (replace(FINE, name="other"),)}, "shapes in the order of the configurations"),
        ({"shapes": (replace(FINE, age=0.1),)}, "it (centerline): age"),
        ({"timings": {"fit": -1.0, "total": 1.0}}, "timings"),
        ({"timings": {"fit": 9.0, "total": 1.0}}, "timings"),
        ({"timings": {"cook": 1.0, "total": 2.0}}, "timings"),
        ({"stamp": 2.0}, "stamp"),
        ({"more": {"it": 0}}, "more than the count"),
    ],
)
def test_each_broken_promise_of_a_detection_is_named(change, what):
    detector = ShapeDetector(Centerline(n=3, name="it"))
    given: dict[str, Any] = {"in_2d": True, "in_3d": True, "diagonal": 400.0, "stamp": 1.5}
    fine = Detection((FINE,), 1.5, {"fit": 1.0, "total": 1.5})
    assert broken_detection(fine, detector, **given) == []
    (found,) = broken_detection(replace(fine, **change), detector, **given)
    assert what in found


def test_every_detection_is_watched_and_none_twice(monkeypatch, wave):
    monkeypatch.setattr("shape_obs.tracker.Tracker.finish", lambda self, found, moment: replace(LOST, name="it"))
    with watched() as broken:
        detector = ShapeDetector(Centerline(n=3, name="it"))
        detector.detect_mask(wave.mask)
        assert broken == ["it: was not found, and its track 0 is 1"]
        detector.reset()
        detector.detect_mask(mask=wave.mask)
        assert len(broken) == 2
