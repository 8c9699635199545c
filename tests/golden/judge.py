"""``python -m tests.golden.judge [NAME...] [--json]``: is each stream detected as before, and how near the truth?"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs import Configuration
from shape_obs.geometry.topology import Grid, Ring
from tests.golden.streams import Outcome, Stream, Truth, configurations, load_outcome, load_stream, names, play

Array = npt.NDArray[Any]
# How far numbers may differ: absolute, and as a share.
TOLERANCES: Final = {
    "points2d": (0.05, 0.0),  # pixels
    "points3d": (1e-4, 0.0),  # metres
    "quality": (0.01, 0.0),
    "age": (1e-5, 0.0),  # seconds
    "length": (2e-4, 0.0),  # metres
}
_SIGMA: Final = {"px": (0.05, 0.02), "mm": (1e-4, 0.02)}
_SLIP: Final = {"px": 3.0, "mm": 8.0}  # mean error from which another numbering that fits twice as well counts
_PIXELS, _METRES, _HIDDEN = slice(0, 2), slice(2, 5), 5


class Score(NamedTuple):
    """How good the detections of a stream are.

    Args:
        unit: Of the errors: mm where points are in space, else px.
        ok: Share of the frames, over all shapes that have a truth.
        error: RMS distance of found points from the truth, where the truth is in sight; NaN if nothing was found.
        hidden: The same where it is not in sight; NaN if all was in sight.
        slips: Frames in which a shape is numbered as another end, corner, turn or object is.
        refused: Frames in which a shape was not found, summed over the shapes.
    """

    unit: str
    ok: float
    error: float
    hidden: float
    slips: int
    refused: int


def differences(expected: Outcome, outcome: Outcome) -> list[str]:
    """Return in which fields detections differ by more than the tolerances, and where first; empty if they do not."""
    if expected.visible.shape != outcome.visible.shape:
        return [f"frames, shapes and points: {outcome.visible.shape}, not {expected.visible.shape}"]
    unit, found = unit_of(expected), []
    for name, old, new in zip(Outcome._fields, expected, outcome, strict=True):
        if name in TOLERANCES or name == "sigma":
            absolute, share = _SIGMA[unit] if name == "sigma" else TOLERANCES[name]
            off = ~np.isclose(new, old, rtol=share, atol=absolute, equal_nan=True)
        else:
            off = new != old
        if off.any():
            first = tuple(int(k) for k in np.argwhere(off)[0])
            where = ", ".join(f"{axis} {k}" for axis, k in zip(("frame", "shape", "point"), first, strict=False))
            found.append(f"{name}: {np.count_nonzero(off)} values; at {where}: {new[first]!s} not {old[first]!s}")
    return found


def unit_of(outcome: Outcome) -> str:
    """Return the unit of a stream's points: ``"mm"`` if there are any in space, else ``"px"``."""
    return "mm" if np.isfinite(outcome.points3d).any() else "px"


def score(stream: Stream, outcome: Outcome) -> Score:
    """Measure detections against the truth."""
    unit, seen, unseen = unit_of(outcome), [], []
    slips = refused = frames = good = 0
    specs = configurations(stream)
    for slot, spec in enumerate(specs):
        objects = [each for each in stream.truth if each.shape == _family(spec)]
        used = outcome.track_id[:, slot] > 0
        spare = sum(_family(each) == _family(spec) for each in specs) > len(objects)  # slots for more than there are
        if spare and not used.any():
            continue
        frames, good = frames + stream.frames, good + int(outcome.ok[:, slot].sum())
        track = (-1, -1)
        for frame in range(stream.frames):
            found = outcome.reason[frame, slot] == "" and used[frame]
            refused += not found
            if not found:
                continue
            points = (outcome.points3d if unit == "mm" else outcome.points2d)[frame, slot, : spec.layout.size]
            away = _distances(points, spec, objects, frame, stream, unit)
            mean = np.array([np.nanmean(each[0]) if np.isfinite(each[0]).any() else np.inf for each in away])
            if not np.isfinite(mean).any():
                continue
            number = int(outcome.track_id[frame, slot])
            if number != track[0] or spec.order == "image":
                track = (number, int(np.argmin(mean)))
            error, hidden = away[track[1]]
            slips += bool(mean[track[1]] > _SLIP[unit] and mean.min() < mean[track[1]] / 2)
            seen.append(error[~hidden])
            unseen.append(error[hidden])
    return Score(unit, good / max(frames, 1), _rms(seen), _rms(unseen), slips, refused)


def _family(spec: Configuration) -> str:
    """Return the name that all slots of a configuration share."""
    return spec.name.rstrip("0123456789")


def _rms(errors: list[Array]) -> float:
    values = np.concatenate(errors) if errors else np.zeros(0)
    values = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def _distances(
    points: Array, spec: Configuration, objects: list[Truth], frame: int, stream: Stream, unit: str
) -> list[tuple[Array, Array]]:
    """Return for each numbering of each object how far the points are off, ``(N,)`` px or mm, and which are hidden."""
    in_space = spec.spacing == "m" or spec.lift == "cloud" or stream.clouds is not None
    metric = _METRES if in_space else _PIXELS
    away = []
    for truth in objects:
        values = np.column_stack([truth.pixels[frame], truth.metres[frame], truth.hidden[frame]]).astype(np.float64)
        if spec.radius:
            reach = np.linalg.norm(values[:, _METRES], axis=1, keepdims=True)
            values[:, _METRES] *= 1 + spec.radius / reach  # the truth is on the surface, and the axis was asked for
        for true in _numberings(spec, values, metric, stream.anchored):
            places = true[:, _METRES] * 1e3 if unit == "mm" else true[:, _PIXELS]
            scale = 1e3 if unit == "mm" else 1.0
            away.append((np.linalg.norm(points * scale - places, axis=1), true[:, _HIDDEN] > 0.5))
    return away


