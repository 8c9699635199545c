"""What a further shape costs in one pass over a frame."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np

from shape_obs.bench.disturbances import photographed
from shape_obs.bench.sheets import random_sheet
from shape_obs.configurations import Configuration, Contour, Surface
from shape_obs.detector import ShapeDetector
from shape_obs.image.segmentation import HSVRange

_BLUE: Final = HSVRange(low=(100, 80, 25), high=(130, 255, 255))
_LISTS: Final[tuple[tuple[str, tuple[Configuration, ...]], ...]] = (
    ("contour", (Contour(),)),
    ("surface", (Surface(),)),
    ("contour + surface", (Contour(), Surface())),
    ("2 contours + surface", (Contour(), Contour(name="coarse", n=12), Surface())),
    ("2 contours + 2 surfaces", (Contour(), Contour(name="coarse", n=12), Surface(), Surface(name="fine", rows=8))),
)


class PassResult(NamedTuple):
    """One detector over the same frames, 640 x 480, tracked; medians in milliseconds.

    Args:
        shapes: What it looks for.
        number: How many shapes.
        frame_ms: Segmentation and region, once a frame.
        shapes_ms: Fitting and ordering, all shapes.
        total_ms: All of it.
        per_shape: The total over the first row's.
    """

    shapes: str
    number: int
    frame_ms: float
    shapes_ms: float
    total_ms: float
    per_shape: float


def shared_passes(frames: int = 60, seed: int = 0) -> Iterator[PassResult]:
    """Lists of shapes of growing length over one sheet; the detectors take turns on every frame."""
    rng = np.random.default_rng(seed)
    image = photographed(rng, random_sheet(rng, 1.6, 20.0).mask, 1.5, 4.0)
    detectors = [ShapeDetector(shapes, _BLUE) for _, shapes in _LISTS]
    spent: list[list[tuple[float, float, float]]] = [[] for _ in detectors]
    for _ in range(frames):
        for times, detector in zip(spent, detectors, strict=True):
            stages = detector.detect(image).timings
            frame = stages["segmentation"]
            times.append((frame, stages["fit"] + stages["lift"], stages["total"]))
    medians = [np.median(times[1:], axis=0) for times in spent]
    for (name, shapes), (frame, fit, total) in zip(_LISTS, medians, strict=True):
        yield PassResult(name, len(shapes), float(frame), float(fit), float(total), float(total / medians[0][2]))
