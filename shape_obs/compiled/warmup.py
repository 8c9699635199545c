"""Compiling what will be needed before the first frame, not in it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from shape_obs.camera import Intrinsics
from shape_obs.compiled import Kernels
from shape_obs.configurations import Configuration, Surface
from shape_obs.image.segmentation import HSVRange

if TYPE_CHECKING:
    from shape_obs.detector import ShapeDetector

_RED: Final = HSVRange(low=(0, 200, 200), high=(5, 255, 255))
_SIZE: Final = (120, 160)
_FRAMES: Final = 3  # a cold start, the first tracked frame, and one that looks only where the shape is expected
_GROWTH: Final = np.ones((21, 21), np.uint8)
_done: set[tuple[str, str]] = set()


def warm_up(detector: type[ShapeDetector], shapes: Iterable[Configuration], backend: str) -> None:
    """Run a detector over drawn frames, once in a process for each kind of shape and way to fit it.

    Functions that were compiled by an earlier process are loaded; the very first time takes some ten seconds.

    Args:
        detector: The class.
        shapes: What will be looked for.
        backend: What runs the inner loops.
    """
    for spec in shapes:
        if (spec.kind, backend) in _done:
            continue
        _done.add((spec.kind, backend))
        rgb = _drawing(isinstance(spec, Surface))
        mask = rgb[..., 0].copy()
        plain = replace(spec, anchor=None, segmentation=None, spacing="px", order="tracked", lift="points")
        seen, given, cloud = (detector([plain], _RED, backend=backend) for _ in range(3))
        camera = Intrinsics(_SIZE[1], _SIZE[0], 150.0, 150.0, 79.5, 59.5)
        points = camera.deproject(np.argwhere(mask)[:, ::-1].astype(np.float64), 0.5)
        for _ in range(_FRAMES):
            seen.detect(rgb, np.full(_SIZE, 500, np.uint16), camera)
            given.detect_mask(mask, np.full(_SIZE, 0.5, np.float32), camera)
        given.detect_mask(np.asarray(cv2.dilate(mask, _GROWTH), np.uint8))  # refused, so a cold start follows a track
        for _ in range(2):
            cloud.detect_cloud(points)
        _run_rare_ones(seen.kernels)


def _run_rare_ones(kernels: Kernels) -> None:
    """What only frames need in which something goes wrong."""
    around = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ring = np.stack([np.cos(around), np.sin(around)], axis=1)
    kernels.lag(ring, ring, ring)
    kernels.blend(ring, ring, 0.1)
    kernels.corners_near(ring, np.arange(4) * 6, 0.26, ring[::6].copy())


def _drawing(sheet: bool) -> np.ndarray:
    """A red rope or sheet on black."""
    image = np.zeros((*_SIZE, 3), np.uint8)
    if sheet:
        cv2.fillPoly(image, [np.array([(40, 30), (120, 36), (114, 90), (36, 84)], np.int32)], (255.0, 0.0, 0.0))
    else:
        bent = [(20, 40), (60, 70), (100, 60), (140, 80)]
        cv2.polylines(image, [np.array(bent, np.int32)], False, (255.0, 0.0, 0.0), 13)
    return image