def _numberings(spec: Configuration, values: Array, metric: slice, anchored: bool) -> Array:
    """Return the true points of a shape in each order that the object's symmetry allows: ``(K, N, 6)``.

    Args:
        spec: The shape.
        values: ``(P, 6)`` u, v, x, y, z and hidden, in order along the object.
        metric: The columns in which gaps are equal.
        anchored: Only the first of them.
    """
    layout, centred = spec.layout, getattr(spec, "ends", None) != "tips"
    if isinstance(layout, Grid):
        side = round(len(values) ** 0.5)
        lattice = values.reshape(side, side, 6)
        turned = [_over(np.rot90(lattice, k), layout.rows, layout.cols, metric, centred) for k in range(4)]
        return np.array(turned[:1] if anchored else turned)
    closed = isinstance(layout, Ring)
    line = np.concatenate([values, values[:1]]) if closed else values
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line[:, metric], axis=0), axis=1))])
    if closed:
        start = arc[:1] if anchored else arc[:-1]
        at = (start[:, None] + np.arange(layout.size) / layout.size * arc[-1]) % arc[-1]
    else:
        at = _shares(layout.size, centred)[None] * arc[-1]
        at = at if anchored else np.concatenate([at, at[:, ::-1]])
    return np.stack([np.interp(at, arc, column) for column in line.T], axis=-1)


def _over(lattice: Array, rows: int, cols: int, metric: slice, centred: bool) -> Array:
    """Return ``(rows * cols, 6)`` points over a lattice with gaps that are equal on the mean."""
    for axis, count in ((0, rows), (1, cols)):
        gaps = np.linalg.norm(np.diff(lattice[..., metric], axis=axis), axis=-1).mean(axis=1 - axis)
        arc = np.concatenate([[0.0], np.cumsum(gaps)])
        at = np.interp(_shares(count, centred) * arc[-1], arc, np.arange(len(arc)))
        low = np.minimum(at.astype(int), len(arc) - 2)
        share = np.expand_dims(at - low, (1, 2) if axis == 0 else (0, 2))
        lattice = (1 - share) * lattice.take(low, axis) + share * lattice.take(low + 1, axis)
    return lattice.reshape(-1, 6)


def _shares(count: int, centred: bool) -> Array:
    return (np.arange(count) + 0.5) / count if centred else np.linspace(0, 1, count)


class Verdict(NamedTuple):
    """One stream, judged."""

    name: str
    frames: int
    differences: list[str]
    score: Score
    expected: Score
    ms: float


def judge(name: str) -> Verdict:
    """Play a stream and compare the detections with the expected ones and with the truth."""
    stream, expected = load_stream(name), load_outcome(name)
    outcome, took = play(stream)
    off = differences(expected, outcome)
    return Verdict(name, stream.frames, off, score(stream, outcome), score(stream, expected), took)


def table(verdicts: list[Verdict]) -> str:
    """Return the verdicts as lines: with what was expected where that differs."""
    head = f"{'stream':24} same frames    ok    error   hidden      slips refused  ms/frame"
    lines = [head]
    for each in verdicts:
        same = "no " if each.differences else "yes"
        lines.append(f"{each.name:24} {same:4} {each.frames:6} {_row(each.score)} {each.ms:9.2f}")
        if each.differences:
            lines.append(f"{'  expected':24} {'':4} {'':6} {_row(each.expected)}")
            lines += [f"    {line}" for line in each.differences]
    same = sum(not each.differences for each in verdicts)
    return "\n".join([*lines, f"{same} of {len(verdicts)} streams are the same."])


def _row(found: Score) -> str:
    error, hidden = (f"{value:8.2f}" if np.isfinite(value) else f"{'-':>8}" for value in (found.error, found.hidden))
    return f"{found.ok:5.0%} {error} {hidden} {found.unit:3} {found.slips:6} {found.refused:7}"


def _as_json(verdict: Verdict) -> dict[str, Any]:
    row = verdict._asdict()
    for key in ("score", "expected"):
        row[key] = {name: None if value != value else value for name, value in row[key]._asdict().items()}
    return row


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; return 1 if a stream differs, 2 for an unknown name."""
    parser = argparse.ArgumentParser(prog="python -m tests.golden.judge", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="streams, or patterns such as 'rope_*'; default all")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    options = parser.parse_args(argv)
    try:
        verdicts = [judge(name) for name in names(options.names)]
    except LookupError as error:
        print(error.args[0], file=sys.stderr)
        return 2
    if options.json:
        print(json.dumps([_as_json(each) for each in verdicts], indent=1))
    else:
        print(table(verdicts))
    return int(any(each.differences for each in verdicts))


if __name__ == "__main__":
    sys.exit(main())
