"""Measure the identity of several ropes that move: over each other, into contact, under a hand, out of the image."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.configurations.centerline import Centerline
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.polyline import arc_length
from shape_obs.shape import Shape
from tests.benchmarks.scenes.moving_ropes import MOTIONS, Moment, Motion, moving_ropes
from tests.benchmarks.tables import Row, median, summary

Array = npt.NDArray[np.float64]
_TRACKED: Final = 20
# In gaps between points: how far a visible point lies from its place on its rope, and from its place at all, if it has
# slipped; how far along the rope a point is looked for.
_SLIP: Final = 0.5
_OFF: Final = 1.5
_LOOK: Final = 2.5


def rope_tracks(
    seeds: Iterable[int], *, kinds: Sequence[Motion] = MOTIONS, count: int = 3, frames: int = 180
) -> Iterator[Row]:
    """Follow ropes that move by up to 15 px a frame, and yield a row of ``follow`` for each run."""
    for kind in kinds:
        for seed in seeds:
            rng = np.random.default_rng([seed, count])
            yield Row(kind=kind, seed=seed, **follow(moving_ropes(rng, count, frames, kind=kind), count))


def follow(moments: Iterable[Moment], count: int) -> Row:
    """Follow ropes in ``count`` slots and compare each slot with the rope on which it was first found.

    A slot stays with its rope, whatever its ``track_id``. A new ``track_id`` may begin at the other end.

    Returns:
        ``due``: slots times frames in which some rope has no less than half of its length in sight for each of them;
        ``found``: slots that were found in a frame, and ``ok``: those due at most; ``swaps``: found slots that lie on
        another slot's rope; ``flips``: those that are numbered from the other end; ``slips``: those with a visible
        point that is more than half a gap from its place along the rope, of the ``measured`` ones: slots whose rope
        was cut by the image's border when the track began have an unknown length; ``hidden``: slips of slots whose
        rope was partly covered when the track began; ``renewed``: new values of
        ``track_id``; ``ms``: the times of ``detect_mask``.
    """
    detector = ShapeDetector([Centerline(n=_TRACKED, count=count, ends="tips")])
    row = Row(due=0, found=0, ok=0, swaps=0, flips=0, slips=0, measured=0, hidden=0, renewed=0, ms=[])
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


def track_table(rows: Iterable[Row]) -> list[Row]:
    """Return a row for each kind of motion, shares in percent."""

    def total(field: str) -> Callable[[list[Row]], int]:
        return lambda runs: sum(run[field] for run in runs)

    def share(part: str, whole: str) -> Callable[[list[Row]], float]:
        return lambda runs: 100 * total(part)(runs) / max(total(whole)(runs), 1)

    columns = {
        "runs": len,
        "ok_%": share("ok", "due"),
        "swaps": total("swaps"),
        "flips": total("flips"),
        "slips": total("slips"),
        "hidden": total("hidden"),
        "measured": total("measured"),
        "slips_%": share("slips", "measured"),
        "runs_with_slips": lambda runs: sum(run.slips > 0 for run in runs),
        "renewed": total("renewed"),
        "ms": lambda runs: median(ms for run in runs for ms in run.ms),
    }
    return summary(rows, ("kind",), columns)


@dataclass(frozen=True)
class _Seat:
    """The rope of a slot, and the direction of its points.

    Args:
        rope: Index of the rope.
        forwards: Whether point 0 is at its start.
        whole: Whether all of it was in the image when the track began.
        shown: Whether all of it was in sight then.
        track_id: Of the track.
    """

    rope: int
    forwards: bool
    whole: bool
    shown: bool
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
        size = np.array(moment.mask.shape[::-1])
        whole = bool(((curve >= -0.5) & (curve <= size - 0.5)).all())
        seats[shape.name] = seat = _Seat(
            rope, bool(ends[0] <= ends[1]), whole, bool(moment.visible[rope].all()), shape.track_id
        )
    curve = curve if seat.forwards else curve[::-1]
    arc = arc_length(np.ascontiguousarray(curve))
    gap = arc[-1] / (len(points) - 1)
    true = curve[_even(curve)]
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
    slipped = bool((visible & ((along > _SLIP * gap) | (error > _OFF * gap))).any())
    row["slips"] += slipped
    row["hidden"] += slipped and not seat.shown


def _even(curve: Array) -> npt.NDArray[np.intp]:
    """Return the indices of points at equal steps along a curve whose points are a pixel apart."""
    return np.round(np.linspace(0, len(curve) - 1, _TRACKED)).astype(np.intp)
