"""Several ropes of one colour: in single masks, while they move, which strand is above, and the time of a frame."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics
from shape_obs.configurations.centerline import Centerline
from shape_obs.detector import ShapeDetector
from shape_obs.frame import Frame
from shape_obs.geometry import crossings as geometry
from shape_obs.geometry.polyline import arc_length
from shape_obs.image.roi import Window
from shape_obs.image.segmentation import Segmentation
from shape_obs.shape import Detection, Shape
from tests.benchmarks.claim import Claim, Effort, Limit
from tests.benchmarks.rope_scores import judge
from tests.benchmarks.scenes.moving_ropes import MOTIONS, Moment, moving_ropes
from tests.benchmarks.scenes.several_ropes import Crossing, RopeScene, noisy_depth, several_ropes
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
_ANSWERS: Final = {1: "right", 0: "wrong", -1: "unknown"}


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
        ``ms``: time of ``detect_mask``; ``thinning``: that over the time of thinning, None without scikit-image.
    """
    detector = ShapeDetector([Centerline(n=_N, count="all", ends="tips")])
    begin = time.perf_counter()
    detection = detector.detect_mask(scene.mask)
    ms, thinning = 1e3 * (time.perf_counter() - begin), None
    found = [shape.pixels for shape in detection if shape.ok]
    verdict = judge(found, scene)
    if find_spec("skimage") is not None:
        from skimage.morphology import skeletonize

        begin = time.perf_counter()
        skeletonize(scene.mask > 0)
        thinning = ms / (1e3 * (time.perf_counter() - begin))
    count, refused = len(scene.curves), len(detection) - len(found)
    image = f"{scene.mask.shape[1]} x {scene.mask.shape[0]}"
    counts = {"right": sum(verdict.right), "wrong": verdict.wrong, "refused": refused, "all": count}
    return Row(counts, ropes=count, image=image, ms=ms, thinning=thinning)


def crossing_scenes(effort: Effort) -> Iterator[tuple[RopeScene, np.random.Generator]]:
    """Draw ropes that are 8 mm thick or more, 0.6 m away."""
    for k in range(effort.count(200)):
        rng = np.random.default_rng([effort.seed, k, 8])
        count = int(rng.integers(2, 5))
        yield draw([effort.seed, k, 9], count, SIZES[k % 2], float(rng.uniform(*_THICK))), rng


def levels(scene: tuple[RopeScene, np.random.Generator]) -> Iterator[Row]:
    """Find which strand is above, from the picture alone, from the depth of a D455 alone, and from both."""
    drawn, rng = scene
    depth = noisy_depth(drawn, rng, _DISTANCE, _FOCAL)
    high, wide = drawn.mask.shape
    camera = Intrinsics(wide, high, _FOCAL, _FOCAL, (wide - 1) / 2, (high - 1) / 2)
    for given, rgb, metric in (
        ("picture", True, (None, None)),
        ("depth", False, (depth, camera)),
        ("both", True, (depth, camera)),
    ):
        spec = Centerline(n=_N, count="all", ends="tips")
        answers = _answers(detect_scene(drawn, spec, metric[0], metric[1], picture=rgb), drawn)
        counts = {name: answers.count(value) for value, name in _ANSWERS.items()}
        known = counts["right"] + counts["unknown"]
        yield Row(counts, given=given, drawn=len(drawn.crossings), found=len(answers), no_error=known)


def detect_scene(
    scene: RopeScene,
    spec: Centerline,
    depth: npt.NDArray[Any] | None = None,
    camera: Intrinsics | None = None,
    *,
    picture: bool = True,
) -> Detection:
    """Detect ropes in a scene's own mask, with its picture, which no colour rule is asked about."""
    detector = ShapeDetector([replace(spec, segmentation=_Drawn(mask=_Mask(scene.mask)))])
    return detector.detect(scene.rgb if picture else None, depth, camera)


class _Mask:
    """A mask that a segmentation holds; specs are compared by it."""

    def __init__(self, mask: npt.NDArray[np.uint8]) -> None:
        self.mask = mask


@dataclass(frozen=True, eq=False)
class _Drawn(Segmentation):
    """Return a scene's mask, whatever the picture shows."""

    mask: Any = None

    def threshold(self, frame: Frame, window: Window) -> npt.NDArray[np.uint8]:
        """Return the part of the mask in a window."""
        return np.ascontiguousarray(self.mask.mask[window.slices])


