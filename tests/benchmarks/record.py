"""Recorded ropes whose every node is known, scored strictly: each point against its own node, hidden ones too.

``python -m tests.benchmarks record`` measures this library. The same recordings can be written to files for any other
tracker, whose points are then scored by the same function: see ``record_files``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any, Final, Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics
from shape_obs.configurations.centerline import Centerline
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.topology import Chain
from shape_obs.image.segmentation import HSVRange
from shape_obs.shape import Detection
from shape_obs.tracking.memory import evidence_of_order
from shape_obs.tracking.predict import Track
from shape_obs.tracking.state import RopeState
from tests.benchmarks.claim import Claim, Effort, Limit
from tests.benchmarks.scenes.recorded_ropes import SIZE, Hider, Setting, noise_of, record
from tests.benchmarks.scenes.rope_motion import LENGTH, MOTIONS, NODES, PIECES, Motion, moving_rope
from tests.benchmarks.scores import SLIP
from tests.benchmarks.tables import Column, Row, of, percent, total, worst
from tests.scenes.hidden_ropes import camera_of

Array = npt.NDArray[np.float64]
Depths = Literal["exact", "d455"]
DEPTHS: Final[tuple[Depths, ...]] = get_args(Depths)
SPACING: Final = LENGTH / (NODES - 1)  # metres
RATES: Final = (15, 30, 60, 240)  # hertz
_SPEEDS: Final = (1.0, 0.5, 0.25)  # m/s of the fastest node, in turn
_ENDS: Final[tuple[Hider, ...]] = ("both ends", "first end", "last end")
_ALONG: Final[tuple[Hider, ...]] = ("hand", "arm")
_GONE: Final[tuple[Hider, ...]] = ("board", "border", "at once")
_SECONDS: Final = (10.0, 3.0)  # of a recording at the full share, and at least
_AROUND: Final = (5.0, 2.5)  # seconds of a recording besides those for which something is hidden, and at least
_AWAY: Final = (0.6, 1.0, 2.0, 5.0)  # seconds out of sight after which a rope is asked for its order
_FRAME: Final = 1 / 30  # seconds
_SHORTER: Final = 0.25  # share below which recordings become shorter
_SURE: Final = Centerline.model.sure  # nats


def new_detector(camera: Intrinsics, nodes: Array, hertz: float, segmentation: HSVRange | None = None) -> ShapeDetector:
    """Return a detector for a recording; point 0 of its first frame is the end nearest the true node 0.

    Args:
        camera: The projection.
        nodes: ``(NODES, 3)`` the true nodes of the first frame, metres, camera frame.
        hertz: Frames per second.
        segmentation: The pixel rule for colour images; None if masks are given.
    """
    u, v = camera.project(nodes[0]).tolist()
    spec = Centerline(n=NODES, ends="tips", anchor=(u, v), spacing="m")
    return ShapeDetector([spec], segmentation, dt=1 / hertz, on_invalid="interpolate")


class Claimed(NamedTuple):
    """What a tracker claims of a recording.

    Args:
        points: ``(T, NODES, 3)`` metres, camera frame; NaN in frames that were refused.
        visible: ``(T, NODES)`` the points that it calls visible; all, for a tracker that has no such flag.
        track: ``(T,)`` the number of the track that they belong to; None for a tracker that begins once.
    """

    points: Array
    visible: npt.NDArray[np.bool_]
    track: npt.NDArray[np.int64] | None = None


def claims_of(detections: Sequence[Detection]) -> Claimed:
    """Return what the detections of a recording claim."""
    shapes = [detection.shapes[0] for detection in detections]
    refused = np.full((NODES, 3), np.nan)
    points = [shape.points3d if shape.ok and shape.points3d is not None else refused for shape in shapes]
    visible, track = np.stack([shape.visible for shape in shapes]), np.array([shape.track_id for shape in shapes])
    return Claimed(np.stack(points).astype(np.float64), visible, track)


def strict_score(claimed: Claimed, nodes: Array, visible: npt.NDArray[np.bool_]) -> Row:
    """Compare the points of a recording with the true nodes, each with that of its own index.

    Nothing is minimised: neither over the direction of the rope nor along it. A frame counts as ok if all of its
    points are finite. Errors are those of frames that are ok while any node is in sight.

    Args:
        claimed: By a tracker.
        nodes: ``(T, NODES, 3)`` metres, camera frame.
        visible: ``(T, NODES)`` whether a node is in sight, whatever the tracker calls it.

    Returns:
        The sums that ``RECORD`` makes a table of. ``slips``: frames in which a node is in sight and its point is more
        than half a spacing of nodes away from it. ``claimed_slips``: those in which the tracker also calls the point
        visible. ``flips``: frames in which the reversed order fits better. ``turned``: frames in which that differs
        from the first frame of their track: its order has turned round.
    """
    given, in_sight = np.isfinite(claimed.points).all(axis=(1, 2)), visible.any(axis=1)
    ok = given & in_sight
    found, true, seen, called = claimed.points[ok], nodes[ok], visible[ok], claimed.visible[ok]
    errors = np.linalg.norm(found - true, axis=2)
    flipped = np.linalg.norm(found[:, ::-1] - true, axis=2).mean(axis=1) < errors.mean(axis=1)
    track = np.zeros(len(found), np.int64) if claimed.track is None else claimed.track[ok]
    _, first, of_track = np.unique(track, return_index=True, return_inverse=True)
    off = seen & (errors > SLIP * SPACING)
    return Row(
        frames=len(nodes),
        in_sight=int(in_sight.sum()),
        ok=int(ok.sum()),
        gone=int((~in_sight).sum()),
        ok_gone=int((given & ~in_sight).sum()),
        mm=1e3 * float(errors.sum()),
        points=errors.size,
        mm_visible=1e3 * float(errors[seen].sum()),
        visible_points=int(seen.sum()),
        mm_hidden=1e3 * float(errors[~seen].sum()),
        hidden_points=int((~seen).sum()),
        called=int((called & seen).sum()),
        slips=int(off.any(axis=1).sum()),
        claimed_slips=int((off & called).any(axis=1).sum()),
        flips=int(flipped.sum()),
        turned=int((flipped != flipped[first][of_track]).sum()),
        ms=None,
    )


def _mean(part: str, whole: str) -> Column:
    def column(rows: list[Row]) -> float | None:
        count = sum(row[whole] for row in rows)
        return sum(row[part] for row in rows) / count if count else None

    return column


def _mean_time(rows: list[Row]) -> float | None:
    known = [(row.ms, row.frames) for row in rows if row.ms is not None]
    return sum(ms * frames for ms, frames in known) / sum(frames for _, frames in known) if known else None


# ``ok`` is a share of the frames in which any node is in sight, ``ok, gone`` of the others. Slips and flips are shares
# of the frames that are ok with a node in sight, and ``seen`` of the nodes in sight in these.
RECORD: Final[dict[str, Column]] = {
    "peak [m/s]": of(worst, "peak"),
    "frames": total("frames"),
    "ok [%]": percent("ok", "in_sight"),
    "all [mm]": _mean("mm", "points"),
    "visible [mm]": _mean("mm_visible", "visible_points"),
    "hidden [mm]": _mean("mm_hidden", "hidden_points"),
    "slips [%]": percent("slips", "ok"),
    "claimed slips [%]": percent("claimed_slips", "ok"),
    "seen [%]": percent("called", "visible_points"),
    "flips [%]": percent("flips", "ok"),
    "turned [%]": percent("turned", "ok"),
    "ok, gone [%]": lambda rows: percent("ok_gone", "gone")(rows) if sum(row.gone for row in rows) else None,
    "ms": _mean_time,
}  # fmt: skip


def measured(setting: Setting) -> Iterator[Row]:
    """Track a recording with exact depth and with the noise of a D455; yield the row of each."""
    recording, noise = record(setting), noise_of(setting)
    detectors: dict[Depths, ShapeDetector] = {}
    found: dict[Depths, list[Detection]] = {depths: [] for depths in DEPTHS}
    seconds, truth = dict.fromkeys(DEPTHS, 0.0), list[tuple[Array, npt.NDArray[np.bool_]]]()
    for frame in recording.frames:
        for depths in DEPTHS:
            if depths not in detectors:
                detectors[depths] = new_detector(recording.camera, frame.nodes, setting.hertz)
            depth = frame.depth if depths == "exact" else noise(frame.depth)
            begin = time.thread_time()
            detection = detectors[depths].detect_mask(frame.mask, depth, recording.camera, stamp=frame.stamp)
            seconds[depths] += time.thread_time() - begin
            found[depths].append(detection)
        truth.append((frame.nodes, frame.visible))
    nodes, visible = (np.stack(each) for each in zip(*truth, strict=True))
    for depths in DEPTHS:
        score = strict_score(claims_of(found[depths]), nodes, visible)
        score["ms"] = 1e3 * seconds[depths] / len(truth)
        yield Row({**labels_of(setting, depths, recording.peak), **score})


def orders(scene: tuple[Motion, float, int]) -> Iterator[Row]:
    """Ask which way round a rope is that was out of sight, from its true nodes before and after; yield each answer."""
    motion, speed, seed = scene
    rng = np.random.default_rng([seed, MOTIONS.index(motion), round(100 * speed)])
    rope = moving_rope(rng, motion, speed, 1 + max(_AWAY), camera_of(SIZE))
    for gone, begin in product(_AWAY, rng.uniform(0.2, 1, 2)):
        axes = rope.axis([begin - _FRAME, begin, begin + gone])  # (3, PIECES + 1, 3)
        before, last, after = axes[:, :: PIECES // (NODES - 1)]
        state = np.zeros(1, RopeState)
        state["size"] = LENGTH
        lost = Track(state, last, (last - before) / _FRAME, Chain(NODES))
        yield Row({"hidden [s]": gone, "nats": evidence_of_order(lost, after, gone)})


def _wrong(least: float, most: float) -> Column:
    def column(rows: list[Row]) -> float | None:
        nats = [row.nats for row in rows if least <= abs(row.nats) < most]
        return 100 * sum(each < 0 for each in nats) / len(nats) if nats else None

    return column


def labels_of(setting: Setting, depths: Depths, peak: float) -> dict[str, Any]:
    """Return the fields by which rows are grouped, and the speed of the fastest node."""
    return {**setting._asdict(), "hidden [s]": setting.hidden, "depth": depths, "peak": peak}


def _settings(
    effort: Effort, full: int, motions: Sequence[Motion], hiders: Sequence[Hider], hidden: Sequence[float],
    rates: Sequence[int] = (30,), part: float = 1.0,
) -> Iterator[Setting]:  # fmt: skip
    """Yield the recordings of a claim: all motions, times and rates for each seed, with speeds and hiders in turn.

    Args:
        effort: Below a quarter of the full share recordings are shorter.
        full: Seeds at the full share.
        motions: What moves.
        hiders: What hides the rope, one for each seed in turn; a hand moves along it with and without its arm.
        hidden: Seconds for which it does; 0 for a hand that moves along the rope.
        rates: Frames per second.
        part: Of the length of a recording of a hand that moves along.
    """
    for k, seed in enumerate(effort.seeds(full)):
        speed = _SPEEDS[k % len(_SPEEDS)]
        turn = hiders if hiders == _ALONG else (hiders[(k + k // len(_SPEEDS)) % len(hiders)],)
        for motion, hider, gone, hertz in product(motions, turn, hidden, rates):
            long, least = _AROUND if gone else _SECONDS
            seconds = max(min(effort.share / _SHORTER, 1.0) * part * long, least)
            yield Setting(motion, hider, gone, hertz, speed, gone + seconds, seed)


def _claim(
    name: str,
    what: str,
    by: tuple[str, ...],
    limits: tuple[Limit, ...],
    settings: Callable[[Effort], Iterator[Setting]],
) -> Claim:
    return Claim(
        f"record.{name}", f"A recorded rope of 0.78 m and 14 nodes, up to 1 m/s: {what}", settings, measured,
        (*by, "depth"), RECORD, limits=limits, held_out=True,
    )  # fmt: skip


_PREDICTED: Final = "short pieces next to a hand are left out: their nodes are predicted, and not called visible"
_LONG: Final = (
    "an arm hides up to ten nodes, whose way is predicted; what is seen between two hidden parts may be left out"
)
_SLIDES: Final = "a rope that moves with both ends hidden may slide along itself: it is refused until an end is seen"
_RENEWED: Final = "a rope whose form does not show its order is numbered from the end nearest the anchor"
_TOUCHES: Final = "strands of a loop that meet under a hand may be joined wrongly; a loss may end the track"
_UNCERTAIN: Final = (
    "ok [%]",
    "visible [mm]",
    "claimed slips [%]",
    "flips [%]",
    "turned [%]",
)  # they follow from a lost identity


def _limits(known: str, where: Mapping[str, Any] | None = None, missed: Collection[str] = ()) -> tuple[Limit, ...]:
    """Return the limits of a claim.

    Args:
        known: Why slips and errors are above their limits today.
        where: The rows.
        missed: Other columns that miss their limits for the same reason.
    """
    limits = (
        Limit("ok [%]", at_least=95, unit="%", sampled=80), Limit("visible [mm]", at_most=6, unit="mm", sampled=10),
        Limit("all [mm]", at_most=5, unit="mm", known=known), Limit("slips [%]", at_most=2, unit="%", known=known),
        Limit("claimed slips [%]", at_most=3, unit="%", sampled=8), Limit("flips [%]", at_most=1, unit="%", sampled=5),
        Limit("turned [%]", at_most=0.5, unit="%", sampled=2),
    )  # fmt: skip
    reasons = {limit.column: known if limit.column in missed else limit.known for limit in limits}
    return tuple(replace(limit, where=where or {}, known=reasons[limit.column]) for limit in limits)


CLAIMS: Final = (
    _claim(
        "motion", "it rests, moves rigidly, bends, or both, while a hand or a whole arm moves along it.",
        ("motion", "hider"),
        (*_limits(_PREDICTED, {"hider": "hand"}), *_limits(_LONG, {"hider": "arm"}, _UNCERTAIN)),
        lambda effort: _settings(effort, 4, ("static", "rigid", "bending", "both"), _ALONG, (0.0,)),
    ),
    _claim(
        "rates", "it moves and bends at several frame rates, while a hand moves along it.", ("hertz",),
        _limits(_PREDICTED),
        lambda effort: _settings(effort, 3, ("both",), ("hand",), (0.0,), RATES, 0.6),
    ),
    _claim(
        "ends", "it moves and bends while hands hide one end or both for some seconds.", ("hidden [s]",),
        _limits(_SLIDES, missed=_UNCERTAIN),
        lambda effort: _settings(effort, 6, ("both",), _ENDS, (1.0, 3.0, 10.0)),
    ),
    _claim(
        "gone", "it moves and bends and is out of sight for some seconds.", ("hidden [s]",),
        _limits(_RENEWED, missed=_UNCERTAIN),
        lambda effort: _settings(effort, 6, ("both",), _GONE, (0.5, 1.0, 5.0)),
    ),
    Claim(
        "record.order", "Which way round a rope is that moved and bent out of sight, as its form shows.",
        lambda effort: product(("rigid", "bending", "both"), _SPEEDS, effort.seeds(60)), orders, ("hidden [s]",),
        {"ropes": len, "decided [%]": lambda rows: 100 * float(np.mean([abs(row.nats) >= _SURE for row in rows])),
         "decided wrong [%]": _wrong(_SURE, np.inf), "wrong at 3 to 5 nats [%]": _wrong(3, _SURE)},
        limits=(
            Limit("decided [%]", at_least=90, unit="%", sampled=80),
            Limit("decided wrong [%]", at_most=0.67, unit="%", sampled=1.5),
        ),
        held_out=True,
    ),
    _claim(
        "crossing", "it crosses itself in motion and parts again, while a hand or an arm moves along it.", ("hider",),
        _limits(_TOUCHES, missed=_UNCERTAIN),
        lambda effort: _settings(effort, 4, ("crossing",), _ALONG, (0.0,)),
    ),
)  # fmt: skip
