"""Measure the accuracy of centerlines: drawn and moving ropes, hands, noise, flicker, and the simulated cable."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import product
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.bench.scores import Score, score, tally
from shape_obs.bench.synthetic.images import BLUE, Where, hidden_rope, photographed, ragged, salted
from shape_obs.bench.synthetic.ropes import KINDS, Kind, moving_rope, random_rope
from shape_obs.bench.synthetic.sheets import noisy
from shape_obs.bench.tables import Row, grouped, mean, worst
from shape_obs.configurations.base import Ends
from shape_obs.configurations.centerline import Centerline
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.polyline import arc_length, interpolate

Mask = npt.NDArray[np.uint8]

COUNTS: Final = (8, 20, 50, 100)
_BOTH_ENDS: Final[tuple[Ends, ...]] = ("centers", "tips")


class RopeResult(NamedTuple):
    """One drawn rope, detected cold. ``hairpin``: a gap is longer than the tightest bend is wide."""

    kind: str
    n: int
    hairpin: bool
    ends: Ends
    ok: bool
    score: Score


class MotionResult(NamedTuple):
    """One moving rope, tracked; lengths in pixels, slips in gaps."""

    speed: float
    frames: int
    flips: int
    slips: int
    not_ok: int
    worst_slip: float
    mean_distance: float


class HandResult(NamedTuple):
    """One moving rope, partly hidden by a hand.

    Args:
        where: The hidden part.
        share: Hidden share of the length.
        creep: Frames over which the hand arrives; 0 at once.
        speed: Speed of the rope, in pixels per frame.
        frames: Number of frames.
        lost: Frames in which the shape was refused.
        slips: Frames with a visible point more than half a gap from its true position.
        worst_slip: The largest such distance, in gaps.
        called_hidden: Share of all points that are visible and were reported hidden.
        called_visible: Share of all points that are hidden, farther than one point from the edge of the hand, and
            were reported visible.
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
    """Drawn ropes under one disturbance, each detected cold."""

    disturbance: str
    level: float
    ropes: int
    ordered: float
    refused: float
    mean_distance: float


class JitterResult(NamedTuple):
    """Ropes at rest whose masks are cut from another noisy image in every frame.

    ``noise`` is the RMS noise as a share of the contrast; ``jitter_px`` the RMS distance of the points from their mean
    positions, in pixels, over all ropes; ``worst_rope_px`` the same for the worst rope.
    """

    kind: str
    noise: float
    ropes: int
    jitter_px: float
    worst_rope_px: float


class CableResult(NamedTuple):
    """Episodes of the simulated cable under random actions, compared with the true visible surface."""

    camera: str
    renderer: str
    episodes: int
    frames: int
    flips: int
    slips: int
    not_ok: int
    unflagged_wrong: int
    mean_mm: float
    worst_frame_mm: float
    mean_px: float
    worst_frame_px: float


def drawn_ropes(
    per_kind: int, seed: int = 0, counts: Sequence[int] = COUNTS, kinds: Sequence[Kind] = KINDS
) -> Iterator[RopeResult]:
    """Detect random ropes with a known centreline cold, at each N and in both end modes."""
    rng = np.random.default_rng(seed)
    for kind in kinds:
        for _ in range(per_kind):
            rope = random_rope(rng, kind)
            for n, ends in product(counts, _BOTH_ENDS):
                shape = ShapeDetector([Centerline(n=n, ends=ends)]).detect_mask(rope.mask).shapes[0]
                found = score(shape.pixels, rope.curve, ends, directed=False)
                yield RopeResult(kind, n, rope.length / n > 2 * rope.bend_radius, ends, shape.ok, found)


def _anchored(curve: npt.NDArray[np.float64], n: int) -> ShapeDetector:
    """Return a detector whose point 0 is anchored at the curve's first point."""
    return ShapeDetector([Centerline(n=n, ends="tips", anchor=(curve[0][0], curve[0][1]))])


