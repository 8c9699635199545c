"""Ropes that meet are kept apart by their widths and colours."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from shape_obs import Centerline, Detection, ShapeDetector
from shape_obs.initialization.likeness import Look, are_unlike

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


def detect(mask: Image, rgb: Image | None) -> Detection:
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


@pytest.mark.parametrize(
    ("one", "other", "unlike"),
    [
        (Look(8.0), Look(14.0), True),
        (Look(8.0, 2.0), Look(14.0, 2.0), False),  # both vary too much
        (Look(3.0), Look(5.0), False),  # pixels
        (Look(20.0), Look(24.0), False),
        (Look(), Look(14.0), False),
        (Look(8.0, 0.0, np.array([20.0, 100.0, 0.0])), Look(8.0, 0.0, np.array([20.0, 0.0, 0.0])), True),
        (Look(8.0, 0.0, np.array([20.0, 100.0, 0.0]), 20.0), Look(8.0, 0.0, np.array([20.0, 0.0, 0.0]), 20.0), False),
        (Look(8.0, 0.0, np.array([20.0, 0.0, 0.0])), Look(8.0, 0.0, None), False),
    ],
)
def test_what_varies_along_a_rope_is_no_difference(one, other, unlike):
    assert are_unlike(one, other) == are_unlike(other, one) == unlike


def test_the_picture_has_the_size_of_the_mask():
    mask, rgb = scene((9, 9), (RED, BLUE))
    with pytest.raises(ValueError, match="the mask has 400 x 300 pixels, rgb 398 x 300: they must be equal"):
        detect(mask, np.ascontiguousarray(rgb[:, 2:]))
