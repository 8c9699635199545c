"""Pictures for people: numbered points over the image, coloured by how far they can be trusted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.geometry.topology import Grid, Ring, Topology
from shape_obs.shape import Detection, Shape

Image = npt.NDArray[np.uint8]
Array = npt.NDArray[np.float64]
Colour = tuple[int, int, int]

VALID: Final[Colour] = (60, 200, 80)
VISIBLE: Final[Colour] = (255, 170, 0)
HIDDEN: Final[Colour] = (230, 50, 50)
_PAPER: Final[Colour] = (255, 255, 255)
_INK: Final[Colour] = (20, 20, 20)
_ANTIALIASED: Final = cv2.LINE_AA
_SHIFT: Final = 4


def draw_detection(
    rgb: Image, detection: Detection, *, scale: int = 1, under: Sequence[tuple[Array, Colour]] = ()
) -> Image:
    """Draw every shape over a copy of the image.

    Args:
        rgb: ``(H, W, 3)`` uint8, RGB.
        detection: What was found in it.
        scale: Enlarges the picture first, so that numbers fit on small images.
        under: Curves of ``(K, 2)`` pixels with their colours, drawn below the shapes: goals, truth.

    Returns:
        (H*scale, W*scale, 3) uint8, RGB: green points are valid, orange ones on the mask but without depth, red ones
        hidden or held; numbers run from 0 and the first point is ringed. Text says why a shape was not found, that its
        numbering begins anew, and what is wrong with the stamp.
    """
    picture = rgb.repeat(scale, axis=0).repeat(scale, axis=1)
    for curve, colour in under:
        draw_curve(picture, _enlarged(curve, scale), colour, thickness=2)
    lines = [detection.warning] if detection.warning else []
    for shape in detection:
        draw_shape(picture, shape, scale=scale)
        if shape.reason:
            lines.append(f"{shape.name}: {shape.reason}")
        elif shape.new and shape.track_id > 1:
            lines.append(f"{shape.name}: the numbering begins anew, track {shape.track_id}")
    for row, line in enumerate(lines):
        draw_text(picture, line, (8, 20 + 18 * row), HIDDEN)
    return picture


def draw_shape(picture: Image, shape: Shape, *, scale: int = 1) -> None:
    """Draw one shape in place: its points, and lines between neighbours; nothing where it has no points.

    Args:
        picture: ``(H, W, 3)`` uint8, RGB.
        shape: With pixels; its layout says which points are neighbours.
        scale: By how much the picture was enlarged.

    Raises:
        ValueError: The shape was found in a cloud: there is nothing to draw it over.
    """
    points = _enlarged(shape.pixels, scale)
    known: npt.NDArray[np.bool_] = np.asarray(np.isfinite(points).all(axis=1))
    for first, second in shape.layout.edges():
        if known[first] and known[second]:
            draw_curve(picture, points[[first, second]], _PAPER, thickness=1)
    numbers = points + _number_offsets(points, shape.layout)
    for i in np.flatnonzero(known):
        colour = VALID if shape.valid[i] else VISIBLE if shape.visible[i] else HIDDEN
        centre = _fixed(points[i])
        cv2.circle(picture, centre, 5 << _SHIFT, _PAPER, -1, _ANTIALIASED, _SHIFT)
        cv2.circle(picture, centre, 4 << _SHIFT, colour, -1, _ANTIALIASED, _SHIFT)
        if i == 0:
            cv2.circle(picture, centre, 8 << _SHIFT, _INK, 1, _ANTIALIASED, _SHIFT)
        _number(picture, str(i), numbers[i])


def draw_curve(picture: Image, points: Array, colour: Colour, *, thickness: int = 1) -> None:
    """Draw a polyline of ``(N, 2)`` pixels in place."""
    if len(points) > 1:
        line = np.round(points * (1 << _SHIFT)).astype(np.int32)
        cv2.polylines(picture, [line], False, colour, thickness, _ANTIALIASED, _SHIFT)


def _enlarged(points: npt.NDArray[Any], scale: int) -> Array:
    return (points.astype(np.float64) + 0.5) * scale - 0.5


def _number_offsets(points: Array, layout: Topology, distance: float = 16.0) -> Array:
    """Return the way from each point to its number, which hides no other point.

    Next to a curve, on the outside of its bends; within a mesh, up and to the left.
    """
    if isinstance(layout, Grid):
        return np.full(points.shape, -0.7 * distance)
    around = np.concatenate([points[-1:], points, points[:1]]) if isinstance(layout, Ring) else points
    tangent = np.gradient(around, axis=0)
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    if np.nansum(normal * np.gradient(tangent, axis=0)) > 0:
        normal = -normal
    normal *= distance / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    return normal[1:-1] if isinstance(layout, Ring) else normal


def _fixed(point: Array) -> tuple[int, int]:
    return round(point[0] * (1 << _SHIFT)), round(point[1] * (1 << _SHIFT))


def _number(picture: Image, text: str, centre: Array) -> None:
    if np.isfinite(centre).all():
        (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.4, 1)
        draw_text(picture, text, (round(centre[0] - width / 2), round(centre[1] + height / 2)))


def draw_text(picture: Image, text: str, origin: tuple[int, int], colour: Colour = _INK) -> None:
    """Draw small text with a halo in place, its lower left corner at ``origin`` = (u, v)."""
    # Shifted copies, not a bolder one: OpenCV 5 spaces bold letters wider.
    for du, dv, ink in ((-1, 0, _PAPER), (1, 0, _PAPER), (0, -1, _PAPER), (0, 1, _PAPER), (0, 0, colour)):
        place = (origin[0] + du, origin[1] + dv)
        cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.4, ink, 1, _ANTIALIASED)
