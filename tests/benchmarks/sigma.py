"""Whether shapes know how wrong they are: ``sigma`` against the true errors, and what is wrong in silence.

The depth has the noise of a D455. ``sigma`` is calibrated if the RMS error per axis of the points that have a certain
``sigma`` is that ``sigma``, and if as many points lie within its 90 % radius as of a normal distribution.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import Any, Final, get_args

import numpy as np

from tests.benchmarks import ENVS
from tests.benchmarks.claim import Claim, Effort, Limit
from tests.benchmarks.envs import Setting, episodes
from tests.benchmarks.hidden import COVERS, covered_rope, swinging_rope
from tests.benchmarks.outlines import VIEWS, seen_outline
from tests.benchmarks.sheets import seen_points
from tests.benchmarks.tables import Column, Row
from tests.scenes.flat_objects import Hand, Motion, cloth, in_space, noisy_depth, ring, under_hand

Track = tuple[str, bool, Iterable[Row]]  # its kind, whether there is depth, and the rows of ``scores.claimed``
#: Radius within which 90 % of normally distributed errors lie, in standard deviations per axis: by the dimension.
WITHIN: Final = {2: 2.146, 3: 2.500}


def ropes(effort: Effort) -> Iterator[Track]:
    """Track covered ropes with and without depth, and swung ones, in two image sizes."""
    for depth, cover, seed, approach, speed in product((False, True), COVERS, effort.seeds(8), (1.0, 8.0), (0.0, 3.0)):
        yield f"rope, {cover}", depth, covered_rope(seed, cover, approach, speed, depth=depth, noise=depth)
    for (small, size), seed in product((("", (480, 640)), (", 160x120", (120, 160))), effort.seeds(8)):
        frames = max(round(300 * min(4 * effort.share, 1)), 60)
        yield f"rope, swung{small}", True, swinging_rope(seed, 33.0, noise=True, frames=frames, size=size)


def flat_objects(effort: Effort) -> Iterator[Track]:
    """Track cloths and outlines under hands, with and without depth, tilted, bent and folded."""
    for depth, view, seed in product((False, True), VIEWS, effort.seeds(8)):
        rng, small = np.random.default_rng(seed), "" if view.height == 480 else ", 160x120"
        moving, speed = (0.0, 4.0)[seed % 2], (1.0, 4.0, 16.0)[seed % 3]
        for name, flat in (("cloth", cloth((1.0, 1.5, 2.0)[seed % 3])), ("outline", ring(rng, bool(seed % 2)))):
            hands: tuple[Hand, ...] = get_args(Hand) if name == "cloth" else ("side",)
            motions: tuple[Motion, ...] = get_args(Motion) if name == "cloth" else ("tilted", "corner up")
            drawn = [("hand", under_hand(rng, flat, view, place, speed, moving, level=not depth)) for place in hands]
            if depth:
                drawn += [(motion, in_space(rng, flat, view, motion, (8.0, 16.0)[seed % 2])) for motion in motions]
            for what, scenes in drawn:
                measured = noisy_depth(scenes, view, seed) if depth else scenes
                follow = seen_points if name == "cloth" else seen_outline
                yield f"{name}, {what}{small}", depth, follow(measured, view, depth)


def environments(effort: Effort) -> Iterator[Track]:
    """Return the simulated environments under random actions."""
    for env, seed in product(ENVS, effort.seeds(8)):
        setting = Setting(env, "d455", "noise", effort.renderer)
        yield f"{env}-v0", True, (row for row in episodes(setting, [seed]) if row.belief)


def beliefs(scene: Track) -> Iterator[Row]:
    """Return for each ok frame of a track a row of ``scores.belief`` with its kind and what was given."""
    kind, depth, frames = scene
    return (Row(row.belief, kind=kind, given="D455 depth" if depth else "mask") for row in frames if row.ok)


def _shares(rows: Sequence[Row], hidden: bool) -> float | None:
    """Return the percentage of errors within the 90 % radius, of the points in sight or of the others."""
    inside = [row.errors <= WITHIN[3 if row.space else 2] * row.sigma for row in rows]
    chosen = [each[row.shown != hidden] for each, row in zip(inside, rows, strict=True)]
    every = np.concatenate(chosen)
    return 100 * float(np.mean(every)) if len(every) else None


def _rms(field: str) -> Column:
    """Return the RMS of a field of the points in sight per axis, in millimetres or pixels."""

    def column(rows: list[Row]) -> float | None:
        if len({row.space for row in rows}) > 1:
            return None  # pixels and millimetres have no common mean
        values = np.concatenate([row[field][row.shown] for row in rows], dtype=np.float64)
        axes, unit = (3, 1e3) if rows[0].space else (2, 1.0)
        return float(unit * np.sqrt(np.mean(values**2) / (axes if field == "errors" else 1)))

    return column


COLUMNS: Final[dict[str, Column]] = {
    "ok frames": len,
    "wrong [%]": lambda rows: 100 * float(np.mean([row.wrong for row in rows])),
    "in sight, inside [%]": lambda rows: _shares(rows, hidden=False),
    "hidden, inside [%]": lambda rows: _shares(rows, hidden=True),
    "RMS error [mm or px]": _rms("errors"),
    "sigma [mm or px]": _rms("sigma"),
}
_WHOLE: Final = {"kind": "all"}
_LIMITS: Final = (
    Limit("in sight, inside [%]", at_least=85, unit="%", where=_WHOLE),
    Limit("hidden, inside [%]", at_least=85, unit="%", where=_WHOLE),
    Limit("in sight, inside [%]", at_most=95, unit="%", where=_WHOLE, sampled=100),
    Limit("wrong [%]", at_most=0.2, unit="%", where=_WHOLE, sampled=0.8),
    Limit("in sight, inside [%]", at_least=60, unit="%"),
)
_KNOWN: Final = (*_LIMITS[:3], replace(_LIMITS[3], known="small folded cloths are wrong in silence"), _LIMITS[4])
_SCENES: Final[tuple[tuple[str, str, Callable[[Effort], Iterator[Any]], tuple[Limit, ...]], ...]] = (
    ("ropes", "Covered and swung ropes", ropes, _LIMITS),
    ("flat", "Cloths and outlines under hands, tilted, bent and folded", flat_objects, _KNOWN),
    ("envs", "Simulated environments under random actions", environments, _LIMITS),
)
CLAIMS: Final = tuple(
    Claim(
        f"sigma.{name}",
        f"{what}: errors within the radius that should hold 90 %, and ok frames that are wrong.",
        scenes,
        beliefs,
        ("kind", "given"),
        COLUMNS,
        total=True,
        limits=limits,
        needs=("mujoco",),
    )
    for name, what, scenes, limits in _SCENES
)
