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
from tests.benchmarks.scenes.hidden_ropes import Cover, Seen, camera_of, hidden_ropes, swinging_ropes, with_noise
from tests.benchmarks.scenes.swings import STIFFNESS, swung_rope
from tests.benchmarks.scores import FAR, LEAST_SHOWN, SLIP, belief
from tests.benchmarks.tables import Column, Row, joined, mean, of, percent, total, worst

Array = npt.NDArray[np.float64]
Size = tuple[int, int]
APPROACHES: Final = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)  # pixels per frame
COVERS: Final[tuple[Cover, ...]] = ("hand", "shadow", "bar", "border")
VGA: Final[Size] = (480, 640)
_N: Final = 20
_HEALING: Final = 10  # frames


def track(frames: Iterable[Seen], *, depth: bool, spacing: Spacing = "px", dt: float = 1 / 30) -> Row:
    """Track a rope through its frames and compare it with the truth.

    Returns:
        ``frames``: how many; ``due``: those in which 55 % of the rope show, and ``ok`` those of them that were;
        ``shown`` and ``claimed``: points in sight in ok frames, and those of them that were visible and valid;
        ``slips``: ok frames with a visible point more than half a gap from its place; ``off``: ok frames with a mean
        error of the visible points above 10 mm; ``mm``: mean error of the visible points in each ok frame, in
        millimetres; ``worst``: in gaps; ``late``: frames that were wrong though nothing was hidden any more since 10
        frames; ``renewed``: how often a new track was reported, which may begin at the other end; ``beliefs``: for each
        ok frame, a row of ``belief``.
    """
    detector: ShapeDetector | None = None
    row = Row(dict.fromkeys(("frames", "due", "ok", "shown", "claimed", "slips", "off", "late", "renewed"), 0))
    row |= {"worst": 0.0, "mm": [], "beliefs": []}
    since, name, turned = 0, 1, False
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
        true = _at(pixels, at), _at(metres, in_space)
        shown = _at(seen.shown[:, None].astype(float), at)[:, 0] > 0.99
        since = since + 1 if seen.shown.all() else 0
        row["frames"] += 1
        due = seen.shown.mean() >= LEAST_SHOWN
        row["due"] += due
        if not shape.ok or shape.reason:
            continue
        row["ok"] += due
        if shape.track_id != name:
            ends, true_ends = shape.pixels[[0, -1]], true[0][[0, -1]]
            same, other = (np.linalg.norm(ends - each, axis=1).sum() for each in (true_ends, true_ends[::-1]))
            name, turned = shape.track_id, bool(other < same)
            row["renewed"] += 1
        if turned:
            true, shown = (true[0][::-1], true[1][::-1]), shown[::-1]
        row["shown"] += int(shown.sum())
        row["claimed"] += int((shown & shape.visible & shape.valid).sum())
        errors = np.linalg.norm(shape.pixels - true[0], axis=1)
        if shape.points3d is not None:
            errors = np.linalg.norm(shape.points3d - true[1], axis=1)
        if spacing == "px":
            away, counted = np.linalg.norm(shape.pixels - true[0], axis=1) / _gap(true[0]), shape.visible
        else:
            away, counted = errors / _gap(true[1]), shape.visible & shape.valid
            mm = 1e3 * float(errors[shape.valid].mean()) if shape.valid.any() else 0.0
            row["mm"].append(mm)
            row["off"] += mm > 1e3 * FAR
        most = float(away[counted].max(initial=0.0))
        row["beliefs"].append(belief(shape, errors, shown, most > SLIP))
        row["slips"] += most > SLIP
        row["late"] += most > SLIP and since > _HEALING
        row["worst"] = max(row["worst"], most)
    return row


def _at(values: Array, at: Array) -> Array:
    before = np.minimum(at.astype(int), len(values) - 2)
    share = (at - before)[:, None]
    return values[before] * (1 - share) + values[before + 1] * share


def _gap(points: Array) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).mean())


def covered_rope(
    seed: int, cover: Cover, approach: float, speed: float, *, depth: bool, noise: bool = False, size: Size = VGA
) -> Row:
    """Track a rope in a plane while something comes over it, stays and goes."""
    rng = np.random.default_rng([seed, round(2 * approach), round(speed)])
    frames: Iterable[Seen] = list(
        hidden_ropes(rng, cover, approach, speed, share=float(rng.uniform(0.15, 0.45)), size=size)
    )
    return track(_measured(frames, rng, size) if noise else frames, depth=depth)


