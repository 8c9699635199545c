"""The accuracy that the project claims, measured: drawn ropes, moving ropes, the simulated cable.

The tests run slices of these functions; ``shape-obs bench claims`` runs them whole.

Ropes under hard conditions: a hand over a part of them, noise, ragged edges, uneven light.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.bench.scores import Score, score, tally
from shape_obs.bench.synthetic.disturbances import Where, hidden_rope, photographed, ragged, salted
from shape_obs.bench.synthetic.ropes import KINDS, Kind, moving_rope, random_rope
from shape_obs.bench.synthetic.sheets import noisy
from shape_obs.configurations import Centerline, Ends
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.polyline import arc_length, interpolate
from shape_obs.image.segmentation import HSVRange
from shape_obs.shape import Shape

COUNTS: Final = (8, 20, 50, 100)

_BOTH_ENDS: Final[tuple[Ends, ...]] = ("centers", "tips")


class RopeResult(NamedTuple):
    """One drawn rope, looked at cold. ``hairpin``: a gap is longer than the rope's narrowest bend is wide."""

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


class CableResult(NamedTuple):
    """Episodes of the simulated cable under random actions, visible surface against truth."""

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
    """Cold detections of random ropes with a known centreline, at each N and in both end modes."""
    rng = np.random.default_rng(seed)
    for kind in kinds:
        for _ in range(per_kind):
            rope = random_rope(rng, kind)
            for n in counts:
                for ends in _BOTH_ENDS:
                    shape = ShapeDetector([Centerline(n=n, ends=ends)]).detect_mask(rope.mask).shapes[0]
                    judged = score(shape.pixels, rope.curve, ends, directed=False)
                    hairpin = rope.length / n > 2 * rope.bend_radius
                    yield RopeResult(kind, n, hairpin, ends, shape.ok, judged)


def moving_ropes(
    speeds: Iterable[float], seeds: Iterable[int], frames: int = 180, n: int = 20
) -> Iterator[MotionResult]:
    """Ropes that wander and bend, point 0 told once by an anchor at the first frame."""
    for seed in seeds:
        for speed in speeds:
            scores: list[Score] = []
            detector, not_ok = None, 0
            for rope in moving_rope(np.random.default_rng(seed), speed, frames):
                if detector is None:
                    detector = ShapeDetector(
                        [Centerline(n=n, ends="tips", anchor=(rope.curve[0][0], rope.curve[0][1]))]
                    )
                shape = detector.detect_mask(rope.mask).shapes[0]
                not_ok += not shape.ok
                scores.append(score(shape.pixels, rope.curve, "tips"))
            yield MotionResult(
                speed=speed,
                **tally(scores),
                not_ok=not_ok,
                mean_distance=float(np.mean([s.distance for s in scores])),
            )


def cable_episodes(camera: Any, renderer: str, seeds: Iterable[int], steps: int = 50) -> CableResult:
    """Random actions on ``ShapeObs/Cable-v0``; the wrapper's visible surface against the simulator's truth."""
    import gymnasium as gym

    from shape_obs.wrappers import ShapeObservation

    shapes = [{"kind": "centerline", "n": 20, "anchor": "gripper0", "ends": "tips", "spacing": "m"}]
    env = ShapeObservation(gym.make("shape_obs_envs:ShapeObs/Cable-v0", camera=camera, renderer=renderer), shapes)
    simulator: Any = env.unwrapped
    flips = slips = not_ok = wrong = episodes = 0
    mm: list[float] = []
    px: list[float] = []
    for seed in seeds:
        episodes += 1
        env.action_space.seed(seed)
        env.reset(seed=seed)
        for step in range(steps + 1):
            assert env.detection is not None
            shape = env.detection.shapes[0]
            axis = simulator.truth(n=400, frame="camera", surface=True)
            truth = simulator.truth(n=20, frame="camera", surface=True)
            pixels = simulator.truth(n=20, frame="pixels", surface=True)
            assert shape.points3d is not None
            judged = score(shape.points3d, axis, "tips")
            error = float(np.linalg.norm(shape.points3d - truth, axis=1).mean())
            slipped = judged.slip > 0.5
            flips, slips, not_ok = flips + judged.flipped, slips + slipped, not_ok + (not shape.ok)
            wrong += shape.ok and (slipped or error > 0.015)
            mm.append(1e3 * error)
            px.append(float(np.linalg.norm(shape.pixels - pixels, axis=1).mean()))
            if step < steps:
                env.step(env.action_space.sample())
    env.close()
    name = camera if isinstance(camera, str) else f"{camera[0]}x{camera[1]}"
    worst_mm, worst_px = max(mm), max(px)
    mean_mm, mean_px = float(np.mean(mm)), float(np.mean(px))
    return CableResult(
        name, renderer, episodes, len(mm), flips, slips, not_ok, wrong, mean_mm, worst_mm, mean_px, worst_px
    )


def rope_table(results: Iterable[RopeResult]) -> list[dict[str, Any]]:
    """Worst and mean by kind of rope."""
    rows: dict[str, list[RopeResult]] = {}
    for result in results:
        rows.setdefault(result.kind, []).append(result)
    return [_rope_row(kind, found) for kind, found in rows.items()]


def _rope_row(kind: str, found: list[RopeResult]) -> dict[str, Any]:
    # Where a bend is narrower than a gap, equal chords would move points off their material.
    spaced = [r.score.gap_cv for r in found if r.n >= 12 and not r.hairpin]
    tight = [r.score.gap_cv for r in found if r.n >= 12 and r.hairpin]
    tips = [r.score.tip for r in found if r.ends == "tips"]
    distances = [r.score.distance for r in found]
    return {
        "kind": kind,
        "ropes": len(found) // len({(r.n, r.ends) for r in found}),
        "order_wrong": sum(not r.score.ordered for r in found),
        "not_ok": sum(not r.ok for r in found),
        "distance_mean_px": float(np.mean(distances)),
        "distance_worst_px": float(np.max(distances)),
        "tip_mean_px": float(np.mean(tips)),
        "tip_worst_px": float(np.max(tips)),
        "tips_over_1.5_px": float(np.mean(np.array(tips) > 1.5)),
        "gap_cv_worst": float(np.max(spaced)),
        "narrow_bends": len(tight),
        "gap_cv_worst_there": float(np.max(tight, initial=0.0)),
    }


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
