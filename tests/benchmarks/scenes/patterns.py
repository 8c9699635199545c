"""Masks that show no object: noise, text, combs, mazes, rings, tangles of lines, lines in dust."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import pairwise, product
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.scenes import resample

Mask = npt.NDArray[np.uint8]
Size = tuple[int, int]
Draw = Callable[[np.random.Generator, Size], Mask]


def _noise(rng: np.random.Generator, size: Size, share: float, grain: int) -> Mask:
    """Draw squares of ``grain`` pixels, a share of all."""
    (width, height), cells = size, rng.random((-(-size[1] // grain), -(-size[0] // grain))) < share
    return _mask(np.repeat(np.repeat(cells, grain, 0), grain, 1)[:height, :width])


def _stripes(rng: np.random.Generator, size: Size, line: int, gap: int, ways: str) -> Mask:
    """Draw a grid, a checkerboard, squares, the teeth of a comb, or a line that winds through the image."""
    v, u = np.mgrid[: size[1], : size[0]]
    across, down = u % (line + gap) < line, v % (line + gap) < line
    turn = np.where(v // (line + gap) % 2 == 0, u >= size[0] - line, u < line)
    return _mask({"grid": across | down, "checkerboard": across ^ down, "squares": across & down,
                  "comb": across | (v < line), "winding line": down | turn}[ways])  # fmt: skip


def _maze(rng: np.random.Generator, size: Size, line: int) -> Mask:
    """Draw a binary-tree maze: of every cell, one wall to the north or to the west is open."""
    rows, cols = size[1] // (2 * line), size[0] // (2 * line)
    cells, north = np.zeros((2 * rows + 1, 2 * cols + 1), bool), rng.random((rows, cols)) < 0.5
    cells[1::2, 1::2], cells[0:-1:2, 1::2], cells[1::2, 0:-1:2] = True, north, ~north
    return _mask(np.repeat(np.repeat(cells, line, 0), line, 1)[: size[1], : size[0]])


def _strokes(rng: np.random.Generator, size: Size, count: int, thick: int, kind: str) -> Mask:
    """Draw lines at random: single ones, a zigzag, the rays of a star, rings, or a tangle of one long curve."""
    canvas, high = np.zeros(size[::-1], np.uint8), np.array(size)
    ends = rng.uniform((0, 0), high, (count + 1, 2))
    turn, lines = 2 * np.pi * np.linspace(0, 1, 40)[:, None], list(map(np.stack, pairwise(ends)))
    around = np.concatenate([np.cos(turn), np.sin(turn)], axis=1)
    if kind == "rays":
        lines = [np.stack([high / 2, end]) for end in high / 2 + 0.48 * min(size) * resample(around, 2 * np.pi / count)]
    elif kind == "zigzag":
        u = np.linspace(thick, size[0] - thick, count + 1)
        lines = [np.stack([u, np.where(np.arange(count + 1) % 2, thick, size[1] - thick)], axis=1)]
    elif kind == "rings":
        lines = [end + rng.integers(6, 60) * around for end in ends]
    elif kind == "curve":
        t, phase = np.linspace(0, 1, 40 * count)[:, None], rng.uniform(0, 2 * np.pi, (2, 2))
        swing = np.cos(2 * np.pi * count * t * (1.0, 0.618) + phase[0]) * np.cos(np.pi * 3 * t + phase[1])
        lines = [high / 2 + 0.47 * high * swing]
    for line in lines:
        cv2.polylines(canvas, [np.rint(line).astype(np.int32)], False, (255,), thick)
    return canvas


def _text(rng: np.random.Generator, size: Size, scale: float) -> Mask:
    canvas = np.zeros(size[::-1], np.uint8)
    for baseline in range(round(24 * scale), size[1], round(26 * scale)):
        words = "".join(chr(letter) for letter in rng.integers(33, 126, round(size[0] / (16 * scale))))
        cv2.putText(canvas, words, (0, baseline), cv2.FONT_HERSHEY_SIMPLEX, scale, (255,), max(round(2 * scale), 1))
    return _mask(canvas > 127)  # newer versions of OpenCV draw soft edges


def _dust(rng: np.random.Generator, size: Size, thick: int, share: float) -> Mask:
    """Draw a line, or a plate if it is thick, in salt and pepper."""
    canvas = _strokes(rng, size, 8, thick, "zigzag")
    return np.where(rng.random(canvas.shape) < share, 255 - canvas, canvas).astype(np.uint8)


def _mask(inside: npt.NDArray[np.bool_]) -> Mask:
    return np.where(inside, 255, 0).astype(np.uint8)


_LINES: Final = (
    ("lines", 2000, 1), ("lines", 200, 3), ("lines", 20, 6), ("lines", 8, 4), ("zigzag", 200, 1), ("zigzag", 24, 8),
    ("rays", 400, 1), ("rays", 40, 3), ("rings", 300, 2), ("rings", 30, 4), ("rings", 12, 8), ("curve", 6, 6),
    ("curve", 12, 4), ("curve", 30, 2), ("curve", 80, 1),
)  # fmt: skip
_STRIPES: Final = {
    "checkerboard": ((1, 1), (2, 2), (4, 4), (16, 16), (32, 32)), "comb": ((1, 1), (3, 1), (3, 3), (16, 16)),
    "grid": ((1, 1), (1, 3), (3, 8), (4, 24), (6, 40), (12, 90)), "squares": ((1, 1), (2, 1), (6, 3), (40, 8)),
    "winding line": ((1, 1), (2, 1), (4, 2), (10, 5)),
}  # fmt: skip
PATTERNS: Final[dict[str, Draw]] = {
    **{f"noise {p:.0%}, {g} px": partial(_noise, share=p, grain=g)
       for p, g in product((0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.95), (1, 2, 4, 8, 16))},
    **{f"{ways} {a}/{b}": partial(_stripes, line=a, gap=b, ways=ways) for ways in _STRIPES for a, b in _STRIPES[ways]},
    **{f"maze {k}": partial(_maze, line=k) for k in (1, 2, 4, 8, 16)},
    **{f"{n} {kind}, {k} px": partial(_strokes, count=n, thick=k, kind=kind) for kind, n, k in _LINES},
    **{f"text {k:g}": partial(_text, scale=k) for k in (0.3, 0.5, 1.0, 2.0)},
    **{f"line of {k} px in {p:.2%} dust": partial(_dust, thick=k, share=p)
       for k, p in ((4, 0.05), (12, 0.05), (12, 0.15), (40, 0.0005), (40, 0.05), (200, 0.05))},
    "full": lambda rng, size: np.full(size[::-1], 255, np.uint8),
}  # fmt: skip