def swinging_rope(
    seed: int, hertz: float, *, wall: bool = True, noise: bool = False, frames: int = 300, size: Size = VGA
) -> Row:
    """Track a rope that is swung through the air by one or both ends, from cords to stiff cables."""
    rng = np.random.default_rng([seed, round(hertz)])
    stiffness = STIFFNESS[seed // 2 % len(STIFFNESS)]
    curves = list(swung_rope(rng, hertz, frames, hands=1 + seed % 2, stiffness=stiffness))
    seen = swinging_ropes(curves, float(rng.uniform(0.004, 0.008)), camera_of(size), wall)
    return track(_measured(seen, rng, size) if noise else seen, depth=True, spacing="m", dt=1 / hertz)


def _measured(frames: Iterable[Seen], rng: np.random.Generator, size: Size) -> Iterator[Seen]:
    """Yield frames with the depth that a D455 measures."""
    from shape_obs_envs.d455 import D455Model
    from shape_obs_envs.d455.noise import D455Camera

    camera = D455Camera(D455Model(), size, fast=True)
    return (with_noise(each, camera.measure, rng) for each in frames)


def covers(effort: Effort) -> Iterator[dict[str, Any]]:
    """Return every cover, approach and speed."""
    for cover, approach, speed, seed in product(COVERS, APPROACHES, (0.0, 3.0), effort.seeds(5)):
        for depth in (False, True):
            yield {"cover": cover, "approach": approach, "speed": speed, "seed": seed, "depth": depth}


def swings(effort: Effort) -> Iterator[dict[str, Any]]:
    """Return every rate, wall and depth."""
    for hertz, seed, wall, noise in product((100, 33, 15), effort.seeds(50), (True, False), (False, True)):
        yield {"hertz": hertz, "seed": seed, "wall": wall, "noise": noise}


COLUMNS: Final[dict[str, Column]] = {
    "tracks": len,
    "frames": total("frames"),
    "ok [%]": percent("ok", "due"),
    "claimed [%]": percent("claimed", "shown"),
    "slips [%]": percent("slips", "frames"),
    "late": total("late"),
    "tracks with slips": lambda rows: sum(row.slips > 0 for row in rows),
    "above 10 mm [%]": percent("off", "frames"),
    "mean [mm]": joined(mean, "mm"),
    "worst [gaps]": of(worst, "worst"),
}
_SMALL: Final = "a bar hides both sides at once, and a rope without an end in sight may slide along itself"
CLAIMS: Final = (
    Claim(
        "hidden.covered",
        "Ropes over which a hand, a shadow, a bar or the image's border comes, stays and goes, with and without depth.",
        covers,
        lambda scene: Row(covered_rope(**scene), cover=scene["cover"], depth=scene["depth"]),
        ("cover", "depth"),
        COLUMNS,
        limits=(
            Limit("slips [%]", at_most=0.5, unit="%", where={"cover": ("hand", "shadow", "border")}),
            Limit("slips [%]", at_most=0.1, unit="%", where={"cover": "bar"}, known=_SMALL),
            Limit("ok [%]", at_least=97, unit="%", where={"cover": ("hand", "shadow", "border")}),
            Limit("ok [%]", at_least=97, unit="%", where={"cover": "bar"}, known=_SMALL),
            Limit("claimed [%]", at_least=95, unit="%"),
        ),
    ),
    Claim(
        "hidden.swung",
        "Ropes swung in space by one or both ends, at 100, 33 and 15 Hz, with and without a wall and a D455's noise.",
        swings,
        lambda scene: Row(swinging_rope(**scene), **scene),
        ("hertz", "wall", "noise"),
        COLUMNS,
        limits=(
            Limit("slips [%]", at_most=1, unit="%"),
            Limit("above 10 mm [%]", at_most=1, unit="%"),
            Limit("ok [%]", at_least=96, unit="%"),
            Limit("claimed [%]", at_least=94, unit="%"),
            Limit("mean [mm]", at_most=3, unit="mm"),
        ),
        needs=("mujoco",),
    ),
)
