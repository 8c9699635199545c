"""Several ropes of one colour: in single masks, while they move, which strand is above, and the time of a frame."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.spatial.distance import cdist

from shape_obs.bench.scenes import draw_rope, rotation
from shape_obs.camera import Intrinsics
from shape_obs.configurations.centerline import Centerline
from shape_obs.detector import ShapeDetector
from shape_obs.shape import Detection, Shape
from tests.benchmarks.claim import Claim, Effort, Limit
from tests.benchmarks.rope_scores import judge
from tests.benchmarks.scenes.moving_ropes import MOTIONS, Moment, moving_ropes
from tests.benchmarks.scenes.several_ropes import RopeScene, noisy_depth, several_ropes
from tests.benchmarks.tables import Row, joined, median, of, percent, total
from tests.benchmarks.timing import Method, median_ms, time_methods

Array = npt.NDArray[np.float64]
Size = tuple[int, int]
SIZES: Final[tuple[Size, ...]] = ((480, 640), (672, 896))
MOST_CROSSINGS: Final = {2: 8, 3: 8, 4: 12, 5: 12}  # more of them leave hardly any room for two or three ropes
_N: Final = 160  # points of a curve that is compared with a rope's axis: no farther apart than a width or two
_TRACKED: Final = 20
# In gaps between points: how far a visible point lies from its place on its rope, and from its place at all, if it has
# slipped; how far along the rope a point is looked for.
_SLIP, _OFF, _LOOK = 0.5, 1.5, 2.5
# Ropes seen from straight above, 0.6 m away, that are 8 mm thick or more.
_DISTANCE, _FOCAL = 0.6, 386.0
_THICK: Final = (8e-3 * _FOCAL / _DISTANCE, 14.0)  # pixels
_SPEC: Final = Centerline(n=_N, count="all", ends="tips")


def draw(seed: list[int], count: int, size: Size, width: float | None = None) -> RopeScene:
    """Draw a scene with a random number of crossings; another number where so many do not fit."""
    rng = np.random.default_rng(seed)
    while True:
        with suppress(RuntimeError):
            return several_ropes(rng, count, int(rng.integers(MOST_CROSSINGS[count] + 1)), size, width)


def cold_scenes(effort: Effort) -> Iterator[RopeScene]:
    """Draw scenes of two to five ropes in two image sizes."""
    for size in SIZES:
        for count in MOST_CROSSINGS:
            yield from (draw([effort.seed, count, size[0], k], count, size) for k in range(effort.count(200)))


def cold(scene: RopeScene) -> Row:
    """Find all ropes of a mask.

    Returns:
        ``ropes``: how many there are; ``right``; ``wrong``: given as found, but unlike any rope; ``refused`` slots;
        ``ms``: time of ``detect_mask``.
    """
    begin = time.perf_counter()
    detection = ShapeDetector([_SPEC]).detect_mask(scene.mask)
    ms, found = 1e3 * (time.perf_counter() - begin), [shape.pixels for shape in detection if shape.ok]
    verdict, count, (high, wide) = judge(found, scene), len(scene.curves), scene.mask.shape
    counts = {"right": sum(verdict.right), "wrong": verdict.wrong, "refused": len(detection) - len(found), "all": count}
    return Row(counts, ropes=count, image=f"{wide} x {high}", ms=ms)


def crossing_scenes(effort: Effort) -> Iterator[tuple[RopeScene, np.random.Generator]]:
    """Draw ropes that are 8 mm thick or more, 0.6 m away."""
    for k in range(effort.count(200)):
        rng = np.random.default_rng([effort.seed, k, 8])
        count = int(rng.integers(2, 5))
        yield draw([effort.seed, k, 9], count, SIZES[k % 2], float(rng.uniform(*_THICK))), rng


def levels(scene: tuple[RopeScene, np.random.Generator]) -> Iterator[Row]:
    """Find which strand is above, from the picture alone, from the depth of a D455 alone, and from both."""
    drawn, rng = scene
    depth, (high, wide) = noisy_depth(drawn, rng, _DISTANCE, _FOCAL), drawn.mask.shape
    camera = Intrinsics(wide, high, _FOCAL, _FOCAL, (wide - 1) / 2, (high - 1) / 2)
    for given in ("picture", "depth", "both"):
        measured: tuple[Any, Any] = (None, None) if given == "picture" else (depth, camera)
        rgb = None if given == "depth" else drawn.rgb
        answers = _answers(ShapeDetector([_SPEC]).detect_mask(drawn.mask, *measured, rgb=rgb), drawn)
        right, unknown = answers.count(True), answers.count(None)
        counts = {"right": right, "wrong": answers.count(False), "unknown": unknown, "no_error": right + unknown}
        yield Row(counts, given=given, drawn=len(drawn.crossings), found=len(answers))


def _answers(detection: Detection, scene: RopeScene) -> list[bool | None]:
    """Return for each crossing that was found whether its level is right; None if that is unknown."""
    shapes, answers = [shape for shape in detection if shape.ok], []
    owner = dict(zip([shape.name for shape in shapes], judge([s.pixels for s in shapes], scene).owner, strict=True))
    for found in detection.crossings:
        pair = [owner.get(name, -1) for name in found.slots]
        same = [true for true in scene.crossings if sorted((true.first, true.second)) == sorted(pair)]
        true = min(same, key=lambda true: np.linalg.norm(true.place - found.pixel), default=None)
        if true is None or np.linalg.norm(true.place - found.pixel) > 2 * max(scene.widths):
            continue
        first = pair[0] == true.first  # whether the first strand found is the first one drawn
        if true.first == true.second:
            curve, start = scene.curves[true.first], detection[found.slots[0]].pixels[0]
            forwards = bool(np.linalg.norm(start - curve[0]) < np.linalg.norm(start - curve[-1]))
            first = (true.first_at < true.second_at) == forwards
        answers.append(None if found.above is None else (found.above == 0) == (first == true.first_above))
    return answers


def motions(effort: Effort) -> Iterator[tuple[str, Iterable[Moment]]]:
    """Draw three ropes that move by up to 15 px a frame: over each other, into contact, under a hand, out of sight."""
    for kind in MOTIONS:
        for seed in effort.seeds(60):
            yield kind, moving_ropes(np.random.default_rng([seed, 3]), 3, 180, kind=kind)


def follow(moments: Iterable[Moment], count: int) -> Row:
    """Follow ropes in ``count`` slots and compare each slot with the rope on which it was first found.

    A slot stays with its rope, whatever its ``track_id``. A new ``track_id`` may begin at the other end.

    Returns:
        ``due``: slots times frames in which some rope has no less than half of its length in sight for each of them;
        ``ok``: slots that were found in a frame, those due at most; ``swaps``: found slots that lie on another slot's
        rope; ``flips``: those that are numbered from the other end; ``slips``: those with a visible point that is more
        than half a gap from its place along the rope, of the ``measured`` ones: slots whose rope was cut by the image's
        border when the track began have an unknown length; ``renewed``: new values of ``track_id``; ``ms``: the times
        of ``detect_mask``.
    """
    detector = ShapeDetector([Centerline(n=_TRACKED, count=count, ends="tips")])
    row = Row(due=0, ok=0, swaps=0, flips=0, slips=0, measured=0, renewed=0, ms=[])
    seats: dict[str, int] = {}
    ways: dict[tuple[str, int], tuple[bool, bool]] = {}
    for moment in moments:
        begin = time.perf_counter()
        detection = detector.detect_mask(moment.mask)
        row["ms"].append(1e3 * (time.perf_counter() - begin))
        due = sum(visible.mean() >= 0.5 for visible in moment.visible)
        found = [shape for shape in detection if shape.ok and not shape.reason]
        row["due"] += due
        row["ok"] += min(len(found), due)
        for shape in found:
            fault = _fault(shape, moment, seats, ways)
            row["measured"] += fault in ("", "slips")
            if fault in row:
                row[fault] += 1
    row["renewed"] = len(ways) - len(seats)
    return row


def _fault(shape: Shape, moment: Moment, seats: dict[str, int], ways: dict[tuple[str, int], tuple[bool, bool]]) -> str:
    """Compare a found slot with its rope.

    Args:
        shape: What was found.
        moment: The truth.
        seats: Slot -> its rope; grows.
        ways: Slot and track -> whether point 0 is at the rope's start, and whether all of it was in the image; grows.

    Returns:
        ``"swaps"``, ``"flips"``, ``"slips"``, ``""`` for none of them, or ``"unknown"``.
    """
    points, visible, name = shape.pixels.astype(np.float64), shape.visible, shape.name
    if not visible.any():
        return "unknown"
    away = [cdist(points[visible], curve[::3]).min(axis=1).mean() for curve in moment.curves]
    nearest = int(np.argmin(away))
    if name not in seats and nearest in seats.values():
        return "swaps"  # two slots on one rope
    rope = seats.setdefault(name, nearest)
    if nearest != rope and away[rope] > moment.widths[rope]:
        return "swaps"
    curve = moment.curves[rope]
    at = np.round(np.linspace(0, len(curve) - 1, len(points))).astype(np.intp)
    ends = [np.linalg.norm(points - way[at], axis=1).mean() for way in (curve, curve[::-1])]
    whole = bool(((curve >= -0.5) & (curve <= np.array(moment.mask.shape[::-1]) - 0.5)).all())
    forwards, whole = ways.setdefault((name, shape.track_id), (bool(ends[0] <= ends[1]), whole))
    curve, gap = curve if forwards else curve[::-1], (len(curve) - 1) / (len(points) - 1)
    off, back = ends if forwards else ends[::-1]
    if back < 0.5 * off and off > gap:
        return "flips"
    if not whole:
        return "unknown"
    near = cdist(points, curve)
    near[np.abs(np.arange(len(curve)) - at[:, None]) > _LOOK * gap] = np.inf
    slipped = np.abs(near.argmin(axis=1) - at) > _SLIP * gap
    slipped |= np.linalg.norm(points - curve[at], axis=1) > _OFF * gap
    return "slips" if (visible & slipped).any() else ""


def warm_costs(frames: int) -> Iterator[Row]:
    """Time one rope, three separate ropes and three that cross, swaying, with as many pixels of rope in each frame."""
    counts = {"one rope as long as three": None, "three separate ropes": 3, "three ropes that cross": 3}
    methods: list[Method[list[npt.NDArray[np.uint8]]]] = []
    for kind, (name, count) in enumerate(counts.items()):
        detector = ShapeDetector([Centerline(n=20, count=count)])
        methods.append(Method(name, lambda masks, d=detector, kind=kind: d.detect_mask(masks[kind]).ok))
    films = [[_swaying(kind, 2 * np.pi * k / 90) for kind in range(3)] for k in range(frames + 20)]
    turns = time_methods(films, methods, warm_up=20)
    one = median_ms(next(iter(turns.values())))
    for name, some in turns.items():
        found, ms = 100 * float(np.mean([turn.result for turn in some])), median_ms(some)
        yield Row({"scene": name, "found [%]": found, "median [ms]": ms, "times one rope": ms / one})


def _swaying(kind: int, phase: float) -> npt.NDArray[np.uint8]:
    """Draw a scene at a moment of its motion: 0 one long rope, 1 three separate ropes, 2 three that cross."""
    sway, along, angle = 6 * np.sin(phase), np.linspace(-1, 1, 400), np.linspace(0, 11.35, 1000)
    curves = [(320 + sway, 240) + np.stack([np.cos(angle), np.sin(angle)], axis=1) * (35 + 16 * angle)[:, None]]
    if kind:
        waves = [np.stack([235 * along, 25 * np.sin(4 * along + k + phase)], axis=1) for k in range(3)]
        shifts = [(sway, 130.0 * k) if kind == 1 else ((sway + 25) * k, 0.0) for k in (-1, 0, 1)]
        turned = [wave @ rotation(0.0 if kind == 1 else np.pi * k / 3).T for k, wave in enumerate(waves)]
        curves = [(320, 240) + wave + shift for wave, shift in zip(turned, shifts, strict=True)]
    return np.maximum.reduce([draw_rope(curve, 9.0).mask for curve in curves])


CLAIMS: Final = (
    Claim(
        "several.cold", "Scenes of two to five ropes of one colour, all ropes found in a single mask.",
        cold_scenes, cold, ("ropes", "image"),
        {"scenes": len, "right [%]": percent("right", "all"), "wrong [%]": percent("wrong", "all"),
         "refused [%]": percent("refused", "all"), "median [ms]": of(median, "ms")},
        total=True,
        limits=(
            Limit("right [%]", at_least=98, unit="%", where={"ropes": (2, 3)}, sampled=90),
            Limit("right [%]", at_least=95, unit="%", where={"ropes": (4, 5)}, sampled=90),
            Limit("wrong [%]", at_most=0.5, unit="%", where={"ropes": "all"}, sampled=1),
        ),
    ),
    Claim(
        "several.moving", "Three ropes that move, tracked over 180 frames: swaps, flips, slips.",
        motions, lambda scene: Row(follow(scene[1], 3), kind=scene[0]), ("kind",),
        {"runs": len, "ok [%]": percent("ok", "due"), "swaps": total("swaps"), "flips": total("flips"),
         "slips": total("slips"), "slips [%]": percent("slips", "measured"), "measured": total("measured"),
         "runs with swaps": lambda runs: sum(run.swaps > 0 for run in runs), "renewed": total("renewed"),
         "median [ms]": joined(median, "ms")},
        total=True,
        limits=(
            Limit("flips", at_most=0), Limit("swaps", at_most=0, known="in 16 of 600 sequences"),
            Limit("slips [%]", at_most=0.1, unit="%", where={"kind": ("crossing", "touching", "leaving")},
                  known="0.10 % where ropes are moved across each other"),
            Limit("slips [%]", at_most=3, unit="%"), Limit("ok [%]", at_least=85, unit="%", sampled=60),
            Limit("ok [%]", at_least=95, unit="%", where={"kind": ("crossing", "touching", "leaving")}),
        ),
    ),
    Claim(
        "several.above", "Which strand is above at a crossing, of ropes of 8 mm or more at 0.6 m.",
        crossing_scenes, levels, ("given",),
        {"drawn": total("drawn"), "found": total("found"), "right [%]": percent("right", "found"),
         "wrong [%]": percent("wrong", "found"), "unknown [%]": percent("unknown", "found"),
         "right or unknown [%]": percent("no_error", "found"), "found [%]": percent("found", "drawn")},
        limits=(
            Limit("right or unknown [%]", at_least=95, unit="%", where={"given": "picture"}),
            Limit("right [%]", at_least=99, unit="%", where={"given": ("depth", "both")}),
            Limit("found [%]", at_least=90, unit="%"),
        ),
    ),
    Claim(
        "several.time", "The time of a tracked frame: one rope, three apart, and three that cross.",
        lambda effort: [effort.count(300)], warm_costs,
        limits=(
            Limit("found [%]", at_least=99, unit="%"),
            Limit("times one rope", at_most=1.5, unit="x", where={"scene": "three separate ropes"},
                  known="about twice as long"),
            Limit("times one rope", at_most=1.5, unit="x", where={"scene": "three ropes that cross"},
                  known="about 18 times as long"),
        ),
    ),
)  # fmt: skip
