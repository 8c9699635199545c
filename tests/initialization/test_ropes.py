"""Every rope of a mask, cold: strands, gaps, rings and what is refused."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from shape_obs import Centerline, ShapeDetector
from shape_obs.image.find_region import find_region
from shape_obs.image.roi import Window
from shape_obs.initialization.objects import SceneObject
from shape_obs.initialization.ropes import find_ropes
from tests.benchmarks.rope_scores import judge
from tests.benchmarks.scenes.several_ropes import several_ropes

Mask = npt.NDArray[np.uint8]


def ropes(mask: Mask) -> list[SceneObject]:
    return find_ropes(find_region(mask, Window(0, 0, mask.shape[1], mask.shape[0]), 40, 0.02))[0]


def lines(*ends: tuple[tuple[int, int], tuple[int, int]], width: int = 9) -> Mask:
    mask = np.zeros((240, 320), np.uint8)
    for start, end in ends:
        cv2.line(mask, start, end, 255, width)
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


def test_ropes_that_end_far_apart_are_not_joined():
    mask = lines(((30, 60), (290, 60)))
    mask[:, 130:180] = 0
    assert len(ropes(mask)) == 2


def test_a_gap_that_two_ropes_could_fill_is_left():
    found = ropes(lines(((20, 120), (140, 120)), ((165, 112), (300, 60)), ((165, 128), (300, 180))))
    assert len(found) == 3


def test_a_ragged_border_makes_no_branches():
    rng = np.random.default_rng(0)
    for _ in range(5):
        scene = several_ropes(rng, 2, 1, width=9.0, ragged=1.0, soft=0.7, specks=10, holes=6)
        found = [each.curve.points for each in ropes(scene.mask) if not each.curve.ambiguity]
        assert len(found) == 2


def test_two_ropes_under_something_wide_are_not_joined_into_one():
    mask = lines(((40, 60), (280, 50)), ((50, 180), (270, 200)), width=11)
    one = ShapeDetector([Centerline(n=20)]).detect_mask(mask).shapes[0]
    assert not one.ok
    assert "these may be two ropes, which count=2 finds" in one.reason
    assert ShapeDetector([Centerline(n=20, count=2)]).detect_mask(mask).ok


def test_ropes_of_scenes_are_found_as_they_run():
    """Run a sample of the measurement `shape-obs bench claims --only several`."""
    right = total = wrong = 0
    detector = ShapeDetector([Centerline(n=160, count="all", ends="tips")])
    for seed in range(24):
        rng = np.random.default_rng(seed)
        scene = several_ropes(rng, 2 + seed % 3, int(rng.integers(0, 7)))
        detector.reset()
        detection = detector.detect_mask(scene.mask)
        verdict = judge([shape.pixels for shape in detection if shape.ok], scene)
        right, total, wrong = right + sum(verdict.right), total + len(verdict.right), wrong + verdict.wrong
    assert right >= 0.9 * total
    assert wrong <= 0.1 * total
