"""Every rope of a mask, cold: strands, gaps, rings, looks, and what is refused."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from shape_obs import Centerline, Detection, ShapeDetector
from shape_obs.image.find_region import find_region
from shape_obs.image.roi import Window
from shape_obs.initialization.objects import SceneObject
from shape_obs.initialization.ropes import find_ropes
from tests.benchmarks.rope_scores import judge
from tests.benchmarks.scenes.several_ropes import several_ropes

Mask = npt.NDArray[np.uint8]
Place = tuple[float, float]


def ropes(mask: Mask) -> list[SceneObject]:
    return find_ropes(find_region(mask, Window(0, 0, mask.shape[1], mask.shape[0]), 40, 0.02))[0]


def lines(*ends: tuple[Place, Place], width: int = 9) -> Mask:
    mask = np.zeros((300, 400), np.uint8)
    for start, end in ends:
        cv2.line(mask, (round(start[0]), round(start[1])), (round(end[0]), round(end[1])), 255, width)
    return mask


def tips(found: SceneObject) -> list[tuple[float, float]]:
    return sorted((float(u), float(v)) for u, v in found.curve.points[[0, -1]])


@pytest.mark.parametrize("angle", [15, 30, 60, 90])
def test_strands_go_straight_on_over_a_crossing(angle):
    for turn in np.linspace(0, np.pi, 5, endpoint=False):
        mask = np.zeros((300, 300), np.uint8)
        expected = []
        for heading in (turn, turn + np.deg2rad(angle)):
            step = 120 * np.array([np.cos(heading), np.sin(heading)])
            expected.append((150 - step, 150 + step))
            ends = np.round(np.array(expected[-1]) * 16).astype(int)
            cv2.line(mask, tuple(ends[0].tolist()), tuple(ends[1].tolist()), 255, 8, cv2.LINE_8, 4)
        found = ropes(mask)
        assert len(found) == 2
        for rope in found:
            assert not rope.curve.ambiguity or angle < 25
            assert rope.width == pytest.approx(8, abs=2)
            ends = rope.curve.points[[0, -1]]
            assert min(min(np.abs(ends - way).max(), np.abs(ends[::-1] - way).max()) for way in expected) < 9


def test_three_strands_that_cross_in_nearly_one_place_go_straight_on():
    found = ropes(lines(((40, 110), (280, 130)), ((100, 20), (220, 220)), ((230, 20), (110, 220))))
    assert len(found) == 3
    assert all(rope.curve.size > 200 and not rope.curve.ambiguity for rope in found)


def test_a_rope_that_the_mask_cuts_is_joined():
    mask = lines(((30, 60), (290, 70)), ((30, 160), (290, 150)))
    mask[:, 150:156] = 0
    found = ropes(mask)
    assert len(found) == 2
    assert all(rope.curve.size > 240 for rope in found)


def test_a_gap_that_two_ropes_could_fill_is_left_and_all_three_are_refused():
    found = ropes(lines(((20, 120), (140, 120)), ((165, 112), (300, 60)), ((165, 128), (300, 180))))
    assert len(found) == 3
    assert all("the two may be one" in rope.curve.ambiguity for rope in found)


@pytest.mark.parametrize(("gap", "pieces", "sure"), [(20, 1, True), (50, 2, False), (100, 2, True)])
def test_the_wider_a_gap_the_less_it_is_one_rope(gap, pieces, sure):
    found = ropes(lines(((20, 120), (140, 120)), ((140 + gap, 120), (300, 120))))
    assert len(found) == pieces
    assert all(sure != bool(rope.curve.ambiguity) for rope in found)


def test_two_ropes_under_something_wide_are_not_joined_into_one():
    mask = lines(((40, 60), (280, 50)), ((50, 180), (270, 200)), width=11)
    one = ShapeDetector([Centerline(n=20)]).detect_mask(mask).shapes[0]
    assert not one.ok
    assert "these may be two ropes, which count=2 finds" in one.reason
    assert ShapeDetector([Centerline(n=20, count=2)]).detect_mask(mask).ok


def test_ropes_of_scenes_are_found_as_they_run():
    """Run a sample of the measurement `python -m tests.benchmarks several`."""
    right = total = wrong = 0
    detector = ShapeDetector([Centerline(n=160, count="all", ends="tips")])
    for seed in range(8):
        rng = np.random.default_rng(seed)
        scene = several_ropes(rng, 2 + seed % 3, int(rng.integers(0, 7)))
        detector.reset()
        detection = detector.detect_mask(scene.mask)
        verdict = judge([shape.pixels for shape in detection if shape.ok], scene)
        right, total, wrong = right + sum(verdict.right), total + len(verdict.right), wrong + verdict.wrong
    assert right >= 0.9 * total
    assert wrong <= 0.1 * total


Image = npt.NDArray[np.uint8]
Curve = npt.NDArray[np.float64]

RED, BLUE, GROUND = (200, 40, 40), (40, 60, 200), (190, 185, 180)


def bent(down: bool) -> Curve:
    """Return one of two curves that touch in the middle, where each turns away from the other one."""
    u = np.linspace(-150, 150, 400)
    v = np.sqrt(u * u + 30**2) - 30
    return np.stack([200 + u, 150 + (v if down else -v)], axis=1)


def scene(widths: tuple[int, int], colours: tuple[tuple[int, int, int], ...]) -> tuple[Image, Image]:
    """Return the mask and the picture of two ropes that touch where both turn."""
    mask, rgb = np.zeros((300, 400), np.uint8), np.full((300, 400, 3), GROUND, np.uint8)
    for down, width, colour in zip((False, True), widths, colours, strict=True):
        points = [np.round(bent(down) * 16).astype(np.int32)]
        cv2.polylines(mask, points, False, 255, width, cv2.LINE_8, 4)
        cv2.polylines(rgb, points, False, colour, width, cv2.LINE_8, 4)
    return mask, rgb


def detect(mask: Image, rgb: Image | None = None) -> Detection:
    return ShapeDetector([Centerline(name="rope", n=60, count="all", ends="tips")]).detect_mask(mask, rgb=rgb)


def turn_apart(found: Detection) -> bool:
    """Return whether two ropes were found, and each of them stays on its side."""
    curves = [shape.pixels for shape in found if shape.ok]
    sides = sorted(float(curve[:, 1].mean()) for curve in curves)
    return len(curves) == 2 and sides[0] < 110 and sides[1] > 190


def test_ropes_of_one_look_go_straight_on():
    mask, rgb = scene((9, 9), (RED, RED))
    assert not turn_apart(detect(mask, None))
    assert not turn_apart(detect(mask, rgb))


def test_ropes_of_unlike_colour_are_never_joined():
    mask, rgb = scene((9, 9), (RED, BLUE))
    assert not turn_apart(detect(mask, None))
    assert turn_apart(detect(mask, rgb))


@pytest.mark.parametrize("widths", [(14, 7), (16, 9), (9, 5)])
def test_ropes_of_unlike_width_are_never_joined(widths):
    assert turn_apart(detect(scene(widths, (RED, RED))[0], None))


def test_pieces_of_unlike_colour_are_not_joined_over_a_gap():
    mask, rgb = np.zeros((200, 400), np.uint8), np.full((200, 400, 3), GROUND, np.uint8)
    for start, end, colour in ((30, 190, RED), (204, 370, BLUE)):
        cv2.line(mask, (start, 100), (end, 100), 255, 9)
        cv2.line(rgb, (start, 100), (end, 100), colour, 9)
    assert len(detect(mask, None)) == 1
    assert len(detect(mask, rgb)) == 2


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


@pytest.mark.parametrize("bars", [4, 9, 12, 15])
def test_a_rope_behind_a_fence_is_one_rope_and_two_are_two(bars):
    u = np.linspace(50, 590, 300)
    one, two = (np.zeros((480, 640), np.uint8) for _ in range(2))
    for mask, places in ((one, (240,)), (two, (200, 290))):
        for v in places:
            cv2.polylines(mask, [np.rint(np.stack([u, v + 20 * np.sin(u / 90)], axis=1)).astype(int)], False, 255, 12)
        for bar in np.linspace(50, 590, bars + 2)[1:-1]:
            mask[:, int(bar) - 7 : int(bar) + 7] = 0
    found = ShapeDetector([Centerline(n=60, ends="tips")]).detect_mask(one).shapes[0]
    assert found.ok
    np.testing.assert_allclose(found.pixels[:, 1], 240 + 20 * np.sin(found.pixels[:, 0] / 90), atol=3)
    assert abs(np.ptp(found.pixels[:, 0]) - 552) < 8  # the pen is round
    if bars < 10:  # behind more, pieces are too short to be told apart
        several = ShapeDetector([Centerline(n=60, count="all", ends="tips")]).detect_mask(two)
        assert [shape.ok for shape in several] == [True, True]
        assert all(abs(np.ptp(shape.pixels[:, 0]) - 552) < 8 for shape in several)
