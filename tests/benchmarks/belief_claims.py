"""Measure whether shapes know how wrong they are: ``sigma`` against the true errors, and what is wrong in silence.

The depth has the noise of a D455. ``sigma`` is calibrated if the RMS error per axis of the points that have a certain
``sigma`` is that ``sigma``, and if as many points lie within its 90 % radius as of a normal distribution.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np
import numpy.typing as npt

from shape_obs.utils.files import write_whole
from tests.benchmarks import ENVS
from tests.benchmarks.contour_claims import seen_outline
from tests.benchmarks.env_claims import Setting, episodes
from tests.benchmarks.motion_claims import COVERS, hidden_rope_tracks, swinging_rope_tracks
from tests.benchmarks.scenes.flat_objects import Hand, Motion, View, cloth, in_space, noisy_depth, ring, under_hand
from tests.benchmarks.surface_claims import seen_points
from tests.benchmarks.tables import Row, at_least, at_most, grouped

Array = npt.NDArray[np.float64]

#: Radius within which 90 % of normally distributed errors lie, in standard deviations per axis: by the dimension.
WITHIN: Final = {2: 2.146, 3: 2.500}
PICTURE: Final = "reliability.png"
_APPROACHES: Final = (1.0, 8.0)  # pixels a frame, of what comes over a rope
_HERTZ: Final = 33.0
_BINS: Final = 8
_FEWEST: Final = 40  # errors in a bin that is drawn
_COLOURS: Final = ("#1f6fb4", "#d4541a", "#3a8f4d", "#8a56a8", "#b08a1e", "#2a9aa0", "#c0417c")


def beliefs(seeds: Sequence[int], renderer: str = "auto", frames: int = 300) -> Iterator[Row]:
    """Yield a row of ``scores.belief`` for each ok frame of all scenes, with its ``kind`` and what was ``given``."""
    for depth in (False, True):
        given = "D455 depth" if depth else "mask"
        for cover in COVERS:
            tracks = hidden_rope_tracks(seeds, covers=[cover], approaches=_APPROACHES, depths=[depth], noises=[depth])
            yield from _named(f"rope, {cover}", given, (each for row in tracks for each in row.beliefs))
        for view, seed in product((View(), View(height=120)), seeds):
            small = "" if view.height == 480 else ", 160x120"
            flat = _flat_objects(view, seed, depth)
            for kind, found in flat:
                yield from _named(f"{kind}{small}", given, (row.belief for row in found if row.ok))
    for small, size in (("", (480, 640)), (", 160x120", (120, 160))):
        swung = swinging_rope_tracks(seeds, frames=frames, rates=[_HERTZ], noises=[True], size=size)
        yield from _named(f"rope, swung{small}", "D455 depth", (each for row in swung for each in row.beliefs))
    for env in ENVS:
        found = episodes(Setting(env, "d455", "noise", renderer), seeds)
        yield from _named(f"{env}-v0", "D455 depth", (each for row in found for each in row.beliefs))


def _named(kind: str, given: str, found: Iterable[Row]) -> Iterator[Row]:
    return (Row(kind=kind, given=given, **row) for row in found)


def _flat_objects(view: View, seed: int, depth: bool) -> Iterator[tuple[str, Iterable[Row]]]:
    """Yield kinds of scenes of a cloth, a ring and a blob, and the frames of each that were tracked."""
    rng = np.random.default_rng(seed)
    noise: Callable[..., Any] = partial(noisy_depth, view=view, seed=seed) if depth else iter
    for name, flat in (("cloth", cloth((1.0, 1.5, 2.0)[seed % 3])), ("outline", ring(rng, bool(seed % 2)))):
        seen = seen_points if name == "cloth" else seen_outline
        hands: tuple[Hand, ...] = get_args(Hand) if name == "cloth" else ("side",)
        for place in hands:
            moving, speed = (0.0, 4.0)[seed % 2], (1.0, 4.0, 16.0)[seed % 3]
            scenes = under_hand(rng, flat, view, place, speed, moving, level=not depth)
            yield f"{name}, hand", seen(noise(scenes), view, depth)
        if depth:
            motions: tuple[Motion, ...] = get_args(Motion) if name == "cloth" else ("tilted", "corner up")
            for motion in motions:
                scenes = in_space(rng, flat, view, motion, (8.0, 16.0)[seed % 2])
                yield f"{name}, {motion}", seen(noise(scenes), view, depth)


def reliability(rows: Iterable[Row]) -> list[Row]:
    """Summarise the belief of each kind of scene.

    Returns:
        ``frames``: those that are ok; ``wrong_%``: those of them that slipped or are more than 10 mm off in the mean;
        ``seen_%`` and ``hidden_%``: errors within the 90 % radius of the points that are in sight and of those that are
        not; ``rms`` and ``sigma``: of the points in sight, RMS error per axis and RMS of ``sigma``, millimetres or
        pixels.
    """
    out = []
    for (kind, given), some in grouped(rows, lambda row: (row.kind, row.given)).items():
        errors, sigma, shown = _joined(some)
        axes, unit = (3, 1e3) if some[0].space else (2, 1.0)
        seen = {"rms": unit * _rms(errors[shown]) / np.sqrt(axes), "sigma": unit * _rms(sigma[shown])}
        out.append(Row(kind=kind, given=given, frames=len(some), **_shares(some), **seen))
    return out


def _shares(rows: Sequence[Row]) -> dict[str, float | None]:
    """Return the percentages of ``reliability``."""
    errors, sigma, shown = _joined(rows)
    inside = errors <= WITHIN[3 if rows[0].space else 2] * sigma
    wrong = 100 * float(np.mean([row.wrong for row in rows]))
    seen, hidden = (100 * float(np.mean(inside[which])) if which.any() else None for which in (shown, ~shown))
    return {"wrong_%": wrong, "seen_%": seen, "hidden_%": hidden}


def targets(rows: Sequence[Row]) -> list[Row]:
    """Compare the belief over all scenes with its targets."""
    out = []
    for given, some in grouped(rows, lambda row: row.given).items():
        shares = _shares(some)
        out += [
            at_least(f"{given}: errors of points in sight within the 90 % radius", 85, shares["seen_%"], " %"),
            at_most(f"{given}: the same", 95, shares["seen_%"], " %"),
            at_least(f"{given}: errors of hidden points within it", 85, shares["hidden_%"], " %"),
            at_most(f"{given}: ok frames that are wrong", 0.2, shares["wrong_%"], " %"),
        ]
    return out


def draw(rows: Iterable[Row], folder: Path) -> Path:
    """Draw the reliability diagram into a folder and return its path: true errors over the expected ones."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.6, 4.8), layout="constrained")
    both = grouped(rows, lambda row: row.space)
    for axis, (space, some) in zip(figure.subplots(1, len(both), squeeze=False)[0], sorted(both.items()), strict=True):
        unit, scale, axes = ("mm", 1e3, 3) if space else ("px", 1.0, 2)
        lines = grouped(some, lambda row: row.kind.partition(",")[0])
        for colour, (kind, of_kind) in zip(_COLOURS, lines.items(), strict=False):
            errors, sigma, shown = _joined(of_kind)
            for label, known, style in ((kind, shown, "-"), (f"{kind}, hidden", ~shown, ":")):
                expected, seen = _curve(sigma[known], errors[known] / np.sqrt(axes))
                if len(seen):
                    axis.plot(scale * expected, scale * seen, style, marker=".", color=colour, label=label)
        axis.axline((1, 1), (10, 10), color="#22313f", linewidth=0.8, zorder=0, label="RMS error = sigma")
        axis.set(xscale="log", yscale="log", xlabel=f"sigma [{unit}]", ylabel=f"RMS error per axis [{unit}]")
        axis.set_title("points in space, depth of a D455" if space else "points in the image, the mask alone")
        axis.legend(frameon=False, fontsize=8)
    path = folder / PICTURE
    write_whole(path, partial(figure.savefig, dpi=110))
    return path


def _curve(sigma: Array, errors: Array) -> tuple[Array, Array]:
    """Return RMS of sigma and of the errors in bins of equally many points, by sigma."""
    bins = [part for part in np.array_split(np.argsort(sigma), _BINS) if len(part) >= _FEWEST]
    return np.array([_rms(sigma[part]) for part in bins]), np.array([_rms(errors[part]) for part in bins])


def _joined(rows: Sequence[Row]) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
    """Return errors, sigma, and whether they are in sight, of all points."""
    errors, sigma = (np.concatenate([row[name] for row in rows], dtype=np.float64) for name in ("errors", "sigma"))
    return errors, sigma, np.concatenate([row.shown for row in rows])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
