"""Claims about accuracy and speed, measured against known truth: ``uv run python -m tests.benchmarks``.

Here is how drawn objects are detected: in one mask without a track, frame by frame, and at rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any, Final, Literal, TypeAlias, TypeVar, get_args

import numpy as np
import numpy.typing as npt

from shape_obs.configurations.base import Configuration
from shape_obs.detector import ShapeDetector
from shape_obs.shape import Detection, Shape

S = TypeVar("S")
Mask: TypeAlias = npt.NDArray[np.uint8]
Env = Literal["Cable", "Ring", "Cloth", "Hanging"]
ENVS: Final[tuple[Env, ...]] = get_args(Env)


def cold(spec: Configuration, mask: Mask) -> Shape:
    """Detect a shape in one mask, without a track."""
    return ShapeDetector([spec]).detect_mask(mask).shapes[0]


def followed(
    scenes: Iterable[S],
    begin: Callable[[S], ShapeDetector],
    detect: Callable[[ShapeDetector, Any], Detection] = lambda detector, scene: detector.detect_mask(scene.mask),
) -> Iterator[tuple[S, Detection]]:
    """Track an object through the frames of a motion.

    Args:
        scenes: The frames.
        begin: Takes the first frame, in which an anchor may name point 0, and returns the detector.
        detect: Takes the detector and a frame; by default it detects in the frame's mask.
    """
    detector = None
    for scene in scenes:
        detector = detector or begin(scene)
        yield scene, detect(detector, scene)


def at_rest(spec: Configuration, masks: Iterable[Mask]) -> tuple[list[Shape], npt.NDArray[np.float64]]:
    """Track an object at rest whose mask changes.

    Returns:
        The shape in each mask, and the squared distances of its points from their mean positions, (frames, N) pixels.
    """
    detector = ShapeDetector([spec])
    shapes = [detector.detect_mask(mask).shapes[0] for mask in masks]
    points = np.stack([shape.pixels for shape in shapes]).astype(np.float64)
    return shapes, np.sum((points - points.mean(axis=0)) ** 2, axis=2)
