"""Parts of the pictures of the docs: text, legends and grids of panels, in a typeface that is readable when scaled."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np

from shape_obs.drawing import GOAL, HIDDEN, VALID, VISIBLE, draw_point

Picture = Any
INK = (34, 49, 63)


class Key(NamedTuple):
    """An entry of a legend: a mark, its colour and its meaning."""

    text: str
    colour: tuple[int, int, int]
    mark: Literal["point", "first", "line", "dashed", "dotted", "patch", "dot"] = "point"


VALID_KEY = Key("valid point", VALID)
NO_DEPTH_KEY = Key("visible, no depth", VISIBLE)
HIDDEN_KEY = Key("not visible", HIDDEN)
FIRST_KEY = Key("point 0", VALID, "first")
GOAL_KEY = Key("goal", GOAL, "line")


@cache
def font(height: int, *, bold: bool = False) -> Any:
    """Return Matplotlib's DejaVu Sans, with letters of about ``height`` pixels."""
    import matplotlib as mpl
    from PIL import ImageFont

    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(mpl.get_data_path()) / "fonts" / "ttf" / name), height)


def width_of(text: str, height: int, *, bold: bool = False) -> int:
    """Return the width of a text in pixels."""
    return int(np.ceil(font(height, bold=bold).getlength(text)))


def write_text(
    picture: Picture,
    text: str,
    place: tuple[int, int],
    height: int,
    *,
    colour: tuple[int, int, int] = INK,
    bold: bool = False,
    halo: int = 0,
) -> Picture:
    """Return the picture with a text whose left middle is at ``place``."""
    from PIL import Image, ImageDraw

    drawn = Image.fromarray(np.ascontiguousarray(picture))
    ImageDraw.Draw(drawn).text(
        place, text, fill=colour, font=font(height, bold=bold), anchor="lm", stroke_width=halo, stroke_fill="white"
    )
    return np.asarray(drawn).copy()


def band(text: str, width: int, height: int, *, bold: bool = False, rows: int | None = None) -> Picture:
    """Return a white band with a text, which is wrapped at the width; ``rows`` gives the band that many lines."""
    lines: list[str] = []
    for word in text.split():
        if lines and width_of(f"{lines[-1]} {word}", height, bold=bold) <= width - 12:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    step = round(1.35 * height)
    paper = np.full((max(rows or 0, len(lines), 1) * step + round(0.5 * height), width, 3), 255, np.uint8)
    for k, line in enumerate(lines):
        paper = write_text(paper, line, (6, round(0.25 * height) + step // 2 + k * step), height, bold=bold)
    return paper


def legend(keys: Sequence[Key], width: int, height: int) -> Picture:
    """Return a white band with the entries of a legend, in as many lines as they need."""
    mark, gap, step = round(1.8 * height), round(1.2 * height), round(1.7 * height)
    places, at, row = [], 6, 0
    for key in keys:
        wide = mark + width_of(key.text, height)
        if at > 6 and at + wide > width - 4:
            at, row = 6, row + 1
        places.append((at, row))
        at += wide + gap
    paper = np.full(((row + 1) * step + round(0.3 * height), width, 3), 255, np.uint8)
    for key, (left, line) in zip(keys, places, strict=True):
        middle = round(0.15 * height) + step // 2 + line * step
        _mark(paper, key, np.array([left + 0.7 * height, middle], np.float64), height)
        paper = write_text(paper, key.text, (left + mark, middle), height)
    return paper


def _mark(paper: Picture, key: Key, centre: Any, height: int) -> None:
    u, v = (round(x) for x in centre.tolist())
    half = round(0.65 * height)
    if key.mark == "line":
        cv2.line(paper, (u - half, v), (u + half, v), key.colour, max(3, height // 4), cv2.LINE_AA)
    elif key.mark in ("dashed", "dotted"):
        parts = 2 if key.mark == "dashed" else 4
        for k in range(parts):
            start = u - half + 2 * half * k // parts
            cv2.line(paper, (start, v), (start + half // parts, v), key.colour, max(2, height // 5), cv2.LINE_AA)
    elif key.mark == "dot":
        cv2.circle(paper, (u, v), height // 4, key.colour, -1, cv2.LINE_AA)
    elif key.mark == "patch":
        cv2.rectangle(paper, (u - half, v - height // 2), (u + half, v + height // 2), key.colour, -1)
    else:
        draw_point(paper, centre, key.colour, size=height / 11)
        if key.mark == "first":
            cv2.circle(paper, (u, v), half, (20, 20, 20), 2, cv2.LINE_AA)


def titled(panel: Picture, title: str, height: int, *, bold: bool = False, rows: int | None = None) -> Picture:
    """Return a panel under its title."""
    return np.concatenate([band(title, panel.shape[1], height, bold=bold, rows=rows), panel])


def grid(panels: Sequence[Picture], columns: int, gap: int = 8) -> Picture:
    """Return panels of equal size in rows, with white between them."""
    rows = []
    for first in range(0, len(panels), columns):
        row = [np.pad(panel, ((0, gap), (0, gap), (0, 0)), constant_values=255) for panel in panels[first:][:columns]]
        row += [np.full_like(row[0], 255)] * (columns - len(row))
        rows.append(np.concatenate(row, axis=1))
    picture = np.concatenate(rows)
    return picture[: len(picture) - gap, : picture.shape[1] - gap]


def save(path: Path, picture: Picture, most: int = 300_000) -> None:
    """Write a PNG, or a JPEG of the best quality below ``most`` bytes."""
    from PIL import Image

    drawn = Image.fromarray(np.ascontiguousarray(picture))
    if path.suffix == ".png":
        drawn.save(path, optimize=True)
        return
    for quality in range(90, 40, -4):
        drawn.save(path, quality=quality, optimize=True)
        if path.stat().st_size <= most:
            return
    raise ValueError(f"{path} stays above {most} bytes.")
