"""Connectors at the ends of ropes: cut from the mask of several ropes, and what is none."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from shape_obs import Centerline, Detection, ShapeDetector

Mask = npt.NDArray[np.uint8]
Curve = npt.NDArray[np.float64]

HARNESSES = Path(__file__).parents[3] / "shared" / "data" / "real"


def detect(mask: Mask) -> Detection:
    return ShapeDetector([Centerline(name="rope", n=60, count="all", ends="tips")]).detect_mask(mask)


def arc(start: tuple[float, float], end: tuple[float, float], sag: float) -> Curve:
    """Return a curve between two places that sags by so many pixels."""
    t = np.linspace(0, 1, 200)[:, None]
    way = np.array(end) - start
    normal = np.array([-way[1], way[0]]) / np.hypot(*way)
    return np.array(start) + t * way + sag * np.sin(np.pi * t) * normal


def draw(mask: Mask, curve: Curve, width: int) -> None:
    cv2.polylines(mask, [np.round(curve * 16).astype(np.int32)], False, 255, width, cv2.LINE_8, 4)


def plug(mask: Mask, curve: Curve, long: float, wide: float) -> None:
    """Draw a rectangle at the end of a curve, in the direction in which it ends."""
    ahead = curve[-1] - curve[-8]
    middle = curve[-1] + long / 2 * ahead / np.hypot(*ahead)
    box = cv2.boxPoints((middle.tolist(), (long, wide), float(np.degrees(np.arctan2(ahead[1], ahead[0])))))
    cv2.fillPoly(mask, [np.round(box).astype(np.int32)], 255)


def off(found: npt.NDArray[np.generic], curve: Curve) -> tuple[float, float]:
    """Return how far a found curve lies from a drawn one at most, and its ends from those, pixels."""
    away = np.linalg.norm(found[:, None].astype(float) - curve[None], axis=2).min(axis=1).max()
    ends = np.linalg.norm(found[[0, -1]].astype(float) - curve[[0, -1]], axis=1).max()
    turned = np.linalg.norm(found[[-1, 0]].astype(float) - curve[[0, -1]], axis=1).max()
    return float(away), float(min(ends, turned))


@pytest.mark.parametrize("width", [5, 8, 14])
@pytest.mark.parametrize("wide", [3.0, 5.0])
@pytest.mark.parametrize("ends", [1, 2])
def test_a_cable_ends_where_its_connector_begins(width, wide, ends):
    mask, curve = np.zeros((360, 480), np.uint8), arc((110, 120), (360, 200), 50)
    draw(mask, curve, width)
    for way in (curve, curve[::-1])[:ends]:
        plug(mask, way, 1.3 * wide * (width + 1), wide * (width + 1))  # a line is drawn a pixel wider
    (shape,) = detect(mask)
    assert shape.ok
    away, tips = off(shape.pixels, curve)
    assert away < 0.5 * width + 2
    assert tips < width + 2


def test_without_a_count_a_connector_belongs_to_the_object():
    mask, curve = np.zeros((360, 480), np.uint8), arc((110, 120), (340, 200), 50)
    draw(mask, curve, 8)
    plug(mask, curve, 50, 40)
    assert not ShapeDetector([Centerline(n=60)]).detect_mask(mask).shapes[0].ok


@pytest.mark.parametrize(("thick", "thin"), [(14, 8), (16, 7), (10, 6)])
@pytest.mark.parametrize("crosses", [False, True])
def test_a_thin_cable_branches_off_a_thick_one(thick, thin, crosses):
    mask = np.zeros((480, 640), np.uint8)
    trunk = arc((0, 150), (400, 300), -60)
    at = trunk[60]
    branch = arc((float(at[0]), float(at[1])), (360.0, 120.0) if crosses else (260.0, 380.0), 90 if crosses else 60)
    draw(mask, trunk, thick)
    draw(mask, branch, thin)
    plug(mask, trunk, 70, 48)
    plug(mask, branch, 34, 30)
    found = detect(mask)
    assert [shape.ok for shape in found] == [True, True]
    first, second = sorted(found, key=lambda shape: min(off(shape.pixels, trunk)))
    for shape, curve, width in ((first, trunk, thick), (second, branch, thin)):
        away, tips = off(shape.pixels, curve)
        assert away < 0.6 * thick
        assert tips < 1.6 * max(width, thick)


@pytest.mark.parametrize("arms", [0, 2, 4])
def test_what_is_no_end_of_a_single_rope_is_no_connector(arms):
    mask = np.zeros((360, 480), np.uint8)
    cv2.circle(mask, (240, 180), 45, 255, -1)
    for k in range(arms):
        angle = 2 * np.pi * k / max(arms, 1) + 0.3
        end = (240 + 150 * np.cos(angle), 180 + 150 * np.sin(angle))
        cv2.line(mask, (240, 180), (int(end[0]), int(end[1])), 255, 9)
    assert not any(shape.ok for shape in detect(mask))


def test_cables_with_connectors_are_followed():
    detector = ShapeDetector([Centerline(name="rope", n=60, count=2, ends="tips")])
    for step in range(12):
        mask = np.zeros((360, 480), np.uint8)
        first = arc((60 + 2 * step, 100), (330 + 2 * step, 220), 40)
        second = arc((90 + step, 300 - 2 * step), (300 + step, 80 - 2 * step), 30)
        curves = first, second
        for curve, width in zip(curves, (12, 8), strict=True):
            draw(mask, curve, width)
            plug(mask, curve, 4 * width, 3.5 * width)
        found = detector.detect_mask(mask)
        assert found.ok
        for shape, curve in zip(found, curves, strict=True):
            assert max(off(shape.pixels, curve)) < 10


@pytest.mark.skipif(not HARNESSES.is_dir(), reason="the masks of wire harnesses are not there")
@pytest.mark.parametrize("name", ["0_after", "0_before", "4_after", "4_before", "7_after", "7_before"])
def test_real_wire_harnesses(name):
    """A thick cable comes from the left border; a thin one branches off it, and crosses it before it was moved."""
    mask = cv2.imread(str(HARNESSES / f"harness_mask_{name}.png"), cv2.IMREAD_GRAYSCALE)
    assert mask is not None
    found = detect((mask > 127).view(np.uint8))
    assert [shape.ok for shape in found] == [True, True]
    lengths = [float(np.linalg.norm(np.diff(shape.pixels, axis=0), axis=1).sum()) for shape in found]
    left = [float(shape.pixels[:, 0].min()) for shape in found]
    assert min(left) < 16
    assert all(280 < length < 460 for length in lengths)
