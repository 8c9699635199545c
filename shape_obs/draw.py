"""Pictures for people: numbered points over the image, coloured by how far they can be trusted."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.shape import Detection, Shape

Image = npt.NDArray[np.uint8]
Colour = tuple[int, int, int]

VALID: Final[Colour] = (60, 200, 80)
VISIBLE: Final[Colour] = (255, 170, 0)
HIDDEN: Final[Colour] = (230, 50, 50)
_PAPER: Final[Colour] = (255, 255, 255)
_INK: Final[Colour] = (20, 20, 20)
_ANTIALIASED: Final = cv2.LINE_AA
_SHIFT: Final = 4


def draw_detection(rgb: Image, detection: Detection, *, scale: int = 1) -> Image:
    """Every shape over a copy of the image.

    Args:
        rgb: (H,W,3) uint8, RGB.
        detection: What was found in it.
        scale: Enlarges the picture first, so that numbers fit on small images.

    Returns:
        (H*scale, W*scale, 3) uint8, RGB: green points are valid, orange ones on the mask but without depth, red ones
        hidden or held; numbers run from 0 and the first point is ringed. A shape that is not ok says why.
    """
    picture = np.repeat(np.repeat(rgb, scale, axis=0), scale, axis=1) if scale > 1 else rgb.copy()
    for row, shape in enumerate(detection):
        draw_shape(picture, shape, scale=scale)
        if shape.reason:
            _text(picture, f"{shape.name}: {shape.reason}", (8, 20 + 18 * row), HIDDEN)
    return picture


def draw_shape(picture: Image, shape: Shape, *, scale: int = 1) -> None:
    """One shape, in place; nothing where it has no points."""
    points = (shape.points2d.astype(np.float64) + 0.5) * scale - 0.5
    known = np.isfinite(points).all(axis=1)
    draw_curve(picture, points[known], _PAPER, thickness=1)
    beside = _beside(points)
    for i in np.flatnonzero(known):
        colour = VALID if shape.valid[i] else VISIBLE if shape.visible[i] else HIDDEN
        centre = _fixed(points[i])
        cv2.circle(picture, centre, 5 << _SHIFT, _PAPER, -1, _ANTIALIASED, _SHIFT)
        cv2.circle(picture, centre, 4 << _SHIFT, colour, -1, _ANTIALIASED, _SHIFT)
        if i == 0:
            cv2.circle(picture, centre, 8 << _SHIFT, _INK, 1, _ANTIALIASED, _SHIFT)
        _number(picture, str(i), points[i] + beside[i])


def draw_curve(picture: Image, points: npt.NDArray[np.float64], colour: Colour, *, thickness: int = 1) -> None:
    """A polyline of (N,2) pixels, in place."""
    if len(points) > 1:
        line = np.round(points * (1 << _SHIFT)).astype(np.int32)
        cv2.polylines(picture, [line], False, colour, thickness, _ANTIALIASED, _SHIFT)


def _beside(points: npt.NDArray[np.float64], distance: float = 16.0) -> npt.NDArray[np.float64]:
    """Where each number goes: beside the curve, on the outside of its bends, so that it hides no other point."""
    tangent = np.gradient(points, axis=0)
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    if np.nansum(normal * np.gradient(tangent, axis=0)) > 0:
        normal = -normal
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9) * distance


def _fixed(point: npt.NDArray[np.float64]) -> tuple[int, int]:
    return round(point[0] * (1 << _SHIFT)), round(point[1] * (1 << _SHIFT))


def _number(picture: Image, text: str, centre: npt.NDArray[np.float64]) -> None:
    if np.isfinite(centre).all():
        (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.4, 1)
        _text(picture, text, (round(centre[0] - width / 2), round(centre[1] + height / 2)), _INK)


def _text(picture: Image, text: str, origin: tuple[int, int], colour: Colour) -> None:
    for ink, thickness in ((_PAPER, 3), (colour, 1)):
        cv2.putText(picture, text, origin, cv2.FONT_HERSHEY_SIMPLEX, 0.4, ink, thickness, _ANTIALIASED)
