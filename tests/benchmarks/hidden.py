"""Ropes of which something hides a part, and ropes that are swung in space: the identity of their points."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import product
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.configurations.base import Spacing
from shape_obs.configurations.centerline import Centerline
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.polyline import resample
from tests.benchmarks.claim import Claim, Effort, Limit
from tests.benchmarks.scenes.swings import STIFFNESS, swung_rope
from tests.benchmarks.scores import VISIBLE, claimed, visible_row
from tests.benchmarks.tables import Row, of, percent, total, worst
from tests.scenes.beams import swinging_beam, tracked_beam
from tests.scenes.hidden_ropes import DISTANCE, Cover, Seen, camera_of, d455, hidden_ropes, see

Array = npt.NDArray[np.float64]
Size = tuple[int, int]
APPROACHES: Final = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)  # pixels per frame
COVERS: Final[tuple[Cover, ...]] = ("hand", "shadow", "bar", "border")
VGA: Final[Size] = (480, 640)
_SMALLER: Final[Size] = (240, 320)
_N: Final = 20
_BEHIND: Final = 0.3  # metres from the farthest point of a swung rope to the wall


def track(frames: Iterable[Seen], *, depth: bool, spacing: Spacing = "px", dt: float = 1 / 30) -> Row:
    """Track a rope through its frames and return the ``visible_row`` of what was claimed of its points."""
    return visible_row(seen_rope(frames, depth=depth, spacing=spacing, dt=dt))


def seen_rope(frames: Iterable[Seen], *, depth: bool, spacing: Spacing = "px", dt: float = 1 / 30) -> Iterator[Row]:
    """Track a rope from the first frame in which all of it is in sight, and yield the rows of ``visible_row``."""
    detector: ShapeDetector | None = None
    name, turned = 0, False
    for seen in frames:
        pixels, metres = resample(seen.pixels, len(seen.pixels)), seen.metres
        if detector is None and not seen.shown.all():
            continue  # its length cannot be known yet
        if detector is None:
            u, v = pixels[0].tolist()
            spec = Centerline(n=_N, ends="tips", anchor=(u, v), spacing=spacing)
            detector = ShapeDetector([spec], dt=dt, on_invalid="interpolate")
        shape = detector.detect_mask(seen.mask, *((seen.depth, seen.camera) if depth else (None, None))).shapes[0]
        in_pixels, in_space = np.linspace(0, len(pixels) - 1, _N), np.linspace(0, len(metres) - 1, _N)
        at = in_pixels if spacing == "px" else in_space
        true = np.column_stack([_at(pixels, at), _at(metres, in_space), _at(seen.shown[:, None].astype(float), at)])
        found, reason = shape.pixels.astype(np.float64), shape.reason
        if shape.track_id != name and not reason:  # a new track may begin at the other end
            ends = [np.linalg.norm(found[[0, -1]] - way[[0, -1], :2], axis=1).sum() for way in (true, true[::-1])]
            name, turned = shape.track_id, bool(ends[1] < ends[0])
        true = true[::-1] if turned else true
        away = np.linalg.norm(found - true[:, :2], axis=1)
        errors = away if shape.points3d is None else np.linalg.norm(shape.points3d - true[:, 2:5], axis=1)
        off = away / _gap(true[:, :2]) if spacing == "px" else errors / _gap(true[:, 2:5])
        if spacing == "m":
            off = np.where(shape.valid, off, 0.0)  # without a depth it has no place in space
        yield claimed(shape, off, errors, true[:, 5] <= 0.99, float(seen.shown.mean()), name)


def _at(values: Array, at: Array) -> Array:
    return np.stack([np.interp(at, np.arange(len(values)), column) for column in values.T], axis=1)


def _gap(points: Array) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).mean())


def covered_rope(
    seed: int, cover: Cover, approach: float, speed: float, *, depth: bool, noise: bool = False, size: Size = VGA,
    away: float = DISTANCE,
) -> Iterator[Row]:  # fmt: skip
    """Track a rope in a plane while something comes over it, stays and goes; yield the rows of ``visible_row``."""
    rng = np.random.default_rng([seed, round(2 * approach), round(speed)])
    share = float(rng.uniform(0.15, 0.45))
    frames = list(hidden_ropes(rng, cover, approach, speed, share=share, size=size, away=away))
    return seen_rope(_measured(frames, rng, size) if noise else frames, depth=depth)


def swinging_frames(
    seed: int, hertz: float, *, wall: bool = True, noise: bool = False, frames: int = 300, size: Size = VGA
) -> Iterator[Seen]:
    """Return the frames of a rope that is swung by one or both ends, a cord or a stiff cable."""
    rng, camera = np.random.default_rng([seed, round(hertz)]), camera_of(size)
    stiffness = STIFFNESS[seed // 2 % len(STIFFNESS)]
    curves = list(swung_rope(rng, hertz, frames, hands=1 + seed % 2, stiffness=stiffness))
    radius = float(rng.uniform(0.004, 0.008))
    seen = (see(curve, radius, camera, float(curve[:, 2].max()) + _BEHIND if wall else 0.0) for curve in curves)
    return _measured(seen, rng, size) if noise else seen


def swinging_rope(seed: int, hertz: float, **how: Any) -> Iterator[Row]:
    """Track a rope that is swung, see ``swinging_frames``; yield the rows of ``visible_row``."""
    return seen_rope(swinging_frames(seed, hertz, **how), depth=True, spacing="m", dt=1 / hertz)


def _measured(frames: Iterable[Seen], rng: np.random.Generator, size: Size) -> Iterator[Seen]:
    measure = d455(size, rng)
    return (each._replace(depth=measure(each.depth)) for each in frames)


def covers(effort: Effort) -> Iterator[dict[str, Any]]:
    """Return every cover, approach and speed."""
    fields = "cover", "approach", "speed", "seed", "depth"
    for scene in product(COVERS, APPROACHES, (0.0, 3.0, 10.0), effort.seeds(4), (False, True)):
        yield dict(zip(fields, scene, strict=True))


def distances(effort: Effort) -> Iterator[dict[str, Any]]:
    """Return every cover, approach, speed and distance, with the noise of depth."""
    fields = "cover", "approach", "speed", "seed", "away"
    for scene in product(COVERS, (1.0, 4.0, 16.0), (0.0, 3.0), effort.seeds(4), (0.7, 1.2, 1.6)):
        yield dict(zip(fields, scene, strict=True), depth=True, noise=True, size=_SMALLER)


def swings(effort: Effort) -> Iterator[dict[str, Any]]:
    """Return every rate, wall and depth."""
    for scene in product((100, 33, 15), effort.seeds(50), (True, False), (False, True)):
        yield dict(zip(("hertz", "seed", "wall", "noise"), scene, strict=True))


def swinging_beam_row(scene: tuple[int, int, bool, int]) -> Row:
    """Track a thick beam that swings at the border; return its rate, its depth and the counts of ``tracked_beam``."""
    hertz, speed, depth, seed = scene
    motion = np.random.default_rng([seed, hertz, speed]), hertz, speed, max(hertz, 40)
    return Row(tracked_beam(swinging_beam(*motion, drop=0.15, jitter=0.3), depth=depth), hertz=hertz, depth=depth)


_SMALL: Final = "a bar hides both sides at once, and a rope without an end in sight may slide along itself"
_OTHERS: Final = {"cover": ("hand", "shadow", "border")}
CLAIMS: Final = (
    Claim(
        "hidden.covered", "Ropes over which a hand, a shadow, a bar or the image's border comes, stays and goes.",
        covers, lambda scene: visible_row(covered_rope(**scene), cover=scene["cover"], depth=scene["depth"]),
        ("cover", "depth"), VISIBLE,
        limits=(
            Limit("slips [%]", at_most=0.5, unit="%", where=_OTHERS),
            Limit("slips [%]", at_most=0.1, unit="%", where={"cover": "bar"}, known=_SMALL),
            Limit("refused [%]", at_most=3, unit="%", where=_OTHERS),
            Limit("refused [%]", at_most=3, unit="%", where={"cover": "bar"}, known=_SMALL),
            Limit("seen [%]", at_least=95, unit="%"), Limit("hidden valid [%]", at_most=25, unit="%"),
        ),
    ),
    Claim(
        "hidden.distant", "The same at several distances, in smaller images whose depth has a D455's noise.",
        distances, lambda scene: visible_row(covered_rope(**scene), cover=scene["cover"], away=scene["away"]),
        ("cover", "away"), VISIBLE,
        limits=(
            Limit("slips [%]", at_most=1, unit="%"), Limit("far [%]", at_most=2, unit="%"),
            Limit("refused [%]", at_most=3, unit="%", where=_OTHERS, sampled=8),
            Limit("refused [%]", at_most=3, unit="%", where={"cover": "bar"}, known=_SMALL),
        ),
        needs=("shape_obs_envs",),
    ),
    Claim(
        "hidden.swung", "Ropes swung in space by one or both ends, with and without a wall and a D455's noise.",
        swings, lambda scene: visible_row(swinging_rope(**scene), **scene), ("hertz", "wall", "noise"), VISIBLE,
        limits=(
            Limit("slips [%]", at_most=1, unit="%"), Limit("far [%]", at_most=1, unit="%"),
            Limit("refused [%]", at_most=4, unit="%", sampled=10),
            Limit("seen [%]", at_least=94, unit="%", sampled=80), Limit("mean [mm]", at_most=3, unit="mm"),
        ),
        needs=("mujoco",),
    ),
    Claim(
        "hidden.beams", "Thick beams that hang from the border and swing; frames are dropped, and stamps irregular.",
        lambda effort: product((240, 120, 60, 30, 15, 10), (2, 4, 6), (False, True), effort.seeds(10)),
        swinging_beam_row, ("hertz", "depth"),
        {"frames": total("frames"), "refused [%]": percent("refused", "frames"), "longest run": of(worst, "longest"),
         "off it [%]": percent("strayed", "frames"), "turned [%]": percent("turned", "frames")},
        limits=(
            Limit("longest run", at_most=10), Limit("refused [%]", at_most=5, unit="%", sampled=10),
            Limit("off it [%]", at_most=0.1, unit="%"), Limit("turned [%]", at_most=0.1, unit="%"),
        ),
    ),
)  # fmt: skip
