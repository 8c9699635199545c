"""Measure the identity of a rope's points while something hides a part of it, and while it moves in space."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import product
from typing import Final

import numpy as np

from shape_obs.configurations.base import Spacing
from shape_obs.configurations.centerline import Centerline
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.polyline import resample
from tests.benchmarks.scenes.hidden_ropes import Cover, Seen, camera_of, hidden_ropes, swinging_ropes, with_noise
from tests.benchmarks.scenes.swings import STIFFNESS, swung_rope
from tests.benchmarks.scores import FAR, SLIP, belief
from tests.benchmarks.tables import Row, mean, summary

Noise = Callable[[Seen], Seen]
APPROACHES: Final = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)  # pixels per frame
COVERS: Final[tuple[Cover, ...]] = ("hand", "shadow", "bar", "border")
_N: Final = 20
_ENOUGH: Final = 0.55  # of a rope: when that much shows it has to be found
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
    row = Row(
        frames=0, due=0, ok=0, shown=0, claimed=0, slips=0, off=0, worst=0.0, late=0, renewed=0, mm=[], beliefs=[]
    )
    since, name, turned = 0, 1, False
    for seen in frames:
        pixels, metres = resample(seen.pixels, len(seen.pixels)), seen.metres
        if detector is None and not seen.shown.all():
            continue  # its length cannot be known yet
        if detector is None:
            u, v = pixels[0].tolist()
            detector = ShapeDetector(
                [Centerline(n=_N, ends="tips", anchor=(u, v), spacing=spacing)], dt=dt, on_invalid="interpolate"
            )
        metric = (seen.depth, seen.camera) if depth else (None, None)
        shape = detector.detect_mask(seen.mask, metric[0], metric[1]).shapes[0]
        at = np.linspace(0, len(pixels) - 1, _N) if spacing == "px" else _even(seen.metres)
        true = _at(pixels, at), _at(metres, np.linspace(0, len(metres) - 1, _N) if spacing == "px" else at)
        shown = _at(seen.shown[:, None].astype(float), at)[:, 0] > 0.99
        since = since + 1 if seen.shown.all() else 0
        row["frames"] += 1
        due = seen.shown.mean() >= _ENOUGH
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
        if spacing == "px":
            away = np.linalg.norm(shape.pixels - true[0], axis=1) / _gap(true[0])
        else:
            assert shape.points3d is not None
            away = np.linalg.norm(shape.points3d - true[1], axis=1) / _gap(true[1])
            error = 1e3 * np.linalg.norm(shape.points3d - true[1], axis=1)[shape.valid]
            row["mm"].append(float(error.mean()) if len(error) else 0.0)
            row["off"] += bool(len(error) and error.mean() > 1e3 * FAR)
        most = float(away[shape.visible & (shape.valid | (spacing == "px"))].max(initial=0.0))
        errors = shape.pixels - true[0] if shape.points3d is None else shape.points3d - true[1]
        row["beliefs"].append(belief(shape, np.linalg.norm(errors, axis=1), shown, most > SLIP))
        row["slips"] += most > SLIP
        row["late"] += most > SLIP and since > _HEALING
        row["worst"] = max(row["worst"], most)
    return row


def hidden_rope_tracks(
    seeds: Iterable[int],
    *,
    covers: Sequence[Cover] = COVERS,
    approaches: Sequence[float] = APPROACHES,
    speeds: Sequence[float] = (0.0, 3.0),
    depths: Sequence[bool] = (False, True),
    noises: Sequence[bool] = (False,),
    size: tuple[int, int] = (480, 640),
) -> Iterator[Row]:
    """Track ropes in a plane while something comes over them, stays and goes."""
    for cover, approach, speed, seed in product(covers, approaches, speeds, seeds):
        rng = np.random.default_rng([seed, round(2 * approach), round(speed)])
        frames = list(hidden_ropes(rng, cover, approach, speed, share=float(rng.uniform(0.15, 0.45)), size=size))
        for depth, noise in product(depths, noises):
            found = track(_measured(frames, rng, size) if noise else frames, depth=depth)
            yield Row(cover=cover, depth=depth, approach=approach, speed=speed, noise=noise, seed=seed, **found)


def swinging_rope_tracks(
    seeds: Iterable[int],
    *,
    frames: int = 300,
    rates: Sequence[float] = (100, 33, 15),
    walls: Sequence[bool] = (True, False),
    noises: Sequence[bool] = (False,),
    size: tuple[int, int] = (480, 640),
) -> Iterator[Row]:
    """Track ropes that are swung through the air by one or both ends, from cords to stiff cables."""
    for hertz, seed in product(rates, seeds):
        rng = np.random.default_rng([seed, round(hertz)])
        stiffness = STIFFNESS[seed // 2 % len(STIFFNESS)]
        curves = list(swung_rope(rng, hertz, frames, hands=1 + seed % 2, stiffness=stiffness))
        radius = float(rng.uniform(0.004, 0.008))
        for wall, noise in product(walls, noises):
            seen = swinging_ropes(curves, radius, camera_of(size), wall)
            found = track(_measured(seen, rng, size) if noise else seen, depth=True, spacing="m", dt=1 / hertz)
            yield Row(hertz=hertz, wall=wall, noise=noise, stiffness=stiffness, seed=seed, **found)


def motion_table(rows: Iterable[Row], by: Sequence[str]) -> list[Row]:
    """Return shares in percent for each group of tracks."""

    def share(part: str, whole: str) -> Callable[[list[Row]], float]:
        return lambda found: 100 * sum(row[part] for row in found) / max(sum(row[whole] for row in found), 1)

    columns = {
        "tracks": len,
        "frames": lambda found: sum(row.frames for row in found),
        "ok_%": share("ok", "due"),
        "claimed_%": share("claimed", "shown"),
        "slips_%": share("slips", "frames"),
        "late": lambda found: sum(row.late for row in found),
        "tracks_with_slips": lambda found: sum(row.slips > 0 for row in found),
        "off_%": share("off", "frames"),
        "mean_mm": lambda found: mean(mm for row in found for mm in row.mm) if any(row.mm for row in found) else None,
        "worst_gaps": lambda found: max(row.worst for row in found),
    }
    return summary(rows, tuple(by), columns)


def _measured(frames: Iterable[Seen], rng: np.random.Generator, size: tuple[int, int]) -> Iterator[Seen]:
    """Yield frames with the depth that a D455 measures."""
    from shape_obs_envs.d455 import D455Model
    from shape_obs_envs.d455.noise import D455Camera

    camera = D455Camera(D455Model(), size, fast=True)
    return (with_noise(each, camera.measure, rng) for each in frames)


def _even(metres: np.ndarray) -> np.ndarray:
    """Return the indices of N points at equal steps of arc length."""
    return np.linspace(0, len(metres) - 1, _N)


def _at(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    before = np.minimum(at.astype(int), len(values) - 2)
    share = (at - before)[:, None]
    return values[before] * (1 - share) + values[before + 1] * share


def _gap(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).mean())