def moving_ropes(
    speeds: Iterable[float], seeds: Iterable[int], frames: int = 180, n: int = 20
) -> Iterator[MotionResult]:
    """Track ropes that wander and bend; an anchor gives point 0 in the first frame."""
    for seed, speed in product(seeds, speeds):
        scores: list[Score] = []
        detector, not_ok = None, 0
        for rope in moving_rope(np.random.default_rng(seed), speed, frames):
            detector = detector or _anchored(rope.curve, n)
            shape = detector.detect_mask(rope.mask).shapes[0]
            not_ok += not shape.ok
            scores.append(score(shape.pixels, rope.curve, "tips"))
        distance = mean(each.distance for each in scores)
        yield MotionResult(speed=speed, **tally(scores), not_ok=not_ok, mean_distance=distance)


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
    """Track ropes that wander and bend while a hand covers them and leaves again."""
    for seed, speed, share, where, creep in product(seeds, speeds, shares, places, creeps):
        yield _under_hand(seed, speed, share, where, creep, frames, n)


def _under_hand(seed: int, speed: float, share: float, where: Where, creep: int, frames: int, n: int) -> HandResult:
    detector, lost, slips = None, 0, [0.0]
    wrong = np.zeros(2)
    for frame in hidden_rope(np.random.default_rng(seed), speed, share, where, creep=creep, frames=frames):
        curve = frame.rope.curve
        detector = detector or _anchored(curve, n)
        shape = detector.detect_mask(frame.mask).shapes[0]
        if shape.reason:
            lost += 1
            continue
        curve = np.ascontiguousarray(curve)
        arc = arc_length(curve)
        truth = interpolate(curve, arc, np.linspace(0, arc[-1], n))
        column, row = np.rint(truth).astype(int).T
        seen = frame.mask[row, column] > 0
        gaps = np.linalg.norm(shape.pixels - truth, axis=1) / (arc[-1] / (n - 1))
        slips.append(float(gaps[seen & shape.visible].max(initial=0.0)))
        near_seen = seen | np.roll(seen, 1) | np.roll(seen, -1)
        wrong += [np.sum(seen & ~shape.visible), np.sum(~near_seen & shape.visible)]
    hidden, visible = wrong / (n * frames)
    slipped = sum(slip > 0.5 for slip in slips)
    return HandResult(where, share, creep, speed, frames, lost, slipped, max(slips), float(hidden), float(visible))


def ropes_in_noise(per_kind: int, seed: int = 0, kinds: Sequence[Kind] = KINDS, n: int = 20) -> Iterator[NoiseResult]:
    """Detect drawn ropes with flipped pixels, ragged edges, and photographed in uneven light."""
    rng = np.random.default_rng(seed)
    disturbances: dict[str, tuple[tuple[float, ...], Callable[[Mask, float], Any]]] = {
        "salt and pepper": ((0.01, 0.03, 0.05), lambda mask, share: salted(rng, mask, share)),
        "ragged edges, px": ((1.0, 2.0), lambda mask, depth: ragged(rng, mask, depth)),
        "light, times brighter": ((2.0, 4.0, 8.0), lambda mask, contrast: photographed(rng, mask, contrast, 6.0)),
    }
    ropes = [random_rope(rng, kind) for kind in kinds for _ in range(per_kind)]
    for name, (levels, disturb) in disturbances.items():
        for level in levels:
            detector, shapes = ShapeDetector([Centerline(n=n)], BLUE), []
            for rope in ropes:
                detector.reset()
                image = disturb(rope.mask, level)
                detection = detector.detect_mask(image) if image.ndim == 2 else detector.detect(image)
                shapes.append(detection.shapes[0])
            found = [
                score(shape.pixels, rope.curve, "centers", directed=False)
                for shape, rope in zip(shapes, ropes, strict=True)
                if shape.ok
            ]
            ordered = sum(each.ordered for each in found) / len(ropes)
            refused = sum(not shape.ok for shape in shapes) / len(ropes)
            yield NoiseResult(name, level, len(ropes), ordered, refused, mean(each.distance for each in found))


