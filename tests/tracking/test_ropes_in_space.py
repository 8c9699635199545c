"""Ropes in space: depth tells strands apart, and what is seen end-on is not measured."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import cv2
import numpy as np
import pytest

from shape_obs import Centerline, Shape, ShapeDetector
from shape_obs.geometry.polyline import resample
from tests.scenes.hidden_ropes import Seen, camera_of, see

N = 20
CAMERA = camera_of((480, 640))


def curve(points: Iterable[tuple[float, float, float]], length: float = 0.5) -> np.ndarray:
    """Return 251 points of a curve in space, scaled to its length about (0, 0, 0.9)."""
    even = resample(np.array(list(points), dtype=np.float64), 251)
    even *= length / np.linalg.norm(np.diff(even, axis=0), axis=1).sum()
    return even - even.mean(axis=0) + (0.0, 0.0, 0.9)


def arch(closed: float) -> np.ndarray:
    """Return a hairpin whose second strand lies behind the first, and next to it as far as it is open (1 to 0)."""
    at = np.linspace(0, 1, 400)
    turn = np.clip((at - 0.45) / 0.1, 0, 1) * np.pi
    along = np.where(at < 0.45, at, np.where(at > 0.55, 1 - at, 0.45 + 0.03 * np.sin(turn)))
    away = (1 - np.cos(turn)) / 2
    return curve(np.stack([along, 0.25 * closed * away, 0.2 * away], axis=1))


def tracked(axes: Iterable[np.ndarray], **kwargs: Any) -> list[tuple[Shape, Seen]]:
    detector, found = None, []
    for axis in axes:
        seen = see(axis, 0.006, CAMERA, 1.5)
        if detector is None:
            u, v = seen.pixels[0].tolist()
            detector = ShapeDetector([Centerline(n=N, ends="tips", anchor=(u, v), spacing="m", **kwargs)])
        found.append((detector.detect_mask(seen.mask, seen.depth, CAMERA).shapes[0], seen))
    return found


def errors(shape: Shape, seen: Seen) -> np.ndarray:
    """Return (N,) distances from the truth in gaps."""
    at = np.linspace(0, len(seen.metres) - 1, N).round().astype(int)
    assert shape.points3d is not None
    return np.linalg.norm(shape.points3d - seen.metres[at], axis=1) / (0.5 / (N - 1))


def test_a_strand_behind_another_is_not_visible_and_comes_back_in_its_place():
    closing = np.concatenate([np.linspace(1, 0, 25), np.zeros(3), np.linspace(0, 1, 25)])
    found = tracked(map(arch, closing))
    for shape, seen in found:
        if shape.ok and not shape.reason:
            # Its turn is seen end-on before it closes: what is measured short there is out by less than a gap.
            assert errors(shape, seen)[shape.visible & shape.valid].max() < 0.8
    assert all(shape.ok for shape, _ in found)
    for at in (0, -1):
        shape, seen = found[at]
        assert shape.visible.all()
        assert errors(shape, seen).max() < 0.3
    shape, seen = found[27]  # it is closed since three frames
    assert shape.visible[:8].all()
    assert not shape.visible[8:].any()
    assert errors(shape, seen)[shape.visible].max() < 0.2


def test_a_rope_that_turns_away_has_points_in_equal_steps_in_space():
    def turned(angle: float) -> np.ndarray:
        wave = [(x, 0.05 * np.sin(12 * x), 0.0) for x in np.linspace(-0.5, 0.5, 200)]
        return curve([(x * np.cos(angle), y, x * np.sin(angle)) for x, y, _ in wave])

    for shape, seen in tracked(map(turned, np.radians(np.linspace(0, 60, 31)))):
        assert shape.ok
        assert shape.visible.all()
        assert errors(shape, seen)[shape.valid].max() < 0.35


def test_points_that_are_seen_end_on_are_not_valid_nor_those_next_to_them():
    bent = curve([(0, 0, 0), (0.2, 0, 0), (0.25, 0.0, -0.05), (0.25, 0.0, -0.25)])
    shape, _ = tracked([bent])[0]
    assert shape.ok
    assert not shape.valid[-10:].any()
    assert shape.valid[:10].all()


@pytest.mark.parametrize("times", [1, 3], ids=["first frame", "tracked"])
def test_a_rope_that_is_seen_end_on_is_refused(times):
    def turned(angle: float) -> np.ndarray:
        return curve([(0.5 * x * np.cos(angle), 0.02 * x, 0.5 * x * np.sin(angle)) for x in (-1, 1)], 0.4)

    shape, _ = tracked([turned(np.radians(angle)) for angle in np.linspace(79, 81, times)])[-1]
    assert not shape.ok
    assert "end-on" in shape.reason


def test_a_loop_that_crosses_itself_only_in_the_image_keeps_its_order():
    def loop(open_: float) -> np.ndarray:
        t = np.linspace(0, 1, 300)
        angle = 2 * np.pi * t * (0.8 + 0.35 * open_)
        return curve(np.stack([0.1 * np.sin(angle) + 0.2 * t, -0.1 * np.cos(angle), 0.15 * t], axis=1))

    under = 0
    for shape, seen in tracked(map(loop, np.linspace(0, 1, 30))):
        assert shape.ok
        assert errors(shape, seen)[shape.visible & shape.valid].max() < 0.5
        hidden = ~seen.shown[np.linspace(0, len(seen.shown) - 1, N).round().astype(int)]
        assert not (shape.visible & hidden).any()
        under += int(hidden.sum())
    assert under > 5


def test_the_depth_of_what_lies_behind_a_rope_that_its_rims_have_does_not_make_it_longer():
    detector, rng, found = None, np.random.default_rng(3), 0
    for step in range(12):
        axis = curve([(x, 0.3 * x, 0.4 * x) for x in (-0.25, 0.25)]) + (0.01 * step, 0.012 * step, 0.0)
        seen = see(axis, 0.006, CAMERA, 1.5)
        rim, depth = (seen.mask > 0) & (cv2.erode(seen.mask, np.ones((3, 3), np.uint8)) == 0), seen.depth.copy()
        depth[rim] += rng.uniform(0, 0.06, np.count_nonzero(rim)).astype(np.float32)
        if detector is None:
            u, v = seen.pixels[0].tolist()
            detector = ShapeDetector([Centerline(n=N, ends="tips", anchor=(u, v), spacing="m")])
        shape = detector.detect_mask(seen.mask, depth, CAMERA).shapes[0]
        found += shape.ok
        assert shape.length == pytest.approx(0.5, abs=0.014)
    assert found >= 9


def test_an_end_next_to_the_border_is_not_cut_off_by_it():
    def next_to_border(length: float) -> np.ndarray:
        return curve([(-0.25, 0, 0), (0.25, 0.02, 0)], length)

    end = (CAMERA.width - 1 - 3) / CAMERA.fx - CAMERA.cx / CAMERA.fx  # 3 pixels, of a rope that is 5 wide
    ropes = []
    for length in (*[0.5] * 5, *[0.492] * 3):
        axis = next_to_border(length)
        ropes.append(axis + (end * axis[-1, 2] - axis[-1, 0], 0, 0))
    for shape, _ in tracked(ropes):
        assert shape.ok
        assert shape.visible.all()


def test_a_rope_that_comes_too_near_for_depth_is_refused_if_its_steps_are_metres_and_a_cloud_is_not():
    axis = curve([(-0.25, 0, 0), (0.25, 0.05, 0.1)])
    seen = see(axis, 0.006, CAMERA, 1.5)
    detector = ShapeDetector([Centerline(n=N, ends="tips", spacing="m")])
    depths = seen.depth, seen.depth, np.where(seen.mask > 0, 0, seen.depth), seen.depth
    reasons = [detector.detect_mask(seen.mask, depth, CAMERA).shapes[0].reason for depth in depths]
    assert ["too little" in reason for reason in reasons] == [False, False, True, False]
    cloud = np.repeat(axis, 4, axis=0) + np.random.default_rng(1).normal(0, 0.002, (4 * len(axis), 3))
    detector = ShapeDetector([Centerline(n=N, ends="tips", spacing="m", length=0.5)])
    assert [detector.detect_cloud(cloud).shapes[0].reason for _ in range(3)] == ["", "", ""]
