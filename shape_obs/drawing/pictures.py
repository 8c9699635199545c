"""Pictures for people: numbered points over the image, coloured by how far they can be trusted."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.geometry.crossings import Crossing
from shape_obs.geometry.topology import Grid, Ring, Topology
from shape_obs.shape import Detection, Shape

Image = npt.NDArray[np.uint8]
Array = npt.NDArray[np.float64]
Colour = tuple[int, int, int]

VALID: Final[Colour] = (60, 200, 80)
VISIBLE: Final[Colour] = (255, 170, 0)
HIDDEN: Final[Colour] = (230, 50, 50)
GOAL: Final[Colour] = (235, 130, 40)
PAPER: Final[Colour] = (255, 255, 255)
_INK: Final[Colour] = (20, 20, 20)
# Lines of slots, far from the colours of points and from each other.
SLOTS: Final[tuple[Colour, ...]] = (
    (0, 90, 200), (215, 60, 180), (0, 190, 215), (245, 225, 50), (120, 50, 170), (140, 85, 30), (250, 250, 250),
    (30, 30, 30),
)  # fmt: skip
NUMBERED: Final = 5  # of a slot's points, one in so many shows its number
_HALF: Final = 12.0  # pixels: half the stroke of the upper strand of a crossing
_ANTIALIASED: Final = cv2.LINE_AA
_SHIFT: Final = 4
_FONT: Final = 0.4  # OpenCV's scale of letters, about 12 pixels high
_PIXELS: Final = 640 * 480  # of an image on which marks have size 1
_SMALL: Final = 240  # pixels of height, below which numbers do not fit between the points
_LEGIBLE: Final = 480  # pixels of height to which such an image is enlarged
_WIDEST: Final = 1920  # pixels: it is not enlarged beyond this width


def draw_detection(
    rgb: Image,
    detection: Detection,
    *,
    scale: int = 1,
    size: float | None = None,
    under: Sequence[tuple[Array, Colour]] = (),
) -> Image:
    """Draw every shape over a copy of the image.

    Args:
        rgb: ``(H, W, 3)`` uint8, RGB.
        detection: What was found in it.
        scale: Enlarges the picture first, so that numbers fit on small images.
        size: Size of points, lines and text: 1 for points 10 pixels wide and letters 12 pixels high. Default: 1 up to
            640 x 480 pixels, and in proportion to the sides of larger images.
        under: Curves of ``(K, 2)`` pixels with their colours, drawn below the shapes: goals, truth.

    Returns:
        (H*scale, W*scale, 3) uint8, RGB: green discs are valid points, orange squares points on the mask but without
        depth, red crosses points that are hidden or held; numbers run from 0 and the first point is ringed. Slots of
        one configuration have lines of their own colours, their names at point 0, and a number at every fifth point.
        Where ropes cross, the upper one is drawn over the lower one, which has a gap; a broken ring marks a crossing of
        which the upper strand is unknown. Text says why a shape was not found, how many objects have no slot, that a
        numbering begins again, and what is wrong with the stamp.
    """
    size = mark_size(rgb) if size is None else size
    picture = rgb.repeat(scale, axis=0).repeat(scale, axis=1)
    for curve, colour in under:
        draw_curve(picture, enlarged(curve, scale), colour, thickness=round(4 * size))
    draw_over(picture, detection, scale, size)
    return picture


def mark_size(image: Image) -> float:
    """Return the ``size`` of marks that look as on 640 x 480 pixels when the image is shown as large; at least 1."""
    return max(1.0, (image.shape[0] * image.shape[1] / _PIXELS) ** 0.5)


def legible_scale(image: Image) -> int:
    """Return the ``scale`` that a small image needs, so that the numbers of its points can be read."""
    height, width = image.shape[:2]
    return 1 if height >= _SMALL else max(min(round(_LEGIBLE / height), _WIDEST // width), 1)


def draw_over(picture: Image, detection: Detection, scale: float, size: float = 1.0) -> None:
    """Draw every shape in place over a picture that is ``scale`` times as large as the image."""
    lines = [detection.warning] if detection.warning else []
    lines += [f"{name}: {more} more found than there are slots" for name, more in detection.more.items()]
    slots = slot_colours(detection)
    for shape in detection:
        _draw_lines(picture, shape, scale, slots.get(shape.name), size)
    for crossing in detection.crossings:
        _draw_crossing(picture, crossing, detection, scale, slots, size)
    for shape in detection:
        _draw_points(picture, shape, scale, NUMBERED if shape.name in slots else 1, size)
    for shape in detection:
        if shape.name in slots and np.isfinite(shape.pixels[0]).all():
            u, v = enlarged(shape.pixels[:1], scale)[0].tolist()
            width = text_width(shape.name, size)
            place = (
                min(max(round(u) - width // 2, 2), picture.shape[1] - width - 2),
                max(round(v - 14 * size), round(12 * size)),
            )
            draw_text(picture, shape.name, place, size=size)
        if shape.reason:
            lines.append(f"{shape.name}: {shape.reason}")
        elif shape.new and shape.track_id > 1:
            lines.append(f"{shape.name}: the numbering begins again, track {shape.track_id}")
    rows = [row for line in lines for row in wrapped(line, picture.shape[1] - round(16 * size), size)]
    for k, row in enumerate(rows):
        draw_text(picture, row, (round(8 * size), round((20 + 18 * k) * size)), HIDDEN, size=size)


def slot_colours(detection: Detection) -> dict[str, Colour]:
    """Return the colour of each slot's lines, by its name: shapes whose names differ in a number at their end alone."""
    stems: dict[str, list[str]] = {}
    for shape in detection:
        if match := re.fullmatch(r"(.*?)\d+", shape.name):
            stems.setdefault(match[1], []).append(shape.name)
    names = [name for some in stems.values() if len(some) > 1 for name in some]
    return {name: SLOTS[k % len(SLOTS)] for k, name in enumerate(names)}