def _answers(detection: Detection, scene: RopeScene) -> list[int]:
    """Return for each crossing that was found whether its level is right (1), wrong (0) or unknown (-1)."""
    shapes = [shape for shape in detection if shape.ok]
    owner = dict(zip([shape.name for shape in shapes], judge([s.pixels for s in shapes], scene).owner, strict=True))
    answers = []
    for found in detection.crossings:
        pair = tuple(owner.get(name, -1) for name in found.slots)
        true = _drawn(found, pair, scene)
        if true is None:
            continue
        first = pair[0] == true.first  # whether the first strand found is the first one drawn
        if true.first == true.second:
            curve, start = scene.curves[true.first], detection[found.slots[0]].pixels[0]
            forwards = bool(np.linalg.norm(start - curve[0]) < np.linalg.norm(start - curve[-1]))
            first = (true.first_at < true.second_at) == forwards
        answers.append(-1 if found.above is None else int((found.above == 0) == (first == true.first_above)))
    return answers


def _drawn(found: geometry.Crossing, pair: tuple[int, ...], scene: RopeScene) -> Crossing | None:
    """Return the drawn crossing of two ropes that lies within two widths of one that was found."""
    same = [true for true in scene.crossings if sorted((true.first, true.second)) == sorted(pair)]
    near = min(same, key=lambda true: np.linalg.norm(true.place - found.pixel), default=None)
    reach = 2 * max(scene.widths)
    return near if near is not None and np.linalg.norm(near.place - found.pixel) <= reach else None


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
        ``found``: slots that were found in a frame, and ``ok``: those due at most; ``swaps``: found slots that lie on
        another slot's rope; ``flips``: those that are numbered from the other end; ``slips``: those with a visible
        point that is more than half a gap from its place along the rope, of the ``measured`` ones: slots whose rope
        was cut by the image's border when the track began have an unknown length; ``renewed``: new values of
        ``track_id``; ``ms``: the times of ``detect_mask``.
    """
    detector = ShapeDetector([Centerline(n=_TRACKED, count=count, ends="tips")])
    row = Row(due=0, found=0, ok=0, swaps=0, flips=0, slips=0, measured=0, renewed=0, ms=[])
    seats: dict[str, _Seat] = {}
    for moment in moments:
        begin = time.perf_counter()
        detection = detector.detect_mask(moment.mask)
        row["ms"].append(1e3 * (time.perf_counter() - begin))
        due = sum(visible.mean() >= 0.5 for visible in moment.visible)
        found = [shape for shape in detection if shape.ok and not shape.reason]
        row["due"] += due
        row["found"] += len(found)
        row["ok"] += min(len(found), due)
        for shape in found:
            _compare(shape, moment, seats, row)
    return row


@dataclass(frozen=True)
class _Seat:
    """The rope of a slot, whether point 0 is at its start, whether all of it was in the image, and its track."""

    rope: int
    forwards: bool
    whole: bool
    track_id: int


def _compare(shape: Shape, moment: Moment, seats: dict[str, _Seat], row: Row) -> None:
    """Compare a found slot with its rope, and add what is wrong to a row of ``follow``."""
    points, visible = shape.pixels.astype(np.float64), shape.visible
    if not visible.any():
        return
    away = [np.linalg.norm(points[visible][:, None] - c[None, ::3], axis=2).min(axis=1).mean() for c in moment.curves]
    seat, nearest = seats.get(shape.name), int(np.argmin(away))
    if seat is None and nearest in {other.rope for other in seats.values()}:
        row["swaps"] += 1  # two slots on one rope
        return
    rope = nearest if seat is None else seat.rope
    if nearest != rope and away[rope] > moment.widths[rope]:
        row["swaps"] += 1
        return
    curve = moment.curves[rope]
    if seat is None or seat.track_id != shape.track_id:
        ends = [np.linalg.norm(points - way[_even(way)], axis=1).mean() for way in (curve, curve[::-1])]
        row["renewed"] += seat is not None
        whole = bool(((curve >= -0.5) & (curve <= np.array(moment.mask.shape[::-1]) - 0.5)).all())
        seats[shape.name] = seat = _Seat(rope, bool(ends[0] <= ends[1]), whole, shape.track_id)
    curve = curve if seat.forwards else curve[::-1]
    arc = arc_length(np.ascontiguousarray(curve))
    gap, true = arc[-1] / (len(points) - 1), curve[_even(curve)]
    error = np.linalg.norm(points - true, axis=1)
    if np.linalg.norm(points - true[::-1], axis=1).mean() < 0.5 * error.mean() and error.mean() > gap:
        row["flips"] += 1
        return
    if not seat.whole:
        return
    row["measured"] += 1
    at = np.linspace(0, arc[-1], len(points))
    near = np.linalg.norm(points[:, None] - curve[None], axis=2)
    near[np.abs(arc[None] - at[:, None]) > _LOOK * gap] = np.inf
    along = np.abs(arc[near.argmin(axis=1)] - at)
    row["slips"] += bool((visible & ((along > _SLIP * gap) | (error > _OFF * gap))).any())


def _even(curve: Array) -> npt.NDArray[np.intp]:
    """Return the indices of points at equal steps along a curve whose points are a pixel apart."""
    return np.round(np.linspace(0, len(curve) - 1, _TRACKED)).astype(np.intp)


def warm_costs(frames: int) -> Iterator[Row]:
    """Time one rope, three ropes apart and three that cross, which sway, with as many pixels of rope in each frame."""
    names = {"one rope as long as three": None, "three ropes apart": 3, "three ropes that cross": 3}
    methods: list[Method[list[npt.NDArray[np.uint8]]]] = []
    for kind, (name, count) in enumerate(names.items()):
        detector = ShapeDetector([Centerline(n=20, count=count)])
        methods.append(Method(name, lambda masks, d=detector, kind=kind: d.detect_mask(masks[kind]).ok))
    films = [[_swaying(kind, 2 * np.pi * k / 90) for kind in range(3)] for k in range(frames + 20)]
    turns = time_methods(films, methods, warm_up=20)
    one = median_ms(next(iter(turns.values())))
    for name, some in turns.items():
        found, ms = 100 * float(np.mean([turn.result for turn in some])), median_ms(some)
        yield Row({"scene": name, "found [%]": found, "median [ms]": ms, "times one rope": ms / one})


def _swaying(kind: int, phase: float) -> npt.NDArray[np.uint8]:
    """Draw a scene at a moment of its motion: 0 one long rope, 1 three ropes apart, 2 three that cross."""
    sway, length, curves = 6 * np.sin(phase), 480.0, []
    if kind == 0:
        angle = np.linspace(0, 12.2, 2000)
        around = np.stack([np.cos(angle), np.sin(angle)], axis=1) * (35 + 16 * angle)[:, None]
        curves = [_cut((320 + sway, 240) + around, 3 * length)]
    along = np.linspace(-1, 1, 400)
    for k in range(3 if kind else 0):
        turn = 0.0 if kind == 1 else np.pi * k / 3
        wave = np.stack([300 * along, 25 * np.sin(4 * along + k + phase)], axis=1)
        rotated = wave @ [[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]
        shift = (sway, 130.0 * (k - 1)) if kind == 1 else (sway * (k - 1) + 25 * (k - 1), 0.0)
        curves.append(_cut((320, 240) + rotated + shift, length))
    mask = np.zeros((480, 640), np.uint8)
    for curve in curves:
        cv2.polylines(mask, [np.round(curve * 16).astype(np.int32)], False, (255.0,), 9, cv2.LINE_8, 4)
    return mask


def _cut(curve: Array, length: float) -> Array:
    """Return the middle part of a curve that has a length, all of it if it is shorter."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    spare = max(arc[-1] - length, 0.0) / 2
    return curve[(arc >= spare) & (arc <= arc[-1] - spare)]


