"""Measure the processor time of a frame over masks that are no object: noise, text, combs, mazes, rings, pieces."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import pairwise, product
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.scenes import moving_blob, moving_rope, moving_sheet
from shape_obs.camera import Intrinsics
from shape_obs.configurations.base import Configuration
from shape_obs.configurations.centerline import Centerline
from shape_obs.configurations.contour import Contour
from shape_obs.configurations.surface import Surface
from shape_obs.detector import ShapeDetector
from shape_obs.image.segmentation import GrayRange
from shape_obs.shape import Detection, Shape
from shape_obs.utils.threads import one_thread
from tests.benchmarks import Size
from tests.benchmarks.tables import Row, at_most, failures, grouped, of, summary, worst

Mask = npt.NDArray[np.uint8]
Draw = Callable[[np.random.Generator, Size], Mask]

SIZES: Final[dict[Size, float]] = {(640, 480): 25.0, (1280, 720): 75.0}  # and milliseconds asked
HICCUP: Final = 10.0  # milliseconds asked of a tracked sequence at 640 x 480
SHAPES: Final[dict[str, tuple[type[Configuration], Callable[..., Iterable[Any]]]]] = {
    "centerline": (Centerline, partial(moving_rope, speed=6.0, frames=26)),
    "contour": (Contour, partial(moving_blob, turn=0.02, speed=4.0, swell=0.1, frames=26)),
    "surface": (Surface, partial(moving_sheet, speed=6.0, frames=26)),
}
INPUTS: Final = ("mask", "mask and depth", "image", "cloud")
_TRACKED: Final = 20  # good frames before the bad one
_ENOUGH: Final = 200.0  # milliseconds: what takes longer is not repeated
_REPEATS: Final = 3


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
    return canvas


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


class Scene(NamedTuple):
    """A pattern as a detector may be given it: ``(H, W)`` mask, depth in metres and ``(H, W, 3)`` image."""

    mask: Mask
    depth: npt.NDArray[np.float32]
    rgb: Mask
    camera: Intrinsics


def scene_of(mask: Mask, rng: np.random.Generator) -> Scene:
    """Return a mask with an image of the same pixels, and with noisy depth under it."""
    height, width = mask.shape
    depth = (0.7 + 0.002 * rng.standard_normal(mask.shape)).astype(np.float32)
    camera = Intrinsics(width, height, float(width), float(width), width / 2 - 0.5, height / 2 - 0.5)
    return Scene(mask, depth, np.repeat(mask[..., None], 3, axis=2), camera)


def detector_for(name: str, given: str) -> ShapeDetector:
    """Return a detector of a configuration for one of the inputs."""
    spec = SHAPES[name][0](lift="cloud" if given == "cloud" else "points")
    return ShapeDetector([spec], GrayRange(low=128), on_missing="hold")


def detect(detector: ShapeDetector, scene: Scene, given: str) -> Detection:
    """Detect in one of the inputs."""
    if given == "mask":
        return detector.detect_mask(scene.mask)
    if given == "image":
        return detector.detect(scene.rgb, scene.depth, scene.camera)
    return detector.detect_mask(scene.mask, scene.depth, scene.camera)


def worst_cases(
    size: Size,
    seed: int = 0,
    inputs: Iterable[str] = INPUTS,
    shapes: Iterable[str] = tuple(SHAPES),
    patterns: Iterable[str] = tuple(PATTERNS),
) -> Iterator[Row]:
    """Detect every pattern without a track.

    Yields:
        ``ms``: least processor time of one frame in up to three tries; ``passes``: the same in times of one
        ``cv2.sumElems`` over the image; ``ok``; ``reason``.
    """
    detectors = {(name, given): detector_for(name, given) for name, given in product(shapes, inputs)}
    with one_thread():
        for index, pattern in enumerate(patterns):
            rng = np.random.default_rng([seed, index])
            scene = scene_of(PATTERNS[pattern](rng, size), rng)
            one_pass = min(_milliseconds(partial(cv2.sumElems, scene.rgb))[0] for _ in range(20))
            for (name, given), detector in detectors.items():
                taken: list[tuple[float, Shape]] = []
                while len(taken) < _REPEATS and not (taken and taken[0][0] > _ENOUGH):
                    detector.reset()
                    took, found = _milliseconds(partial(detect, detector, scene, given))
                    taken.append((took, found.shapes[0]))
                took, shape = min(taken, key=lambda each: each[0])
                row = Row(size=f"{size[0]}x{size[1]}", pattern=pattern, shape=name, given=given, ms=took)
                yield Row(row, passes=took / one_pass, ok=shape.ok, reason=shape.reason)


def hiccups(
    seed: int = 0,
    inputs: Iterable[str] = INPUTS[:3],
    shapes: Iterable[str] = tuple(SHAPES),
    patterns: Iterable[str] = tuple(PATTERNS),
) -> Iterator[Row]:
    """Track an object at 640 x 480 for 20 frames; then one frame is a pattern, and the object returns.

    Yields:
        ``bad_ms``: processor time of the frame with the pattern; ``after_ms``: that of the slowest of the five frames
        after it, both the least of three tries; ``ok``: whether the last frame was found.
    """
    size = (640, 480)
    with one_thread():
        for name, given in product(shapes, inputs):
            rng = np.random.default_rng(seed)
            detector = detector_for(name, given)
            good = [scene_of(drawn.mask, rng) for drawn in SHAPES[name][1](rng)]
            for index, pattern in enumerate(patterns):
                bad = scene_of(PATTERNS[pattern](np.random.default_rng([seed, index]), size), rng)
                taken, ok = [], False
                for _ in range(_REPEATS):
                    detector.reset()
                    frames = [*good[:_TRACKED], bad, *good[_TRACKED : _TRACKED + 5]]
                    found = [_milliseconds(partial(detect, detector, scene, given)) for scene in frames]
                    taken.append([took for took, _ in found[_TRACKED:]])
                    ok = found[-1][1].ok and not found[-1][1].shapes[0].reason
                    if taken[-1][0] > _ENOUGH:
                        break
                first, *rest = np.min(taken, axis=0).tolist()
                yield Row(pattern=pattern, shape=name, given=given, bad_ms=first, after_ms=max(rest), ok=ok)


def slowest(rows: list[Row], by: Sequence[str], times: Sequence[str]) -> list[Row]:
    """Return the longest times of each group of rows, how many shapes were not found, and the slowest pattern."""
    columns = {"patterns": len, "not_ok": failures("ok"), **{name: of(worst, name) for name in times}}
    pattern = {"slowest": lambda found: max(found, key=lambda row: row[times[0]]).pattern}
    return summary(rows, by, {**columns, **pattern})


def targets(cold: list[Row], tracked: list[Row]) -> list[Row]:
    """Return the slowest frames against what is asked of them."""
    rows = []
    for size, found in grouped(cold, lambda row: row.size).items():
        asked = next(limit for (width, height), limit in SIZES.items() if size == f"{width}x{height}")
        rows.append(at_most(f"slowest pattern at {size}", asked, max(row.ms for row in found), " ms"))
    if tracked:
        slowest = max(max(row.bad_ms, row.after_ms) for row in tracked)
        rows.append(at_most("slowest frame of a tracked sequence with one pattern in it", HICCUP, slowest, " ms"))
    return rows


def _milliseconds(call: Callable[[], Any]) -> tuple[float, Any]:
    """Return the processor time of a call, and its result."""
    begin = time.process_time()
    result = call()
    return 1e3 * (time.process_time() - begin), result


def _mask(inside: npt.NDArray[Any]) -> Mask:
    return np.where(inside, 255, 0).astype(np.uint8)
