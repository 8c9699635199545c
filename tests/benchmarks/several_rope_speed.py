"""Measure what it costs to follow several ropes: apart, and where they meet, against one rope of their length."""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.configurations.centerline import Centerline
from shape_obs.detector import ShapeDetector
from tests.benchmarks.interleaved_timing import Method, Timing, median_ms, time_methods
from tests.benchmarks.tables import Row

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.uint8]

_SIZE: Final = (480, 640)
_WIDTH: Final = 9
_LENGTH: Final = 480.0  # of each of three ropes, pixels
_WARM_UP: Final = 20
_ONE: Final = "one rope as long as three"


def warm_costs(frames: int, seed: int = 0) -> list[Row]:
    """Follow one rope, three ropes apart and three that cross, which sway, with the same pixels of rope in each frame.

    Returns:
        A row for each: ``scene``; ``found``: the share of frames in which all ropes were found; ``ms``: the median time
        of ``detect_mask``; ``to_one``: over that of the one rope.
    """
    names = {_ONE: 1, "three ropes apart": 3, "three ropes that cross": 3}
    methods = [
        Method(name, _detect(ShapeDetector([Centerline(n=20, count=count if count > 1 else None)]), kind))
        for kind, (name, count) in enumerate(names.items())
    ]
    films = [[_mask(kind, 2 * np.pi * k / 90) for kind in range(3)] for k in range(frames + _WARM_UP)]
    turns = time_methods(films, methods, Timing(seed=seed), warm_up=_WARM_UP)
    times = {name: median_ms(some) for name, some in turns.items()}
    found = {name: float(np.mean([turn.result for turn in some])) for name, some in turns.items()}
    return [Row(scene=name, found=found[name], ms=ms, to_one=ms / times[_ONE]) for name, ms in times.items()]


def _detect(detector: ShapeDetector, kind: int) -> Any:
    return lambda masks: detector.detect_mask(masks[kind]).ok


def _mask(kind: int, phase: float) -> Mask:
    """Draw a scene at a moment of its motion: 0 one long rope, 1 three ropes apart, 2 three that cross."""
    sway = 6 * np.sin(phase)
    if kind == 0:
        curves = [_cut(_spiral(sway), 3 * _LENGTH)]
    else:
        along = np.linspace(-1, 1, 400)
        middle, curves = np.array([_SIZE[1], _SIZE[0]]) / 2, []
        for k in range(3):
            turn = 0.0 if kind == 1 else np.pi * k / 3
            wave = np.stack([300 * along, 25 * np.sin(4 * along + k + phase)], axis=1)
            rotated = wave @ [[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]
            shift = (sway, 130.0 * (k - 1)) if kind == 1 else (sway * (k - 1) + 25 * (k - 1), 0.0)
            curves.append(_cut(middle + rotated + shift, _LENGTH))
    mask = np.zeros(_SIZE, np.uint8)
    for curve in curves:
        cv2.polylines(mask, [np.round(curve * 16).astype(np.int32)], False, (255.0,), _WIDTH, cv2.LINE_8, 4)
    return mask


def _spiral(sway: float) -> Array:
    angle = np.linspace(0, 12.2, 2000)
    radius = 35 + 16 * angle
    return np.stack([320 + sway + radius * np.cos(angle), 240 + radius * np.sin(angle)], axis=1)


def _cut(curve: Array, length: float) -> Array:
    """Return the middle part of a curve that has a length, all of it if it is shorter."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    spare = max(arc[-1] - length, 0.0) / 2
    return curve[(arc >= spare) & (arc <= arc[-1] - spare)]
