"""Measure scenes of several ropes in single images: how many ropes are found, and which strand is seen to be above."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics
from shape_obs.configurations.centerline import Centerline
from shape_obs.detector import ShapeDetector
from shape_obs.frame import Frame
from shape_obs.geometry import crossings as geometry
from shape_obs.image.roi import Window
from shape_obs.image.segmentation import Segmentation
from shape_obs.shape import Detection
from tests.benchmarks.rope_scores import judge
from tests.benchmarks.scenes.several_ropes import Crossing, RopeScene, noisy_depth, several_ropes
from tests.benchmarks.several_rope_peer import is_installed, peer_ropes
from tests.benchmarks.tables import Row, at_least, at_most, median

Size = tuple[int, int]
SIZES: Final[tuple[Size, ...]] = ((480, 640), (672, 896))
COUNTS: Final = (2, 3, 4, 5)
MOST_CROSSINGS: Final = {2: 8, 3: 8, 4: 12, 5: 12}  # more of them leave hardly any room for two or three ropes
_N: Final = 160  # points of a curve that is compared with a rope's axis: no farther apart than a width or two
# Ropes seen from straight above, 0.6 m away, that are 8 mm thick or more.
_DISTANCE: Final = 0.6
_FOCAL: Final = 386.0
_THICK: Final = (8e-3 * _FOCAL / _DISTANCE, 14.0)  # pixels


def cold_cells(
    per_cell: int, seed: int = 0, *, counts: Sequence[int] = COUNTS, sizes: Sequence[Size] = SIZES
) -> Iterator[Row]:
    """Draw ``per_cell`` scenes for each number of ropes and size of the image, and find all ropes of each mask.

    Yields:
        ``ropes``, ``image``, ``scenes``; of all ropes, the shares ``right``, and ``wrong``: given as found, but unlike
        any rope; ``refused``: number of slots that were refused, as a share of the ropes; ``ms``: median time of
        ``detect_mask``; ``peer_right``, ``peer_wrong``, ``peer_ms``: the same for the peer; ``thinning_ms``: median
        time of plain ``skeletonize``; ``to_peer`` and ``to_thinning``: medians over the scenes of the ratio of our
        time to theirs on the same mask. The peer's are None without scikit-image and scikit-learn.
    """
    detector = ShapeDetector([Centerline(n=_N, count="all", ends="tips")])
    for size in sizes:
        for count in counts:
            scenes = (_scene([seed, count, size[0], k], count, size) for k in range(per_cell))
            rows = [_cold(detector, scene) for scene in scenes]
            yield Row(ropes=count, image=f"{size[1]} x {size[0]}", scenes=len(rows), **_shares(rows, count))


def levels(scenes: int, seed: int = 0) -> list[Row]:
    """Find which strand is above at the crossings of drawn ropes that are 8 mm thick or more, 0.6 m away.

    Returns:
        A row for the picture alone, for the depth of a D455 alone, and for both: ``drawn``: crossings of the scenes;
        ``found``: those that were found, on ropes that were found right; of these the shares ``right``, ``wrong`` and
        ``unknown``.
    """
    answers: dict[str, list[int]] = {"picture": [], "depth": [], "both": []}
    drawn = 0
    for k in range(scenes):
        rng = np.random.default_rng([seed, k, 8])
        count = int(rng.integers(2, 5))
        scene = _scene([seed, k, 9], count, SIZES[k % 2], float(rng.uniform(*_THICK)))
        drawn += len(scene.crossings)
        depth = noisy_depth(scene, rng, _DISTANCE, _FOCAL)
        high, wide = scene.mask.shape
        camera = Intrinsics(wide, high, _FOCAL, _FOCAL, (wide - 1) / 2, (high - 1) / 2)
        for given, rgb, metres in (("picture", True, None), ("depth", False, depth), ("both", True, depth)):
            spec = Centerline(n=_N, count="all", ends="tips")
            lens = None if metres is None else camera
            answers[given] += _answers(detect_scene(scene, spec, metres, lens, picture=rgb), scene)
    return [
        Row(
            given=given,
            drawn=drawn,
            found=len(some),
            **{name: float(np.mean([each == value for each in some])) if some else None for value, name in _NAMES},
        )
        for given, some in answers.items()
    ]


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


def targets(cold: Sequence[Row], tracked: Sequence[Row], above: Sequence[Row], warm: Sequence[Row]) -> Iterator[Row]:
    """Yield what is asked of several ropes, and what was seen.

    Args:
        cold: Of ``cold_cells``.
        tracked: Of ``rope_identity_claims.track_table``.
        above: Of ``levels``.
        warm: Of ``several_rope_speed.warm_costs``.
    """
    for most, least in ((3, 0.98), (5, 0.95)):
        some = [row for row in cold if most - 1 <= row.ropes <= most]
        yield at_least(f"{most - 1} and {most} ropes: share right", least, _weighted(some, "right"), "")
    yield at_most("share given as found, though wrong", 0.005, _weighted(cold, "wrong"), "")
    three = [row for row in cold if row.ropes == 3]
    yield at_most("three ropes, cold: time over the peer's", 0.2, median(row.to_peer for row in three))
    yield at_most("three ropes, cold: time over plain thinning", 2.0, median(row.to_thinning for row in three))
    for row in warm[1:]:
        yield at_most(f"{row.scene}, warm: time over one rope's", 1.5, row.to_one)
    for what in ("swaps", "flips"):
        yield at_most(f"tracked: {what}", 0, sum(row[what] for row in tracked), "")
    measured = max(sum(row.measured for row in tracked), 1)
    yield at_most("tracked: slips in percent of ok frames", 0.1, 100 * sum(r.slips for r in tracked) / measured, "")
    for row in above:
        if row.given == "picture":
            known = None if row.right is None else row.right + row.unknown
            yield at_least("over or under from the picture: right or unknown", 0.95, known, "")
        else:
            yield at_least(f"over or under, {row.given}: right", 0.99, row.right, "")


_NAMES: Final = ((1, "right"), (0, "wrong"), (-1, "unknown"))


def _weighted(rows: Sequence[Row], field: str) -> float | None:
    ropes = sum(row.scenes * row.ropes for row in rows)
    return sum(row[field] * row.scenes * row.ropes for row in rows) / ropes if ropes else None


def _scene(seed: list[int], count: int, size: Size, width: float | None = None) -> RopeScene:
    """Draw a scene with a random number of crossings; another number where so many do not fit."""
    rng = np.random.default_rng(seed)
    scene = None
    while scene is None:
        with suppress(RuntimeError):
            scene = several_ropes(rng, count, int(rng.integers(MOST_CROSSINGS[count] + 1)), size, width)
    return scene


def _cold(detector: ShapeDetector, scene: RopeScene) -> Row:
    detector.reset()
    begin = time.perf_counter()
    detection = detector.detect_mask(scene.mask)
    ms = 1e3 * (time.perf_counter() - begin)
    found = [shape.pixels for shape in detection if shape.ok]
    verdict = judge(found, scene)
    row = Row(right=sum(verdict.right), wrong=verdict.wrong, refused=len(detection) - len(found), ms=ms)
    if is_installed():
        from skimage.morphology import skeletonize

        begin = time.perf_counter()
        skeletonize(scene.mask > 0)
        middle = time.perf_counter()
        curves = peer_ropes(scene.mask)
        row["thinning_ms"], row["peer_ms"] = 1e3 * (middle - begin), 1e3 * (time.perf_counter() - middle)
        peer = judge(curves, scene)
        row["peer_right"], row["peer_wrong"] = sum(peer.right), peer.wrong
    return row


def _shares(rows: Sequence[Row], count: int) -> dict[str, float | None]:
    ropes = count * len(rows)
    shares = {name: sum(row[name] for row in rows) / ropes for name in ("right", "wrong", "refused")}
    peer: dict[str, float | None] = dict.fromkeys(
        ("peer_right", "peer_wrong", "peer_ms", "thinning_ms", "to_peer", "to_thinning")
    )
    if is_installed():
        peer = {name: sum(row[name] for row in rows) / ropes for name in ("peer_right", "peer_wrong")}
        peer |= {name: median(row[name] for row in rows) for name in ("peer_ms", "thinning_ms")}
        peer |= {f"to_{name}": median(row.ms / row[f"{name}_ms"] for row in rows) for name in ("peer", "thinning")}
    return {**shares, "ms": median(row.ms for row in rows), **peer}


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
