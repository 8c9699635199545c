"""Measure the accuracy of centerlines: drawn and moving ropes, hands, noise, flicker, and the simulated cable."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import product
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.bench.photos import BLUE, photographed
from shape_obs.bench.scenes import Rope, moving_rope
from shape_obs.configurations.centerline import Centerline
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.polyline import arc_length, resample
from shape_obs.shape import Shape
from tests.benchmarks import Mask, at_rest, cold, followed
from tests.benchmarks.scenes.hidden_ropes import Where, hidden_rope
from tests.benchmarks.scenes.images import ragged, salted
from tests.benchmarks.scenes.ropes import BENDS, KINDS, bend_radius, bending_rope, bent_rope, random_rope
from tests.benchmarks.scenes.sheets import noisy
from tests.benchmarks.scenes.tangles import Tangle, looped_rope
from tests.benchmarks.scores import BOTH_ENDS, SLIP, faithfulness, score, tally
from tests.benchmarks.tables import Row, failures, mean, of, summary, worst

COUNTS: Final = (8, 20, 50, 100)
_N: Final = 20  # points of a tracked rope


def drawn_ropes(per_kind: int, seed: int = 0) -> Iterator[Row]:
    """Detect random ropes with a known centreline cold, at each N and in both end modes.

    Yields:
        The fields of ``score`` and the rope's; ``hairpin``: a gap is longer than the tightest bend is wide.
    """
    rng = np.random.default_rng(seed)
    for kind, _ in product(KINDS, range(per_kind)):
        rope = random_rope(rng, kind)
        for n, ends in product(COUNTS, BOTH_ENDS):
            shape = cold(Centerline(n=n, ends=ends), rope.mask)
            found = score(shape.pixels, rope.curve, ends, directed=False)
            hairpin = rope.length / n > 2 * bend_radius(rope)
            yield Row(kind=kind, n=n, ends=ends, hairpin=hairpin, ok=shape.ok, **found)


def rope_table(results: Iterable[Row]) -> list[Row]:
    """Return the mean and the worst result of each kind of rope."""

    def from_tip_to_tip(row: Row) -> bool:
        return row.ends == "tips"

    # Where a bend is narrower than a gap, equal chords would move points away from their material.
    def spaced(row: Row) -> bool:
        return row.n >= 12 and not row.hairpin

    def tight(row: Row) -> bool:
        return row.n >= 12 and row.hairpin

    columns = {
        "ropes": lambda found: len(found) // len({(row.n, row.ends) for row in found}),
        "order_wrong": failures("ordered"),
        "not_ok": failures("ok"),
        "distance_mean_px": of(mean, "distance"),
        "distance_worst_px": of(worst, "distance"),
        "tip_mean_px": of(mean, "tip", from_tip_to_tip),
        "tip_worst_px": of(worst, "tip", from_tip_to_tip),
        "tips_over_1.5_px": of(lambda tips: mean(tip > 1.5 for tip in tips), "tip", from_tip_to_tip),
        "gap_cv_worst": of(worst, "gap_cv", spaced),
        "narrow_bends": of(len, "gap_cv", tight),
        "gap_cv_worst_there": of(worst, "gap_cv", tight),
    }
    return summary(results, ("kind",), columns)


def bent_ropes(
    per_kind: int, seed: int = 0, *, radii: Sequence[float] = (1.5, 2, 3), widths: Sequence[float] = (4, 6, 9, 14)
) -> Iterator[Row]:
    """Detect ropes that bend to a radius of a few widths, cold, after 10 frames at rest, and while they bend.

    Yields:
        A row for each kind of bend, radius and way of detection, over all widths. ``within``: the share of the length
        within half a width, of the axis from the found curve or of the found curve from the axis, whichever is less;
        ``least_within`` that of the worst rope; ``distance`` and ``farthest``: the mean over the axis and the largest
        distance between the two, in widths.
    """
    spec = Centerline(n=256, ends="tips")
    draws = {bend: partial(bent_rope, bend=bend) for bend in BENDS} | {"loops": looped_rope}
    for radius, (index, (bend, draw)) in product(radii, enumerate(draws.items())):
        rng = np.random.default_rng([seed, round(10 * radius), index])
        ropes = [draw(rng, radius=radius, width=width) for width in widths for _ in range(per_kind)]
        shapes = [at_rest(spec, [rope.mask] * 10)[0] for rope in ropes]
        for way, frame in (("cold", 0), ("tracked", -1)):
            yield _faithful(bend, radius, way, [(rope, each[frame]) for rope, each in zip(ropes, shapes, strict=True)])
    for radius in radii:
        frames = [list(followed(bending_rope(radius, width), lambda _: ShapeDetector([spec]))) for width in widths]
        found = [(rope, detection.shapes[0]) for each in frames for rope, detection in each[len(each) // 2 :]]
        yield _faithful("bending", radius, "tracked", found)


def _faithful(bend: str, radius: float, way: str, found: Sequence[tuple[Rope | Tangle, Shape]]) -> Row:
    """Return a row of ``bent_ropes``."""
    scores = [faithfulness(shape.pixels, rope.curve, rope.width) for rope, shape in found if shape.ok]
    return Row(
        bend=bend,
        radius=radius,
        detected=way,
        ropes=len(found),
        refused=len(found) - len(scores),
        within=mean(each.within for each in scores),
        least_within=min(each.within for each in scores),
        distance=mean(each.distance for each in scores),
        farthest=max(each.farthest for each in scores),
    )


def _anchored(rope: Rope) -> ShapeDetector:
    """Return a detector whose point 0 is anchored at the rope's first point."""
    u, v = rope.curve[0].tolist()
    return ShapeDetector([Centerline(n=_N, ends="tips", anchor=(u, v))])


