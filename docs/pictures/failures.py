"""The pictures of 'What can go wrong': uv run python docs/pictures/failures.py."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from sheet import FIRST_KEY, HIDDEN_KEY, NO_DEPTH_KEY, VALID_KEY, Key, band, legend, save
from stages import IMAGES, SIZE, cloth, enlarged, photograph, ring, rope

from shape_obs import Centerline, Contour, Intrinsics, Shape, ShapeDetector, Surface
from shape_obs.bench.scenes import draw_rope
from shape_obs.drawing import HIDDEN, draw_detection
from shape_obs.shape import Detection

Mask = np.ndarray
PINHOLE = Intrinsics(SIZE[1], SIZE[0], 300.0, 300.0, 159.5, 119.5)
HAND = (195, 150, 125)
LETTERS = 26  # pixels of a picture of 640; the page shows it at half of that or less


class Case(NamedTuple):
    """What the camera saw, and what came out."""

    image: np.ndarray
    detection: Detection

    @property
    def shape(self) -> Shape:
        """The one shape."""
        return self.detection.shapes[0]


def over(image: np.ndarray, cover: Mask) -> np.ndarray:
    """Something else lies over the scene."""
    return np.where(cover[..., None] > 0, np.array(HAND, np.uint8), image)


def hidden_end() -> Case:
    """A hand comes over one end of a tracked rope."""
    cover = cv2.circle(np.zeros(SIZE, np.uint8), (278, 70), 38, 255, -1)
    detector = ShapeDetector([Centerline(n=20, ends="tips")])
    detector.detect_mask(rope())
    mask = np.where(cover > 0, 0, rope()).astype(np.uint8)
    return Case(over(photograph({"centerline": rope()}), cover), detector.detect_mask(mask))


def crossed() -> Case:
    """Another object lies across the rope when it is first seen."""
    cover = np.zeros(SIZE, np.uint8)
    cover[:, 150:176] = 255
    mask = np.where(cover > 0, 0, rope()).astype(np.uint8)
    image = over(photograph({"centerline": rope()}), cover)
    return Case(image, ShapeDetector([Centerline(n=20)]).detect_mask(mask))


def no_depth() -> Case:
    """The rope shines, and the camera has no depth for a part of it."""
    depth = np.full(SIZE, 0.7, np.float32)
    depth[:, 180:240] = 0
    return Case(
        photograph({"centerline": rope()}), ShapeDetector([Centerline(n=20)]).detect_mask(rope(), depth, PINHOLE)
    )


def touching() -> Case:
    """Two strands of one rope lie side by side."""
    return cold(draw_rope(keyhole(12.0), 13.0, size=SIZE).mask)


def keyhole(beside: float) -> np.ndarray:
    """Return the mask of a rope that turns round and comes back next to itself."""
    out = np.stack([np.linspace(40, 190, 150), np.full(150, 130.0)], axis=1)
    angle = np.linspace(np.pi / 2, -1.32 * np.pi / 2 - np.pi * 0.34, 200)
    loop = np.stack([200 + 42 * np.cos(angle), 130 - 42 + 42 * np.sin(angle)], axis=1)
    bend = np.linspace(loop[-1], (120, 130 - beside), 60)
    back = np.stack([np.linspace(120, 60, 60), np.full(60, 130 - beside)], axis=1)
    curve = np.concatenate([out, loop, bend, back])
    smooth = cv2.GaussianBlur(curve.reshape(-1, 1, 2), (1, 41), 8, borderType=cv2.BORDER_REPLICATE).reshape(-1, 2)
    return smooth


def branched() -> Case:
    """A wire harness: three arms, which no single rope has."""
    mask = np.zeros(SIZE, np.uint8)
    for end in ((40, 60), (290, 120), (60, 215)):
        cv2.line(mask, (150, 125), end, 255, 11)
    return cold(mask)


def two_ropes() -> Case:
    """Two ropes where one is expected."""
    mask = np.zeros(SIZE, np.uint8)
    cv2.line(mask, (40, 60), (280, 50), 255, 11)
    cv2.line(mask, (50, 180), (270, 200), 255, 11)
    return cold(mask)


def stout() -> Case:
    """A centerline is asked for where there is no rope."""
    return cold(ring())


def cold(mask: Mask) -> Case:
    """A rope is looked for in a single image."""
    image = photograph({"centerline": mask})
    return Case(image, ShapeDetector([Centerline(n=20)]).detect_mask(mask))


def shirt() -> Case:
    """A surface is asked for where there is a T-shirt."""
    half = [(160, 62), (185, 50), (262, 92), (240, 128), (208, 112), (208, 212)]
    outline = np.array([*half, *[(320 - u, v) for u, v in half[:0:-1]]], np.int32)
    mask = cv2.fillPoly(np.zeros(SIZE, np.uint8), [outline], 255)
    return Case(photograph({"surface": mask}), ShapeDetector([Surface(rows=4, cols=8)]).detect_mask(mask))


def hidden_corner() -> Case:
    """A hand comes over one corner of a tracked cloth."""
    cover = cv2.circle(np.zeros(SIZE, np.uint8), (268, 76), 26, 255, -1)
    detector = ShapeDetector([Surface(rows=4, cols=8)])
    detector.detect_mask(cloth(), stamp=0.0)
    mask = np.where(cover > 0, 0, cloth()).astype(np.uint8)
    return Case(over(photograph({"surface": cloth()}), cover), detector.detect_mask(mask, stamp=0.1))


def in_pieces() -> Case:
    """Something lies across a sheet whose outline is asked for."""
    cover = np.zeros(SIZE, np.uint8)
    cover[:, 140:175] = 255
    mask = np.where(cover > 0, 0, cloth()).astype(np.uint8)
    image = over(photograph({"contour": cloth()}), cover)
    return Case(image, ShapeDetector([Contour(n=32)]).detect_mask(mask))


def gone() -> Case:
    """The object has left the image 0.2 s ago."""
    detector = ShapeDetector([Centerline(n=20)])
    detector.detect_mask(rope(), stamp=0.0)
    nothing = np.zeros(SIZE, np.uint8)
    return Case(photograph({"centerline": nothing}), detector.detect_mask(nothing, stamp=0.2))


CASES: dict[str, Callable[[], Case]] = {
    case.__name__: case
    for case in (
        hidden_end,
        crossed,
        no_depth,
        touching,
        branched,
        two_ropes,
        stout,
        shirt,
        hidden_corner,
        in_pieces,
        gone,
    )
}


def picture(case: Case) -> np.ndarray:
    """Return the image with the points that came out; below it what they mean, or why there are none."""
    shape = case.shape
    shown = case.detection if shape.ok else None
    drawn = enlarged(case.image) if shown is None else draw_detection(case.image, silent(shown), scale=2, size=1.6)
    keys: list[Key] = []
    if shape.ok:
        keys = [FIRST_KEY if shape.valid[0] else Key("point 0", HIDDEN, "first")]
        keys += [key for key, where in (
            (VALID_KEY, shape.valid), (NO_DEPTH_KEY, shape.visible & ~shape.valid), (HIDDEN_KEY, ~shape.visible),
        ) if where.any()]  # fmt: skip
    parts = [drawn]
    if keys:
        parts.append(legend(keys, drawn.shape[1], LETTERS))
    if shape.reason:
        parts.append(band(f"Reported: {shape.reason}", drawn.shape[1], LETTERS))
    return np.concatenate(parts)


def silent(detection: Detection) -> Detection:
    """Return the detection without its reason, which stands below the picture."""
    return replace(detection, shapes=tuple(replace(shape, reason="") for shape in detection.shapes))


if __name__ == "__main__":
    for name, make in CASES.items():
        case = make()
        shape = case.shape
        print(f"{name:12} ok={shape.ok!s:5} quality={shape.quality:.2f} valid={shape.valid.sum():2} {shape.reason}")
        save(IMAGES / f"wrong_{name}.jpg", picture(case))
