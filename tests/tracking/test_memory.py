"""A rope that was out of sight is numbered as before where its form tells, whatever the rule for new ropes says."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shape_obs import Centerline, Intrinsics, Shape, ShapeDetector
from shape_obs.bench.scenes import draw_rope, rotation

SIZE = (240, 320)
CAMERA = Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5)


def curve(degrees: float, bend: float = 0.0, shift: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """Return a rope 150 px long, from left to right, or turned clockwise, or bent: ``(400, 2)`` pixels."""
    along = np.linspace(-1, 1, 400)
    points = np.stack([along, bend / 75 * (along**2 - 1 / 3)], axis=1)
    points *= 150 / np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    return points @ rotation(np.radians(degrees)).T + np.array([160.0, 120.0]) + shift


def find(detector: ShapeDetector, points: np.ndarray | None, stamp: float) -> Shape:
    """Detect a rope, or an empty image."""
    mask = np.zeros(SIZE, np.uint8) if points is None else draw_rope(points, 8.0, size=SIZE).mask
    depth, camera = (np.full(SIZE, 0.8), CAMERA) if detector.shapes[0].lift == "cloud" else (None, None)
    return detector.detect_mask(mask, depth, camera, stamp=stamp).shapes[0]


def lost_and_found(before: np.ndarray, after: np.ndarray, gone: float, **options: Any) -> tuple[Shape, Shape]:
    """Return a rope before and after it was out of sight for some seconds."""
    detector = ShapeDetector([Centerline(n=10, ends="tips", **options)], max_age=0.5)
    seen = [find(detector, before, k / 30) for k in range(3)][-1]
    for stamp in (0.2, gone / 2, gone):
        find(detector, None, stamp)
    return seen, find(detector, after, gone + 1 / 30)


def begins_at(shape: Shape, end: np.ndarray) -> bool:
    pixel = CAMERA.project(shape.points3d)[0] if shape.points3d is not None else shape.pixels[0]
    return bool(np.linalg.norm(pixel - end) < 12)


@pytest.mark.parametrize("lift", ["points", "cloud"])
@given(
    begin=st.floats(0, 360), turned=st.floats(-50, 50), gone=st.floats(1, 5), bend=st.floats(0, 40),
    shift=st.tuples(st.floats(-30, 30), st.floats(-20, 20)),
)  # fmt: skip
@settings(max_examples=25, deadline=None)
def test_a_rope_that_moved_out_of_sight_keeps_its_order(lift, begin, turned, gone, bend, shift):
    before, after = curve(begin, 15.0), curve(begin + turned, bend, shift)
    seen, found = lost_and_found(before, after, gone, lift=lift)
    assert seen.ok
    assert found.ok
    ends = after if begins_at(seen, before[0]) else after[::-1]
    assert begins_at(found, ends[0])
    assert (found.track_id, found.new) == (1, False)


def test_an_anchor_numbers_new_ropes_only():
    """The rope turns by 60 degrees, so that its other end is the one nearest the anchor."""
    seen, found = lost_and_found(curve(30), curve(-30), 2.0, anchor=(160.0, 0.0))
    assert begins_at(seen, curve(30)[0])
    assert begins_at(found, curve(-30)[0])
    assert not found.new


@pytest.mark.parametrize(
    ("after", "gone", "options"),
    [
        (curve(90), 1.0, {}),  # a straight rope that lies across may have turned either way
        (curve(0), 600.0, {}),
        (curve(0), 1.0, {"order": "image"}),
    ],
)
def test_what_cannot_be_remembered_is_numbered_by_the_rule(after, gone, options):
    anchor = tuple(after[-1].tolist())
    _, found = lost_and_found(curve(0), after, gone, anchor=anchor, **options)
    assert begins_at(found, after[-1])
    assert found.new
