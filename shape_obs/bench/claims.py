"""The accuracy that the project claims, measured: drawn ropes, moving ropes, the simulated cable.

The tests run slices of these functions; ``shape-obs bench claims`` runs them whole.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from shape_obs.bench.motion import moving_rope
from shape_obs.bench.ropes import KINDS, Kind, random_rope
from shape_obs.bench.scores import Score, score, tally
from shape_obs.configurations import Centerline, Ends
from shape_obs.detector import ShapeDetector

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
