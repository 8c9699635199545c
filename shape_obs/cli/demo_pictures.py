"""The pictures of ``shape-obs demo``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shape_obs.drawing import (
    GOAL,
    HIDDEN,
    VALID,
    Image,
    draw_curve,
    draw_detection,
    draw_point,
    draw_text,
    text_width,
)  # fmt: skip
from shape_obs.shape import Detection

_MARGIN = 40  # pixels of an image 640 pixels wide, around everything that moves in it
_WIDTH = 640  # pixels of a panel, about
_LEGEND = 48  # pixels of the band with title and legend, at size 1


@dataclass(frozen=True)
class Moment:
    """What is drawn of one frame: the image, the shape, and the goal as ``(N, 2)`` pixels."""

    picture: Image
    detection: Detection
    goal: npt.NDArray[np.float64]


def draw_frames(moments: Sequence[Moment], distances_mm: Sequence[float], size: float) -> list[Image]:
    """Draw every frame, cropped to where the cable and the goal ever are, under its distance and a legend.

    Args:
        moments: The frames.
        distances_mm: The distance of each from the goal.
        size: Enlarges points, lines and text.
    """
    left, top, right, bottom = _window(moments)
    scale = max(1, round(_WIDTH / (right - left)))
    hidden = any(not moment.detection.shapes[0].valid.all() for moment in moments)
    frames = []
    for step, (moment, away) in enumerate(zip(moments, distances_mm, strict=True), start=1):
        under = [(moment.goal, GOAL)]
        canvas = draw_detection(moment.picture, moment.detection, scale=scale, size=size, under=under)
        canvas = canvas[top * scale : bottom * scale, left * scale : right * scale]
        title = f"Step {step}: {away:.1f} mm from the goal"
        frames.append(np.concatenate([_heading(title, canvas.shape[1], size, hidden=hidden), canvas]))
    return frames


def _window(moments: Sequence[Moment]) -> tuple[int, int, int, int]:
    """Return left, top, right and bottom of what is shown of the pictures."""
    places = [points for each in moments for points in (each.goal, each.detection.shapes[0].pixels)]
    points = np.concatenate(places)
    height, width = moments[0].picture.shape[:2]
    margin = _MARGIN * width // 640
    low, high = np.nanmin(points, axis=0) - margin, np.nanmax(points, axis=0) + margin
    left, top = (max(int(edge), 0) for edge in low)
    return left, top, min(int(high[0]), width), min(int(high[1]), height)


def _heading(title: str, width: int, size: float, *, hidden: bool) -> Image:
    """Return a band with a title and the legend."""
    band = np.full((round(_LEGEND * size), width, 3), 255, np.uint8)
    draw_text(band, title, (round(7 * size), round(17 * size)), size=size)
    at, middle = 12 * size, 36 * size
    for name, colour in (("detected point", VALID), *([("hidden point", HIDDEN)] if hidden else [])):
        draw_point(band, np.array([at, middle]), colour, size=size)
        draw_text(band, name, (round(at + 10 * size), round(middle + 4 * size)), size=size)
        at += 32 * size + text_width(name, size)
    draw_curve(band, np.array([[at - 7 * size, middle], [at + 9 * size, middle]]), GOAL, thickness=round(4 * size))
    draw_text(band, "goal", (round(at + 15 * size), round(middle + 4 * size)), size=size)
    return band
