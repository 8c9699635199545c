"""Each constant of the tracker, halved and doubled: what changes in recorded streams and for ropes under hands."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from functools import cache
from itertools import product
from typing import Any, Final

import numpy as np

from shape_obs.configurations.base import Configuration
from shape_obs.configurations.centerline import Centerline
from shape_obs.configurations.contour import Contour
from shape_obs.configurations.surface import Surface
from shape_obs.tracking.model import MotionModel
from tests.benchmarks.claim import Claim, Effort, Limit
from tests.benchmarks.hidden import seen_rope, swinging_frames
from tests.benchmarks.scores import visible_row
from tests.benchmarks.tables import Row
from tests.golden.judge import Score, differences, score
from tests.golden.streams import Outcome, Stream, configurations, load_outcome, load_stream, names, play
from tests.scenes.beams import swinging_beam, tracked_beam
from tests.scenes.hidden_ropes import Cover, Seen, hidden_ropes

KINDS: Final[dict[str, type[Configuration]]] = {"rope": Centerline, "outline": Contour, "sheet": Surface}
FACTORS: Final = (0.5, 2.0)
_COVERS: Final[tuple[Cover, ...]] = ("hand", "shadow", "bar", "border")
_APPROACHES: Final = (1.0, 4.0, 16.0)  # pixels per frame
_HERTZ: Final = (15, 60)
_BEAM_HERTZ: Final = (10, 30, 240)
_SIZE: Final = (240, 320)
_NO_CHANGE: Final = 0.01  # gaps: points that differ by less do not


@contextmanager
def model_of(kind: type[Configuration], model: MotionModel) -> Iterator[None]:
    """Give a configuration another model for a while."""
    before = kind.model
    kind.model = model
    try:
        yield
    finally:
        kind.model = before


def changed(model: MotionModel, name: str, place: int | None, factor: float) -> MotionModel:
    """Return a model with one constant, or one value of a constant that has several, times a factor."""
    value = getattr(model, name)
    if place is None:
        return replace(model, **{name: value * factor})
    return replace(model, **{name: tuple(each * (factor if k == place else 1) for k, each in enumerate(value))})


def values(kind: type[Configuration]) -> Iterator[tuple[str, int | None]]:
    """Yield the name of each constant; with a number for each of several values."""
    for each in fields(kind.model):
        count = np.size(getattr(kind.model, each.name))
        yield from ((each.name, k if count > 1 else None) for k in range(count))


@cache
def _streams(kind: type[Configuration]) -> list[tuple[Stream, Outcome, Score]]:
    """Return the streams in which a shape of a kind is looked for, and what is expected of them."""
    found = []
    for name in names():
        stream = load_stream(name)
        if any(isinstance(spec, kind) for spec in configurations(stream)):
            expected = load_outcome(name)
            found.append((stream, expected, score(stream, expected)))
    return found


def _beams(seed: int) -> list[int]:
    """Return how many frames of thick beams that swing at the border are refused, by rate and depth."""
    found = []
    for hertz, depth in product(_BEAM_HERTZ, (False, True)):
        beam = swinging_beam(np.random.default_rng([seed, hertz]), hertz, 4, max(hertz, 40), drop=0.15, jitter=0.3)
        found.append(tracked_beam(beam, depth=depth)["refused"])
    return found


@cache
def _tracks(seed: int) -> tuple[list[tuple[dict[str, Any], list[Seen], list[Row]]], list[int]]:
    """Return ropes that are covered or swung, how they are tracked, and what is found; and the same of ``_beams``."""
    scenes: list[tuple[dict[str, Any], list[Seen]]] = []
    for cover, approach, depth in product(_COVERS, _APPROACHES, (False, True)):
        rng = np.random.default_rng([seed, round(approach), depth])
        frames = hidden_ropes(rng, cover, approach, 3.0, share=float(rng.uniform(0.15, 0.45)), size=_SIZE)
        scenes.append(({"depth": depth}, list(frames)))
    for hertz, noise, k in product(_HERTZ, (False, True), range(2)):
        frames = swinging_frames(seed + k, hertz, noise=noise, frames=100, size=_SIZE)
        scenes.append(({"depth": True, "spacing": "m", "dt": 1 / hertz}, list(frames)))
    return [(how, frames, list(seen_rope(frames, **how))) for how, frames in scenes], _beams(seed)


def scenes(effort: Effort) -> list[dict[str, Any]]:
    """Return every value of every model and its factors, or a share of them."""
    found = [
        {"kind": kind, "constant": name, "place": place, "factor": factor, "seed": effort.seed}
        for kind, shape in KINDS.items()
        for (name, place), factor in product(values(shape), FACTORS)
    ]
    return found[:: max(round(1 / effort.share), 1)]


def measure(scene: dict[str, Any]) -> Row:
    """Track everything with one value changed; return what differs from before.

    Returns:
        ``changed``: how many recorded streams, and tracks of drawn ropes (all beams count as one), are not as before;
        by how much the mean errors of the streams in sight and hidden change; the differences of counts.
    """
    kind, seed, name, place = KINDS[scene["kind"]], scene["seed"], scene["constant"], scene["place"]
    streams, (tracks, usual_beams) = _streams(kind), _tracks(seed) if kind is Centerline else ([], [])
    found: dict[str, list[float]] = {column: [] for column in ("error [%]", "hidden error [%]", "refused", "slips")}
    other, apart, before, after, refused = 0, 0, list[Row](), list[Row](), 0
    with model_of(kind, changed(kind.model, name, place, scene["factor"])):
        for stream, expected, usual in streams:
            outcome, _ = play(stream)
            if differences(expected, outcome):
                now, other = score(stream, outcome), other + 1
                changes = 100 * (now.error / usual.error - 1), 100 * (now.hidden / usual.hidden - 1)
                for column, change in zip(
                    found, (*changes, now.refused - usual.refused, now.slips - usual.slips), strict=True
                ):
                    found[column].append(change)
        for how, frames, usual in tracks:
            rows = list(seen_rope(frames, **how))
            apart += any(_differ(*pair) for pair in zip(rows, usual, strict=True))
            before, after = [*before, visible_row(usual)], [*after, visible_row(rows)]
        if kind is Centerline:
            beams = _beams(seed)
            refused, apart = sum(beams) - sum(usual_beams), apart + (beams != usual_beams)
    row = Row(shape=scene["kind"], constant=name if place is None else f"{name}[{place}]", factor=scene["factor"])
    row |= {"changed": other + apart, "streams": other, "tracks": apart}
    for column, some in found.items():
        finite = [each for each in some if np.isfinite(each)]
        row[column] = sum(finite) / (len(streams) if "%" in column else 1)
    for column in ("slips", "refused", "far"):
        row[f"{column} of tracks"] = sum(each[column] for each in after) - sum(each[column] for each in before)
    row["refused of beams"] = refused
    return row


def _differ(row: Row, usual: Row) -> bool:
    """Return whether a frame of a track differs: by a hundredth of a gap, in what is visible, or in being refused."""
    same = row.ok == usual.ok and bool((row.visible == usual.visible).all())
    return not same or not np.allclose(row.off, usual.off, atol=_NO_CHANGE, equal_nan=True)


_GUARDS: Final = "some constants guard cases that these scenes lack"
CLAIMS: Final = (
    Claim(
        "sensitivity.constants",
        "Each constant of the tracker, halved and doubled: recorded streams, and ropes under hands or swung in space.",
        scenes, measure, limits=(Limit("changed", at_least=1, known=_GUARDS),), needs=("mujoco",),
    ),
)  # fmt: skip