def flickering_ropes(
    per_kind: int, seed: int = 0, frames: int = 60, n: int = 20, sigmas: Sequence[float] = (0.05, 0.1, 0.15)
) -> Iterator[JitterResult]:
    """Detect ropes at rest in masks whose edges flicker."""
    rng = np.random.default_rng(seed)
    for kind in KINDS:
        ropes = [random_rope(rng, kind) for _ in range(per_kind)]
        for sigma in sigmas:
            squares = []
            for rope in ropes:
                detector = ShapeDetector([Centerline(n=n)])
                found = [detector.detect_mask(noisy(rope.mask, rng, sigma)).shapes[0].pixels for _ in range(frames)]
                points = np.stack(found).astype(np.float64)
                squares.append(np.sum((points - points.mean(axis=0)) ** 2, axis=2).mean())
            yield JitterResult(kind, sigma, per_kind, float(np.sqrt(np.mean(squares))), float(np.sqrt(np.max(squares))))


def cable_episodes(camera: Any, renderer: str, seeds: Sequence[int], steps: int = 50) -> CableResult:
    """Run random actions on ``ShapeObs/Cable-v0`` and compare the detected visible surface with the simulator's."""
    import gymnasium as gym

    from shape_obs.wrappers import ShapeObservation

    shapes = [{"kind": "centerline", "n": 20, "anchor": "gripper0", "ends": "tips", "spacing": "m"}]
    env = ShapeObservation(gym.make("shape_obs_envs:ShapeObs/Cable-v0", camera=camera, renderer=renderer), shapes)
    simulator: Any = env.unwrapped
    flips = slips = not_ok = wrong = 0
    mm: list[float] = []
    px: list[float] = []
    for seed in seeds:
        env.action_space.seed(seed)
        env.reset(seed=seed)
        for step in range(steps + 1):
            assert env.detection is not None
            shape = env.detection.shapes[0]
            assert shape.points3d is not None
            axis, truth, pixels = (
                simulator.truth(n=n, frame=frame, surface=True)
                for n, frame in ((400, "camera"), (20, "camera"), (20, "pixels"))
            )
            found = score(shape.points3d, axis, "tips")
            error = float(np.linalg.norm(shape.points3d - truth, axis=1).mean())
            slipped = found.slip > 0.5
            flips, slips, not_ok = flips + found.flipped, slips + slipped, not_ok + (not shape.ok)
            wrong += shape.ok and (slipped or error > 0.015)
            mm.append(1e3 * error)
            px.append(float(np.linalg.norm(shape.pixels - pixels, axis=1).mean()))
            if step < steps:
                env.step(env.action_space.sample())
    env.close()
    name = camera if isinstance(camera, str) else f"{camera[0]}x{camera[1]}"
    counts = len(seeds), len(mm), flips, slips, not_ok, wrong
    return CableResult(name, renderer, *counts, mean(mm), max(mm), mean(px), max(px))


def rope_table(results: Iterable[RopeResult]) -> list[Row]:
    """Return the mean and the worst result of each kind of rope."""
    return [_rope_row(kind, found) for kind, found in grouped(results, lambda result: result.kind).items()]


def _rope_row(kind: str, found: list[RopeResult]) -> Row:
    # Where a bend is narrower than a gap, equal chords would move points away from their material.
    spaced, tight = ([r.score.gap_cv for r in found if r.n >= 12 and r.hairpin is wanted] for wanted in (False, True))
    tips = [r.score.tip for r in found if r.ends == "tips"]
    distances = [r.score.distance for r in found]
    return {
        "kind": kind,
        "ropes": len(found) // len({(r.n, r.ends) for r in found}),
        "order_wrong": sum(not r.score.ordered for r in found),
        "not_ok": sum(not r.ok for r in found),
        "distance_mean_px": mean(distances),
        "distance_worst_px": worst(distances),
        "tip_mean_px": mean(tips),
        "tip_worst_px": worst(tips),
        "tips_over_1.5_px": mean(tip > 1.5 for tip in tips),
        "gap_cv_worst": worst(spaced),
        "narrow_bends": len(tight),
        "gap_cv_worst_there": worst(tight),
    }
