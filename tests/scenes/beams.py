"""Thick, tapering beams that hang from the image's upper border and swing, and how a detector tracks them."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics
from shape_obs.configurations.centerline import Centerline
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.polyline import resample
from tests.scenes.hidden_ropes import camera_of, draw_balls

Array = npt.NDArray[np.float64]
_N: Final = 20
_SIZE: Final = (480, 640)
_BALLS: Final = np.linspace(0, 1, 81)  # places along the beam, of which it is drawn
_WALL: Final = 0.35  # metres behind it
_OFF: Final = (4.0, 0.1)  # pixels from the mask, and of the points: so many lie off the object


class Beam(NamedTuple):
    """A beam in a frame."""

    stamp: float  # seconds
    axis: Array  # (P, 2) pixels, from the border to the tip
    mask: npt.NDArray[np.uint8]
    depth: npt.NDArray[np.float32]  # metres
    camera: Intrinsics


def swinging_beam(
    rng: np.random.Generator, hertz: float, speed: float, frames: int, *, drop: float = 0.0, jitter: float = 0.0
) -> Iterator[Beam]:
    """Draw a beam that swings and bends, now wide and now hardly.

    Args:
        rng: Draws its form (5 to 10 times as long as wide) and its motion.
        hertz: Frames per second.
        speed: The median of its points' speeds where it is fastest, image widths per second.
        frames: How many, with those that are dropped.
        drop: Share of the frames that are dropped, up to four in a row.
        jitter: By which share of an interval stamps are off.
    """
    camera, length, width = camera_of(_SIZE), float(rng.uniform(230, 330)), float(rng.uniform(5, 10))
    taper, distance = float(rng.uniform(0.4, 0.9)), float(rng.uniform(0.5, 0.8))
    swing, lag, bend, pace = rng.uniform((0.5, 0.2, 0.05, 1.5), (1.0, 1.0, 0.2, 3.0))
    phase, calm = rng.uniform(0, 2 * np.pi, 3), float(rng.uniform(0.0, 0.8))
    top, s = np.array([rng.uniform(250, 390), -12.0]), _BALLS
    radius = length / width / 2 * (1 - (1 - taper) * s)

    def axis(angle: float) -> Array:
        wide = 1 - calm * (0.5 + 0.5 * np.sin(angle / 7 + phase[2]))
        heading = wide * swing * np.sin(angle - lag * s + phase[0]) * (0.35 + 0.65 * s)
        heading = heading + wide * bend * np.sin(pace * angle + phase[1]) * np.cos(np.pi * s) * s
        steps = np.stack([np.sin(heading), np.cos(heading)], axis=1) * length / (len(s) - 1)
        return top + np.cumsum(steps, axis=0)

    places = np.array([axis(angle) for angle in np.arange(0, 40, 0.02)])
    fastest = np.median(np.linalg.norm(np.diff(places, axis=0), axis=2), axis=1).max() / 0.02
    rate, time, missing = speed * _SIZE[1] / fastest, 0.0, 0
    for frame in range(frames):
        missing = missing - 1 if missing else int(rng.integers(1, 5)) * int(rng.random() < drop)
        if not frame or not missing:
            line, canvas = axis(rate * time), np.full(_SIZE, np.inf, np.float32)
            drawn = np.flatnonzero(s <= 1 - radius[-1] / length)
            metres = radius[drawn] * distance / camera.fx
            draw_balls(canvas, line[drawn], np.full(len(drawn), distance), metres, camera.fx)
            mask = np.isfinite(canvas).view(np.uint8) * 255
            depth = np.where(mask > 0, canvas, distance + _WALL).astype(np.float32)
            yield Beam(time, line[np.searchsorted(line[:, 1], -0.5) :], mask, depth, camera)
        time += (1 + jitter * float(rng.uniform(-1, 1))) / hertz


def tracked_beam(beams: Iterator[Beam], *, depth: bool = False, **options: Any) -> dict[str, int]:
    """Track a beam by its stamps, from its end at the border to its tip.

    Returns:
        ``frames``; ``refused`` of them, and the ``longest`` run of those; ``strayed``: frames that are ok with points
        off the object; ``turned``: found the other way round, or off by 12 % of its length on average; ``tracks``.
    """
    detector, refused, found = None, list[bool](), {"strayed": 0, "turned": 0, "tracks": 1}
    for beam in beams:
        if detector is None:
            spec = Centerline(n=_N, ends="tips", anchor=(float(beam.axis[0, 0]), 0.0))
            detector = ShapeDetector([spec], **options)
        shape = detector.detect_mask(
            beam.mask, *((beam.depth, beam.camera) if depth else (None, None)), stamp=beam.stamp
        ).shapes[0]
        refused.append(bool(shape.reason))
        points, true = shape.pixels.astype(np.float64), resample(beam.axis, len(beam.axis))
        if not np.isfinite(points).all():  # it was never found
            continue
        u, v = np.clip(np.rint(points), 0, (_SIZE[1] - 1, _SIZE[0] - 1)).astype(int).T
        away = cv2.distanceTransform(255 - beam.mask, cv2.DIST_L2, 3)[v, u]
        found["strayed"] += bool(shape.ok and np.mean(away > _OFF[0]) > _OFF[1])
        off = np.linalg.norm(points - _at(true, np.linspace(0, 1, _N)), axis=1).mean()
        found["turned"] += not shape.reason and bool(off > 0.12 * np.linalg.norm(np.diff(true, axis=0), axis=1).sum())
        found["tracks"] = shape.track_id
    longest = max((len(list(run)) for each, run in groupby(refused) if each), default=0)
    return {"frames": len(refused), "refused": sum(refused), "longest": longest, **found}


def _at(curve: Array, share: Array) -> Array:
    at = np.linspace(0, 1, len(curve))
    return np.stack([np.interp(share, at, column) for column in curve.T], axis=1)