def point_colours(shape: Shape) -> list[Colour]:
    """Return the colour of each point: green for valid, orange for visible without depth, red for hidden or held."""
    flags = zip(shape.valid.tolist(), shape.visible.tolist(), strict=True)
    return [VALID if valid else VISIBLE if visible else HIDDEN for valid, visible in flags]


def _draw_lines(picture: Image, shape: Shape, scale: float, colour: Colour | None = None, size: float = 1.0) -> None:
    points = enlarged(shape.pixels, scale)
    known: npt.NDArray[np.bool_] = np.asarray(np.isfinite(points).all(axis=1))
    for first, second in shape.layout.edges():
        if known[first] and known[second]:
            draw_curve(picture, points[[first, second]], colour or PAPER, thickness=round((3 if colour else 1) * size))


def _draw_points(picture: Image, shape: Shape, scale: float, step: int, size: float = 1.0) -> None:
    """Draw the points of a shape, and the numbers of one in ``step``."""
    points = enlarged(shape.pixels, scale)
    numbers = points + _number_offsets(points, shape.layout, 16 * size)
    colours = point_colours(shape)
    for i in np.flatnonzero(np.isfinite(points).all(axis=1)).tolist():
        draw_point(picture, points[i], colours[i], size=size)
        if i == 0:
            radius = round((8 << _SHIFT) * size)
            cv2.circle(picture, _fixed(points[i]), radius, _INK, round(size), _ANTIALIASED, _SHIFT)
        if i % step == 0 and (i > 0 or step == 1):
            _number(picture, str(i), numbers[i], size)


def draw_point(picture: Image, point: Array, colour: Colour, *, size: float = 1.0) -> None:
    """Draw a point in place: a disc, a square in the colour ``VISIBLE``, a cross in the colour ``HIDDEN``."""
    for ink, wider in ((PAPER, 1.0), (colour, 0.0)):
        half = (4 + wider) * size
        if colour == HIDDEN:
            arm = np.array([half, half]) + 0.5 * size
            for end in (arm, arm * (1, -1)):
                draw_curve(picture, np.stack([point - end, point + end]), ink, thickness=round((3 + 2 * wider) * size))
        elif colour == VISIBLE:
            corners = np.round((point + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])) * (1 << _SHIFT))
            cv2.fillConvexPoly(picture, corners.astype(np.int32), ink, _ANTIALIASED, _SHIFT)
        else:
            cv2.circle(picture, _fixed(point), round(half * (1 << _SHIFT)), ink, -1, _ANTIALIASED, _SHIFT)


