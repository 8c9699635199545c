"""Measure the accuracy of contours: drawn blobs, garments, turning outlines, flickering masks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import product
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.scores import OutlineScore, outline_score
from shape_obs.bench.synthetic.blobs import KINDS, Blob, Kind, moving_blob, random_blob
from shape_obs.bench.synthetic.ropes import resample
from shape_obs.bench.tables import Row, grouped, mean, median, worst
from shape_obs.configurations.contour import Contour
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.polyline import MAX_SHIFT_AROUND, equal_chords

COUNTS: Final = (16, 32, 64)
# Motions that are tracked: keywords of ``moving_blob``, which by default turns by 0.08 rad per frame.
MOTIONS: Final[dict[str, dict[str, Any]]] = {
    "ring": {},
    "ring backwards": {"turn": -0.08},
    "nearly round": {"bumps": 0.03},
    "12 px a frame": {"speed": 12},
    "40 px a frame": {"speed": 40},
    "deforming": {"turn": 0.03, "swell": 0.4},
    "hole": {"hole": True},
}
# In gaps. Equal chords may move points along the outline by 1.5 gaps (``equal_chords``); an outline that needs
# this much may need all of it once it is detected.
_COARSE: Final = 1.3


class BlobResult(NamedTuple):
    """One drawn outline, detected cold.

    Args:
        kind: Kind of blob.
        n: Number of points.
        coarse: Equal chords would move so few points by 1.3 gaps or more from equal arc length, even on the true
            outline, because it bends within a gap. The gaps may then be unequal, so that points stay on their material.
        ok: Whether it was found.
        score: The comparison with the truth; its slip has no meaning here.
        corners: Distance of each annotated corner to the nearest point, as a share of the outline's length.
    """

    kind: str
    n: int
    coarse: bool
    ok: bool
    score: OutlineScore
    corners: tuple[float, ...]


class TurningResult(NamedTuple):
    """One moving outline, tracked; slips in gaps, the rest in pixels and milliseconds."""

    motion: str
    frames: int
    disordered: int
    slips: int
    not_ok: int
    worst_slip: float
    last_slip: float
    mean_distance: float
    fit_ms: float


class JitterResult(NamedTuple):
    """One outline at rest while pixels along its border flip.

    Args:
        kind: Kind of blob.
        flipped: Share of the pixels on either side of the border that flip.
        not_ok: Refused frames.
        rms: Root mean square distance of the points from their mean positions, in pixels.
        drift: Mean distance of the points between the first and the last tenth of the frames, in pixels.
    """

    kind: str
    flipped: float
    not_ok: int
    rms: float
    drift: float


def drawn_blobs(per_kind: int, seed: int = 0, kinds: Sequence[Kind] = KINDS) -> Iterator[Blob]:
    """Draw random blobs with a known outline."""
    rng = np.random.default_rng(seed)
    for kind in kinds:
        for _ in range(per_kind):
            yield random_blob(rng, kind)


def outlines(blobs: Iterable[Blob], counts: Sequence[int] = COUNTS) -> Iterator[BlobResult]:
    """Detect drawn blobs cold at each N."""
    for blob in blobs:
        length = float(np.linalg.norm(np.roll(blob.outline, -1, axis=0) - blob.outline, axis=1).sum())
        for n in counts:
            shape = ShapeDetector([Contour(n=n)]).detect_mask(blob.mask).shapes[0]
            found = shape.pixels.astype(np.float64)
            coarse = _shift(blob.outline, found[0], n) > _COARSE
            missed = (np.linalg.norm(found - corner, axis=1).min() / length for corner in blob.corners.values())
            corners = tuple(float(each) for each in missed)
            yield BlobResult(blob.kind, n, coarse, shape.ok, outline_score(found, blob.outline), corners)


def turning_blobs(
    motions: Mapping[str, Mapping[str, Any]] = MOTIONS, seeds: Iterable[int] = (0,), frames: int = 180, n: int = 32
) -> Iterator[TurningResult]:
    """Track outlines that turn, wander and deform; an anchor gives point 0 in the first frame."""
    for seed, (motion, keywords) in product(seeds, motions.items()):
        scores: list[OutlineScore] = []
        spent: list[float] = []
        detector, not_ok = None, 0
        for blob in moving_blob(np.random.default_rng(seed), frames=frames, **keywords):
            truth = blob.outline if blob.hole is None else blob.hole
            if detector is None:
                anchor, hole = (float(truth[0, 0]), float(truth[0, 1])), None if blob.hole is None else 0
                detector = ShapeDetector([Contour(n=n, hole=hole, anchor=anchor)])
            detection = detector.detect_mask(blob.mask)
            not_ok += not detection.shapes[0].ok
            spent.append(detection.timings["fit"])
            scores.append(outline_score(detection.shapes[0].pixels, truth))
        yield TurningResult(
            motion=motion,
            frames=len(scores),
            disordered=sum(not (s.ordered and s.clockwise) for s in scores),
            slips=sum(s.slip > 0.5 for s in scores),
            not_ok=not_ok,
            worst_slip=max(s.slip for s in scores),
            last_slip=scores[-1].slip,
            mean_distance=mean(s.distance for s in scores),
            fit_ms=float(np.median(spent)),
        )


def flickering_blobs(
    blobs: Iterable[Blob], flipped: Sequence[float] = (0.05, 0.1), seed: int = 0, frames: int = 60, n: int = 32
) -> Iterator[JitterResult]:
    """Detect outlines at rest in masks whose border pixels flip."""
    near, few = np.ones((3, 3), np.uint8), max(frames // 10, 1)
    for blob, share in product(blobs, flipped):
        rng, detector = np.random.default_rng(seed), ShapeDetector([Contour(n=n)])
        border, shapes = cv2.dilate(blob.mask, near) != cv2.erode(blob.mask, near), []
        for _ in range(frames):
            flips = border & (rng.random(blob.mask.shape) < share)
            shapes.append(detector.detect_mask(np.where(flips, 255 - blob.mask, blob.mask)).shapes[0])
        points = np.array([shape.pixels for shape in shapes], dtype=np.float64)
        yield JitterResult(
            kind=blob.kind,
            flipped=share,
            not_ok=sum(not shape.ok for shape in shapes),
            rms=float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=-1)))),
            drift=float(np.linalg.norm(points[-few:].mean(axis=0) - points[:few].mean(axis=0), axis=-1).mean()),
        )


def outline_table(results: Iterable[BlobResult]) -> list[Row]:
    """Return the mean and the worst result of each kind of blob and N."""
    return [
        {
            "kind": kind,
            "n": n,
            "blobs": len(found),
            "order_wrong": sum(not (r.score.ordered and r.score.clockwise) for r in found),
            "not_ok": sum(not r.ok for r in found),
            "distance_mean_px": mean(r.score.distance for r in found),
            "distance_worst_px": worst(r.score.distance for r in found),
            "gap_cv_worst": worst(r.score.gap_cv for r in found if not r.coarse),
            "too_coarse": sum(r.coarse for r in found),
            "gap_cv_worst_there": worst(r.score.gap_cv for r in found if r.coarse),
            "corner_median_share": median(corner for r in found for corner in r.corners),
        }
        for (kind, n), found in grouped(results, lambda result: (result.kind, result.n)).items()
    ]


def _shift(outline: npt.NDArray[np.float64], start: npt.NDArray[np.float64], n: int) -> float:
    """Return how far equal chords move N points on an outline from equal arc length, in gaps."""
    fine = resample(np.concatenate([outline, outline[:1]]), 0.25)[:-1]
    begin = int(np.argmin(np.linalg.norm(fine - start, axis=1)))
    curve = FittedCurve.through(np.roll(fine, -begin, axis=0), np.zeros(len(fine), bool), closed=True)
    around = np.concatenate([curve.points, curve.points[:1]])
    at = equal_chords(around, curve.arc, around, curve.arc, n + 1, 0.0, MAX_SHIFT_AROUND)[1]
    return float(np.abs(at * n / curve.size - np.arange(n + 1)).max())
