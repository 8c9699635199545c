"""Ropes under hard conditions: a hand over a part of them, noise, ragged edges, uneven light."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.bench.disturbances import photographed, ragged, salted
from shape_obs.bench.hands import Where, hidden_rope
from shape_obs.bench.ropes import KINDS, Kind, random_rope
from shape_obs.bench.scores import score
from shape_obs.bench.sheets import noisy
from shape_obs.configurations import Centerline
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.polyline import arc_length, interpolate
from shape_obs.image.segmentation import HSVRange
from shape_obs.shape import Shape

_BLUE: Final = HSVRange(low=(100, 80, 25), high=(130, 255, 255))


class HandResult(NamedTuple):
    """A moving rope of which a hand hides a part.

    Args:
        where: Which part is hidden.
        share: Of the length.
        creep: Frames over which the hand comes; 0 at once.
        speed: Of the rope, pixels per frame.
        frames: How many.
        lost: Frames in which the shape was refused.
        slips: Frames with a visible point more than half a gap from where it belongs.
        worst_slip: Gaps.
        called_hidden: Visible points that were called hidden, of all.
        called_visible: Hidden points that were called visible, of all, but for the two beside the hand.
    """

    where: Where
    share: float
    creep: int
    speed: float
    frames: int
    lost: int
    slips: int
    worst_slip: float
    called_hidden: float
    called_visible: float


class NoiseResult(NamedTuple):
    """Drawn ropes under one disturbance, each looked at cold."""

    disturbance: str
    level: float
    ropes: int
    ordered: float
    refused: float
    mean_distance: float


def ropes_under_hands(
    seeds: Iterable[int],
    *,
    speeds: Sequence[float] = (4, 10),
    shares: Sequence[float] = (0.1, 0.25),
    places: Sequence[Where] = ("start", "end"),
    creeps: Sequence[int] = (0, 12),
    frames: int = 180,
    n: int = 20,
) -> Iterator[HandResult]:
    """Ropes that wander and bend while a hand comes over them and leaves again."""
    for seed in seeds:
        for speed in speeds:
            for share in shares:
                for where in places:
                    for creep in creeps:
                        yield _under_hand(seed, speed, share, where, creep, frames, n)


def _under_hand(seed: int, speed: float, share: float, where: Where, creep: int, frames: int, n: int) -> HandResult:
    detector, lost, slips, worst = None, 0, 0, 0.0
    wrong = np.zeros(2)
    for frame in hidden_rope(np.random.default_rng(seed), speed, share, where, creep=creep, frames=frames):
        curve = frame.rope.curve
        if detector is None:
            detector = ShapeDetector([Centerline(n=n, ends="tips", anchor=(curve[0][0], curve[0][1]))])
        shape = detector.detect_mask(frame.mask).shapes[0]
        if shape.reason:
            lost += 1
            continue
        arc = arc_length(curve)
        truth = interpolate(curve, arc, np.linspace(0, arc[-1], n))
        column, row = np.rint(truth).astype(int).T
        seen = frame.mask[row, column] > 0
        gaps = np.linalg.norm(shape.pixels - truth, axis=1) / (arc[-1] / (n - 1))
        slip = float(gaps[seen & shape.visible].max(initial=0.0))
        worst, slips = max(worst, slip), slips + (slip > 0.5)
        beside = seen | np.roll(seen, 1) | np.roll(seen, -1)
        wrong += [np.sum(seen & ~shape.visible), np.sum(~beside & shape.visible)]
    hidden, visible = wrong / (n * frames)
    return HandResult(where, share, creep, speed, frames, lost, slips, worst, float(hidden), float(visible))


def ropes_in_noise(per_kind: int, seed: int = 0, kinds: Sequence[Kind] = KINDS, n: int = 20) -> Iterator[NoiseResult]:
    """Drawn ropes with flipped pixels, ragged edges, and photographed in uneven light."""

    def by_mask(disturb: Callable[[npt.NDArray[np.uint8]], npt.NDArray[np.uint8]]) -> Callable[..., Shape]:
        return lambda mask: ShapeDetector([Centerline(n=n)]).detect_mask(disturb(mask)).shapes[0]

    def by_image(contrast: float, noise: float) -> Callable[..., Shape]:
        detector = ShapeDetector([Centerline(n=n)], _BLUE)

        def detect(mask: npt.NDArray[np.uint8]) -> Shape:
            detector.reset()
            return detector.detect(photographed(rng, mask, contrast, noise)).shapes[0]

        return detect

    rng = np.random.default_rng(seed)
    levels: list[tuple[str, float, Callable[..., Shape]]] = [
        *(("salt and pepper", s, by_mask(lambda mask, s=s: salted(rng, mask, s))) for s in (0.01, 0.03, 0.05)),
        *(("ragged edges, px", d, by_mask(lambda mask, d=d: ragged(rng, mask, d))) for d in (1.0, 2.0)),
        *(("light, times brighter", c, by_image(c, 6.0)) for c in (2.0, 4.0, 8.0)),
    ]
    ropes = [random_rope(rng, kind) for kind in kinds for _ in range(per_kind)]
    for name, level, detect in levels:
        shapes = [detect(rope.mask) for rope in ropes]
        found = [
            score(shape.pixels, rope.curve, "centers", directed=False)
            for shape, rope in zip(shapes, ropes, strict=True)
            if shape.ok
        ]
        yield NoiseResult(
            name,
            level,
            len(ropes),
            ordered=sum(judged.ordered for judged in found) / len(ropes),
            refused=sum(not shape.ok for shape in shapes) / len(ropes),
            mean_distance=float(np.mean([judged.distance for judged in found])),
        )


class JitterResult(NamedTuple):
    """Ropes at rest whose masks are cut anew from noisy images in every frame.

    Args:
        kind: Of rope.
        noise: Of the image, rms, as a share of the contrast between rope and table.
        ropes: How many.
        jitter_px: Distance of the points from their mean places, pixels rms over all ropes.
        worst_rope_px: The same for the worst rope.
    """

    kind: str
    noise: float
    ropes: int
    jitter_px: float
    worst_rope_px: float


def flickering_ropes(
    per_kind: int, seed: int = 0, frames: int = 60, n: int = 20, sigmas: Sequence[float] = (0.05, 0.1, 0.15)
) -> Iterator[JitterResult]:
    """Ropes at rest in masks whose edges flicker."""
    rng = np.random.default_rng(seed)
    for kind in KINDS:
        ropes = [random_rope(rng, kind) for _ in range(per_kind)]
        for sigma in sigmas:
            squares = [_wander(rope.mask, sigma, frames, n, rng) for rope in ropes]
            yield JitterResult(kind, sigma, per_kind, float(np.sqrt(np.mean(squares))), float(np.sqrt(np.max(squares))))


def _wander(mask: npt.NDArray[np.uint8], sigma: float, frames: int, n: int, rng: np.random.Generator) -> float:
    """Mean square distance of a resting rope's points from their mean places, square pixels."""
    detector = ShapeDetector([Centerline(n=n)])
    found = [detector.detect_mask(noisy(mask, rng, sigma)).shapes[0].pixels for _ in range(frames)]
    points = np.stack(found).astype(np.float64)
    return float(np.sum((points - points.mean(axis=0)) ** 2, axis=2).mean())