def moving_ropes(speeds: Iterable[float], seeds: Iterable[int]) -> Iterator[Row]:
    """Track ropes that wander and bend; an anchor gives point 0 in the first frame.

    Yields:
        A row for each track; lengths in pixels, slips in gaps.
    """
    for seed, speed in product(seeds, speeds):
        found = list(followed(moving_rope(np.random.default_rng(seed), speed), _anchored))
        scores = [score(detection.shapes[0].pixels, rope.curve, "tips") for rope, detection in found]
        flips, not_ok = sum(each.flipped for each in scores), sum(not detection.ok for _, detection in found)
        distance = mean(each.distance for each in scores)
        yield Row(speed=speed, flips=flips, not_ok=not_ok, mean_distance=distance, **tally(scores))


def ropes_under_hands(
    seeds: Iterable[int],
    *,
    speeds: Sequence[float] = (4, 10),
    shares: Sequence[float] = (0.1, 0.25),
    places: Sequence[Where] = ("start", "end"),
) -> Iterator[Row]:
    """Track ropes that wander and bend while a hand covers them and leaves again.

    Yields:
        ``where``: the hidden part; ``share``: hidden share of the length; ``creep``: frames over which the hand
        arrives, 0 at once; ``speed``: pixels per frame; ``lost``: frames in which the shape was refused; ``slips``:
        frames with a visible point more than half a gap from its true position, ``worst_slip`` the largest such
        distance in gaps; ``called_hidden``: share of all points that are visible and were reported hidden;
        ``called_visible``: share of all points that are hidden, farther than one point from the edge of the hand, and
        were reported visible.
    """
    for seed, speed, share, where, creep in product(seeds, speeds, shares, places, (0, 12)):
        lost, slips, wrong = 0, [0.0], np.zeros(2)
        motion = list(hidden_rope(np.random.default_rng(seed), speed, share, where, creep=creep))
        for frame, detection in followed(motion, lambda frame: _anchored(frame.rope)):
            shape = detection.shapes[0]
            if shape.reason:
                lost += 1
                continue
            truth = resample(frame.rope.curve, _N)
            column, row = np.rint(truth).astype(int).T
            seen = frame.mask[row, column] > 0
            gap = arc_length(np.ascontiguousarray(frame.rope.curve))[-1] / (_N - 1)
            gaps = np.linalg.norm(shape.pixels - truth, axis=1) / gap
            slips.append(float(gaps[seen & shape.visible].max(initial=0.0)))
            near_seen = seen | np.roll(seen, 1) | np.roll(seen, -1)
            wrong += [np.sum(seen & ~shape.visible), np.sum(~near_seen & shape.visible)]
        hidden, visible = wrong / (_N * len(motion))
        yield Row(
            where=where,
            share=share,
            creep=creep,
            speed=speed,
            frames=len(motion),
            lost=lost,
            slips=sum(slip > SLIP for slip in slips),
            worst_slip=max(slips),
            called_hidden=float(hidden),
            called_visible=float(visible),
        )