CLAIMS: Final = (
    Claim(
        "several.cold", "Scenes of two to five ropes of one colour, all ropes found in a single mask.",
        cold_scenes, cold, ("ropes", "image"),
        {"scenes": len, "right [%]": percent("right", "all"), "wrong [%]": percent("wrong", "all"),
         "refused [%]": percent("refused", "all"), "median [ms]": of(median, "ms"),
         "times thinning": of(median, "thinning")},
        total=True,
        limits=(
            Limit("right [%]", at_least=98, unit="%", where={"ropes": (2, 3)}, sampled=90),
            Limit("right [%]", at_least=95, unit="%", where={"ropes": (4, 5)}, sampled=90),
            Limit("wrong [%]", at_most=0.5, unit="%", where={"ropes": "all"}, sampled=1),
            Limit("times thinning", at_most=2.0, unit="x", where={"ropes": 3},
                  known="pairing the strands takes as long again"),
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
            Limit("flips", at_most=0),
            Limit("swaps", at_most=0, known="in 16 of 600 sequences"),
            Limit("slips [%]", at_most=0.1, unit="%", where={"kind": ("crossing", "touching", "leaving")},
                  known="0.10 % where ropes are moved across each other"),
            Limit("slips [%]", at_most=3, unit="%"),
            Limit("ok [%]", at_least=85, unit="%", sampled=60),
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
        lambda effort: [effort.count(900)], warm_costs,
        limits=(
            Limit("found [%]", at_least=99, unit="%"),
            Limit("times one rope", at_most=1.5, unit="x", where={"scene": "three ropes apart"},
                  known="about twice as long"),
            Limit("times one rope", at_most=1.5, unit="x", where={"scene": "three ropes that cross"},
                  known="nearly nine times as long"),
        ),
    ),
)  # fmt: skip
