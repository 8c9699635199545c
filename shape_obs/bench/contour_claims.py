"""The accuracy that is claimed for contours, measured: drawn blobs, garments, turning rings, flickering masks.

The tests run slices of these functions; ``shape-obs bench claims`` runs them whole.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.scores import OutlineScore, outline_score
from shape_obs.bench.synthetic.blobs import KINDS, Blob, Kind, moving_blob, random_blob
from shape_obs.bench.synthetic.ropes import resample
from shape_obs.configurations import Contour
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.form import Curve
from shape_obs.geometry.polyline import equidistant_around

COUNTS: Final = (16, 32, 64)
# What is asked of the tracking: keywords of ``moving_blob``, beside a turn of 0.08 rad per frame.
MOTIONS: Final[dict[str, dict[str, Any]]] = {
    "ring": {},
    "ring backwards": {"turn": -0.08},
    "nearly round": {"bumps": 0.03},
    "12 px a frame": {"speed": 12},
    "40 px a frame": {"speed": 40},
    "deforming": {"turn": 0.03, "swell": 0.4},
    "hole": {"hole": True},
}
# Gaps. Equal chords may move points along the outline by 1.5 gaps (``curve.equidistant_around``); what needs this much
# on the true outline may need all of it on the one that was found.
_COARSE: Final = 1.3


class BlobResult(NamedTuple):
    """One drawn outline, looked at cold.

    Args:
        kind: Of blob.
        n: How many points.
        coarse: Even on the true outline, equal chords would move so few points by 1.3 gaps or more from equal arc
            length, since it bends within a gap: gaps may be unequal then, so that points stay on their material.
        ok: Found.
        score: Against the truth; the slip means nothing here.
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
    """One outline that stands still while pixels along its border flip.

    Args:
        kind: Of blob.
        flipped: Share of the pixels on either side of the border that flip.
        not_ok: Frames that were refused.
        rms: Root mean square distance of the points from their mean places, pixels.
        drift: Mean distance of the points between the first and the last tenth of the frames, pixels.
    """

    kind: str
    flipped: float
    not_ok: int
    rms: float
    drift: float


def drawn_blobs(per_kind: int, seed: int = 0, kinds: Sequence[Kind] = KINDS) -> Iterator[Blob]:
    """Random blobs with a known outline."""
    rng = np.random.default_rng(seed)
    for kind in kinds:
        for _ in range(per_kind):
            yield random_blob(rng, kind)


def outlines(blobs: Iterable[Blob], counts: Sequence[int] = COUNTS) -> Iterator[BlobResult]:
    """Cold detections of drawn blobs at each N."""
    for blob in blobs:
        length = float(np.linalg.norm(np.roll(blob.outline, -1, axis=0) - blob.outline, axis=1).sum())
        for n in counts:
            shape = ShapeDetector([Contour(n=n)]).detect_mask(blob.mask).shapes[0]
            found = shape.pixels.astype(np.float64)
            coarse = _shift(blob.outline, found[0], n) > _COARSE
            corners = tuple(
                float(np.linalg.norm(found - corner, axis=1).min()) / length for corner in blob.corners.values()
            )
            yield BlobResult(blob.kind, n, coarse, shape.ok, outline_score(found, blob.outline), corners)


def turning_blobs(
    motions: Mapping[str, Mapping[str, Any]] = MOTIONS, seeds: Iterable[int] = (0,), frames: int = 180, n: int = 32
) -> Iterator[TurningResult]:
    """Outlines that turn, wander and deform, point 0 told once by an anchor at the first frame."""
    for seed in seeds:
        for motion, keywords in motions.items():
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
                mean_distance=float(np.mean([s.distance for s in scores])),
                fit_ms=float(np.median(spent)),
            )


def flickering_blobs(
    blobs: Iterable[Blob], flipped: Sequence[float] = (0.05, 0.1), seed: int = 0, frames: int = 60, n: int = 32
) -> Iterator[JitterResult]:
    """Outlines that stand still in masks whose border pixels flip."""
    for blob in blobs:
        for share in flipped:
            rng = np.random.default_rng(seed)
            detector = ShapeDetector([Contour(n=n)])
            shapes = [detector.detect_mask(_flickering(blob.mask, share, rng)).shapes[0] for _ in range(frames)]
            points = np.array([shape.pixels for shape in shapes], dtype=np.float64)
            few = max(frames // 10, 1)
            yield JitterResult(
                kind=blob.kind,
                flipped=share,
                not_ok=sum(not shape.ok for shape in shapes),
                rms=float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=-1)))),
                drift=float(np.linalg.norm(points[-few:].mean(axis=0) - points[:few].mean(axis=0), axis=-1).mean()),
            )


def outline_table(results: Iterable[BlobResult]) -> list[dict[str, Any]]:
    """Worst and mean by kind of blob and N."""
    rows: dict[tuple[str, int], list[BlobResult]] = {}
    for result in results:
        rows.setdefault((result.kind, result.n), []).append(result)
    return [
        {
            "kind": kind,
            "n": n,
            "blobs": len(found),
            "order_wrong": sum(not (r.score.ordered and r.score.clockwise) for r in found),
            "not_ok": sum(not r.ok for r in found),
            "distance_mean_px": float(np.mean([r.score.distance for r in found])),
            "distance_worst_px": float(np.max([r.score.distance for r in found])),
            "gap_cv_worst": float(np.max([r.score.gap_cv for r in found if not r.coarse], initial=0.0)),
            "too_coarse": sum(r.coarse for r in found),
            "gap_cv_worst_there": float(np.max([r.score.gap_cv for r in found if r.coarse], initial=0.0)),
            "corner_median_share": float(np.median(corners))
            if (corners := [c for r in found for c in r.corners])
            else None,
        }
        for (kind, n), found in rows.items()
    ]


def _shift(outline: npt.NDArray[np.float64], start: npt.NDArray[np.float64], n: int) -> float:
    """How far equal chords take N points on an outline from equal arc length, gaps."""
    fine = resample(np.concatenate([outline, outline[:1]]), 0.25)[:-1]
    begin = int(np.argmin(np.linalg.norm(fine - start, axis=1)))
    curve = Curve(np.roll(fine, -begin, axis=0), np.zeros(len(fine), bool), closed=True)
    return float(np.abs(equidistant_around(curve.points, curve.arc, n) * n / curve.size - np.arange(n)).max())


def _flickering(mask: npt.NDArray[np.uint8], share: float, rng: np.random.Generator) -> npt.NDArray[np.uint8]:
    near = np.ones((3, 3), np.uint8)
    border = cv2.dilate(mask, near) != cv2.erode(mask, near)
    return np.where(border & (rng.random(mask.shape) < share), 255 - mask, mask).astype(np.uint8)