def _draw_crossing(
    picture: Image, crossing: Crossing, detection: Detection, scale: float, slots: dict[str, Colour], size: float
) -> None:
    """Draw the upper strand over the lower one, or a ring where it is unknown which one that is."""
    centre = enlarged(np.array(crossing.pixel), scale)
    if crossing.above is None:
        for start in (15, 195):
            for colour, thickness in ((PAPER, 4), (_INK, 2)):
                radius, stroke = round((10 << _SHIFT) * size), round(thickness * size)
                cv2.ellipse(
                    picture, _fixed(centre), (radius, radius), 0, start, start + 150, colour, stroke, _ANTIALIASED,
                    _SHIFT,
                )  # fmt: skip
        return
    shape = detection[crossing.slots[crossing.above]]
    points = enlarged(shape.pixels, scale)
    at = crossing.arcs[crossing.above] * (len(points) - 1)
    first = min(max(int(at), 0), len(points) - 2)
    along = points[first + 1] - points[first]
    if not np.isfinite(along).all():
        return
    along *= _HALF * size / max(float(np.linalg.norm(along)), 1e-9)
    colour = slots.get(shape.name)
    draw_curve(
        picture, np.stack([centre - along, centre + along]), PAPER if colour else _INK, thickness=round(11 * size)
    )
    draw_curve(
        picture, np.stack([centre - 1.2 * along, centre + 1.2 * along]), colour or PAPER, thickness=round(3 * size)
    )


def draw_curve(picture: Image, points: Array, colour: Colour, *, thickness: int = 1) -> None:
    """Draw a polyline of ``(N, 2)`` pixels in place."""
    if len(points) > 1:
        line = np.round(points * (1 << _SHIFT)).astype(np.int32)
        cv2.polylines(picture, [line], False, colour, thickness, _ANTIALIASED, _SHIFT)


def enlarged(points: npt.NDArray[Any], scale: float) -> Array:
    """Return where pixels ``(..., 2)`` of an image lie in a picture that is ``scale`` times as large."""
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


def _number(picture: Image, text: str, centre: Array, size: float) -> None:
    if np.isfinite(centre).all():
        (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, _FONT * size, _stroke(size))
        draw_text(picture, text, (round(centre[0] - width / 2), round(centre[1] + height / 2)), size=size)


def text_width(text: str, size: float = 1.0) -> int:
    """Return the width in pixels of a text that ``draw_text`` draws."""
    return int(cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, _FONT * size, _stroke(size))[0][0])


def wrapped(text: str, width: int, size: float = 1.0) -> list[str]:
    """Return the lines of a text that is at most ``width`` pixels wide; a longer word has a line for itself."""
    lines: list[str] = []
    for word in text.split():
        if lines and text_width(f"{lines[-1]} {word}", size) <= width:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    return lines


def draw_text(picture: Image, text: str, origin: tuple[int, int], colour: Colour = _INK, *, size: float = 1.0) -> None:
    """Draw small text with a halo in place, its lower left corner at ``origin`` = (u, v)."""
    stroke = _stroke(size)
    # Shifted copies, not a bolder one: OpenCV 5 spaces bold letters wider.
    for du, dv, ink in ((-1, 0, PAPER), (1, 0, PAPER), (0, -1, PAPER), (0, 1, PAPER), (0, 0, colour)):
        place = (origin[0] + du * stroke, origin[1] + dv * stroke)
        cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, _FONT * size, ink, stroke, _ANTIALIASED)


def _stroke(size: float) -> int:
    """Return the thickness of letters and of their halo, in pixels."""
    return max(1, round(size / 2))