def ropes_in_noise(per_kind: int, seed: int = 0) -> Iterator[Row]:
    """Detect drawn ropes with flipped pixels, ragged edges, and photographed in uneven light, each of them cold."""
    rng = np.random.default_rng(seed)
    disturbances: dict[str, tuple[tuple[float, ...], Callable[[Mask, float], Any]]] = {
        "salt and pepper": ((0.01, 0.03, 0.05), lambda mask, share: salted(rng, mask, share)),
        "ragged edges, px": ((1.0, 2.0), lambda mask, depth: ragged(rng, mask, depth)),
        "light, times brighter": ((2.0, 4.0, 8.0), lambda mask, contrast: photographed(rng, mask, contrast, 6.0)),
    }
    ropes = [random_rope(rng, kind) for kind in KINDS for _ in range(per_kind)]
    for name, (levels, disturb) in disturbances.items():
        for level in levels:
            detector, found = ShapeDetector([Centerline(n=_N)], BLUE), []
            for rope in ropes:
                detector.reset()
                image = disturb(rope.mask, level)
                shape = (detector.detect_mask(image) if image.ndim == 2 else detector.detect(image)).shapes[0]
                if shape.ok:
                    found.append(score(shape.pixels, rope.curve, "centers", directed=False))
            yield Row(
                disturbance=name,
                level=level,
                ropes=len(ropes),
                ordered=sum(each.ordered for each in found) / len(ropes),
                refused=(len(ropes) - len(found)) / len(ropes),
                mean_distance=mean(each.distance for each in found),
            )


def flickering_ropes(per_kind: int, seed: int = 0) -> Iterator[Row]:
    """Detect ropes at rest in 60 masks, each of them cut from another noisy image.

    Yields:
        ``noise``: RMS noise as a share of the contrast; ``jitter_px``: RMS distance of the points from their mean
        positions, over all ropes, and ``worst_rope_px`` for the worst rope.
    """
    rng = np.random.default_rng(seed)
    for kind in KINDS:
        ropes = [random_rope(rng, kind) for _ in range(per_kind)]
        for sigma in (0.05, 0.1, 0.15):
            squares = []
            for rope in ropes:
                masks = (noisy(rope.mask, rng, sigma) for _ in range(60))
                squares.append(at_rest(Centerline(n=_N), masks)[1].mean())
            jitter, highest = float(np.sqrt(np.mean(squares))), float(np.sqrt(np.max(squares)))
            yield Row(kind=kind, noise=sigma, ropes=per_kind, jitter_px=jitter, worst_rope_px=highest)


def cable_episodes(camera: Any, renderer: str, seeds: Sequence[int]) -> Row:
    """Run random actions on ``ShapeObs/Cable-v0`` and compare the detected visible surface with the simulator's."""
    from shape_obs.wrappers import ShapeObservation
    from tests.benchmarks.env_physics import EPISODE, make_env

    shapes = [{"kind": "centerline", "n": 20, "anchor": "gripper0", "ends": "tips", "spacing": "m"}]
    env = ShapeObservation(make_env("Cable", {"camera": camera, "renderer": renderer}), shapes)
    simulator: Any = env.unwrapped
    frames: list[Row] = []
    for seed in seeds:
        env.action_space.seed(seed)
        env.reset(seed=seed)
        for step in range(EPISODE + 1):
            assert env.detection is not None
            shape = env.detection.shapes[0]
            assert shape.points3d is not None
            axis, truth, pixels = (
                simulator.truth(n=n, frame=frame, surface=True)
                for n, frame in ((400, "camera"), (20, "camera"), (20, "pixels"))
            )
            found, mm = score(shape.points3d, axis, "tips"), 1e3 * _apart(shape.points3d, truth)
            wrong = shape.ok and (found.slip > SLIP or mm > 15)
            frames.append(Row(found, ok=shape.ok, wrong=wrong, mm=mm, px=_apart(shape.pixels, pixels)))
            if step < EPISODE:
                env.step(env.action_space.sample())
    env.close()
    return Row(
        camera=camera if isinstance(camera, str) else f"{camera[0]}x{camera[1]}",
        renderer=renderer,
        episodes=len(seeds),
        frames=len(frames),
        flips=sum(frame.flipped for frame in frames),
        slips=sum(frame.slip > SLIP for frame in frames),
        not_ok=sum(not frame.ok for frame in frames),
        unflagged_wrong=sum(frame.wrong for frame in frames),
        mean_mm=mean(frame.mm for frame in frames),
        worst_frame_mm=max(frame.mm for frame in frames),
        mean_px=mean(frame.px for frame in frames),
        worst_frame_px=max(frame.px for frame in frames),
    )


def _apart(points: npt.NDArray[Any], truth: npt.NDArray[Any]) -> float:
    return float(np.linalg.norm(points - truth, axis=1).mean())
