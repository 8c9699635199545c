"""Masks that show no object: noise, text, combs, mazes, rings, tangles of lines, plates full of holes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import pairwise, product
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

Mask = npt.NDArray[np.uint8]
Size = tuple[int, int]
Draw = Callable[[np.random.Generator, Size], Mask]


def _noise(rng: np.random.Generator, size: Size, share: float, grain: int) -> Mask:
    """Draw squares of ``grain`` pixels, a share of all."""
    (width, height), cells = size, rng.random((-(-size[1] // grain), -(-size[0] // grain))) < share
    return _mask(np.repeat(np.repeat(cells, grain, 0), grain, 1)[:height, :width])


def _stripes(rng: np.random.Generator, size: Size, line: int, gap: int, ways: str) -> Mask:
    """Draw a grid (``"both"``), a checkerboard (``"xor"``), squares (``"and"``), or the teeth of a comb."""
    v, u = np.mgrid[: size[1], : size[0]]
    across, down = u % (line + gap) < line, v % (line + gap) < line
    if ways == "comb":
        return _mask(across | (v < line))
    if ways == "snake":  # a line that winds through the image
        turn = np.where(v // (line + gap) % 2 == 0, u >= size[0] - line, u < line)
        return _mask(down | turn)
    return _mask({"both": across | down, "xor": across ^ down, "and": across & down}[ways])


def _rings(rng: np.random.Generator, size: Size, line: int, gap: int, spiral: bool) -> Mask:
    """Draw squares in squares, or a spiral of straight lines."""
    canvas = np.zeros(size[::-1], np.uint8)
    width, height = size
    for k, near in enumerate(range(2, min(size) // 2 - line, line + gap)):
        canvas[near : height - near, near : width - near] = 255
        inner = near + line
        canvas[inner : height - inner, inner : width - inner] = 0
        if spiral and k:
            canvas[near : near + line, near - line - gap : near] = 255
            canvas[near - gap : near, near - gap - line : near + line] = 0
            canvas[near - gap : near, near - gap - line : near - gap] = 255
    return canvas


def _maze(rng: np.random.Generator, size: Size, line: int) -> Mask:
    """Draw a binary-tree maze: of every cell, one wall to the north or to the west is open."""
    rows, cols = size[1] // (2 * line) - 1, size[0] // (2 * line) - 1
    cells = np.zeros((2 * rows + 1, 2 * cols + 1), bool)
    cells[1::2, 1::2] = True
    north = rng.random((rows, cols)) < 0.5
    cells[0:-1:2, 1::2], cells[1::2, 0:-1:2] = north, ~north
    drawn = np.repeat(np.repeat(cells, line, 0), line, 1)
    canvas = np.zeros(size[::-1], np.uint8)
    canvas[: drawn.shape[0], : drawn.shape[1]] = _mask(drawn)
    return canvas


def _strokes(rng: np.random.Generator, size: Size, count: int, thick: int, kind: str) -> Mask:
    """Draw lines at random: single ones, a zigzag, the rays of a star, rings, or a tangle of one long curve."""
    canvas, low, high = np.zeros(size[::-1], np.uint8), np.array([0, 0]), np.array(size)
    ends = rng.uniform(low, high, (count + 1, 2))
    if kind == "rays":
        angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
        tips = high / 2 + 0.48 * min(size) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        lines = [np.stack([high / 2, tip]) for tip in tips]
    elif kind == "zigzag":
        u = np.linspace(thick, size[0] - thick, count + 1)
        lines = [np.stack([u, np.where(np.arange(count + 1) % 2, thick, size[1] - thick)], axis=1)]
    elif kind == "rings":
        lines = []
        for place in ends:
            cv2.circle(canvas, np.rint(place).astype(int).tolist(), int(rng.integers(6, 60)), (255,), thick)
    elif kind == "curve":
        t = np.linspace(0, 1, 40 * count)[:, None]
        phase = rng.uniform(0, 2 * np.pi, (2, 2))
        swing = np.cos(2 * np.pi * count * t * (1.0, 0.618) + phase[0]) * np.cos(np.pi * 3 * t + phase[1])
        lines = [high / 2 + 0.47 * high * swing]
    else:
        lines = [np.stack(pair) for pair in pairwise(ends)]
    for line in lines:
        cv2.polylines(canvas, [np.rint(line).astype(np.int32)], False, (255,), thick)
    return canvas


def _text(rng: np.random.Generator, size: Size, scale: float) -> Mask:
    canvas = np.zeros(size[::-1], np.uint8)
    for baseline in range(round(24 * scale), size[1], round(26 * scale)):
        words = "".join(chr(letter) for letter in rng.integers(33, 126, round(size[0] / (16 * scale))))
        cv2.putText(canvas, words, (0, baseline), cv2.FONT_HERSHEY_SIMPLEX, scale, (255,), max(round(2 * scale), 1))
    return _mask(canvas > 127)  # newer versions of OpenCV draw soft edges


def _pierced(rng: np.random.Generator, size: Size, share: float, furry: bool) -> Mask:
    """Draw a plate with pixels missing, or a thick rope with hairs."""
    canvas = np.zeros(size[::-1], np.uint8)
    width, height = size
    if furry:
        cv2.line(canvas, (width // 8, height // 2), (width * 7 // 8, height // 2), (255,), 20)
        for u in rng.integers(width // 8, width * 7 // 8, round(share * width)):
            tip = (int(u + rng.integers(-30, 30)), int(height // 2 + rng.choice([-1, 1]) * rng.integers(20, 50)))
            cv2.line(canvas, (int(u), height // 2), tip, (255,), 2)
        return canvas
    canvas[8:-8, 8:-8] = _mask(rng.random((height - 16, width - 16)) >= share)
    return canvas


def _dust(rng: np.random.Generator, size: Size, thick: int, share: float) -> Mask:
    """Draw a line in salt and pepper."""
    canvas = _strokes(rng, size, 8, thick, "zigzag")
    return np.where(rng.random(canvas.shape) < share, 255 - canvas, canvas).astype(np.uint8)


def _mask(inside: npt.NDArray[Any]) -> Mask:
    return np.where(inside, 255, 0).astype(np.uint8)


PATTERNS: Final[dict[str, Draw]] = {
    **{f"noise {p:.0%}, grain {g}": partial(_noise, share=p, grain=g)
       for p, g in product((0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.95), (1, 2, 4, 8, 16))},
    **{f"checkerboard {k}": partial(_stripes, line=k, gap=k, ways="xor") for k in (1, 2, 3, 4, 8, 16, 32)},
    **{f"comb {a}/{b}": partial(_stripes, line=a, gap=b, ways="comb")
       for a, b in ((1, 1), (2, 1), (3, 1), (3, 3), (8, 8), (16, 16))},
    **{f"grid {a}/{b}": partial(_stripes, line=a, gap=b, ways="both")
       for a, b in ((1, 1), (1, 3), (2, 2), (3, 8), (4, 24), (6, 40), (8, 60), (12, 90))},
    **{f"squares {a}/{b}": partial(_stripes, line=a, gap=b, ways="and")
       for a, b in ((1, 1), (2, 1), (5, 1), (6, 3), (12, 4), (40, 8))},
    **{f"winding line {a}/{b}": partial(_stripes, line=a, gap=b, ways="snake")
       for a, b in ((1, 1), (2, 1), (3, 1), (4, 2), (6, 3), (10, 5))},
    **{f"rings {a}/{b}": partial(_rings, line=a, gap=b, spiral=False) for a, b in ((1, 1), (2, 2), (4, 3), (8, 4))},
    **{f"spiral {a}/{b}": partial(_rings, line=a, gap=b, spiral=True) for a, b in ((1, 1), (3, 2), (4, 3), (8, 4))},
    **{f"maze {k}": partial(_maze, line=k) for k in (1, 2, 4, 8, 16)},
    **{f"{n} {kind}, {k} px": partial(_strokes, count=n, thick=k, kind=kind)
       for kind, n, k in (("lines", 2000, 1), ("lines", 200, 3), ("lines", 20, 6), ("lines", 12, 10), ("lines", 8, 4),
                          ("zigzag", 200, 1), ("zigzag", 60, 3), ("zigzag", 24, 8), ("rays", 400, 1), ("rays", 40, 3),
                          ("rays", 16, 8), ("rings", 300, 2), ("rings", 30, 4), ("rings", 12, 8),
                          ("curve", 3, 6), ("curve", 6, 6), ("curve", 12, 4), ("curve", 30, 2), ("curve", 80, 1))},
    **{f"text {k:g}": partial(_text, scale=k) for k in (0.3, 0.5, 1.0, 2.0)},
    **{f"plate with {p:.2%} holes": partial(_pierced, share=p, furry=False) for p in (0.0005, 0.005, 0.05, 0.2)},
    **{f"hairy rope {p:g}": partial(_pierced, share=p, furry=True) for p in (0.05, 0.1, 0.3, 1.0)},
    **{f"line of {k} px in {p:.0%} dust": partial(_dust, thick=k, share=p)
       for k, p in ((4, 0.05), (12, 0.05), (40, 0.05), (12, 0.15))},
    "full": lambda rng, size: np.full(size[::-1], 255, np.uint8),
}  # fmt: skip
