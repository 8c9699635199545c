"""Compare the library with that of another work tree on the same scenes, paired by track.

``python -m tests.benchmarks gates OTHER [NAME ...]`` measures claims with both libraries at the same time, each in a
Python of its own. Scenes and measures are those of this work tree for both, so that only ``shape_obs`` differs; their
seed derives from the hash of this commit. ``OTHER`` is a work tree of the same repository with its own ``.venv``::

    git worktree add --detach ../before HEAD~1 && (cd ../before && uv sync)
    uv run python -m tests.benchmarks gates ../before hidden record several

A row of the result is a column of a claim's table that a limit bounds, in one group of its scenes. It is worse or
better only if zero is outside the interval that a bootstrap over the tracks gives for the difference.
"""

from __future__ import annotations

import argparse
import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from tests.benchmarks.claim import Claim, Effort
from tests.benchmarks.runner import all_claims, commit_seed, select
from tests.benchmarks.tables import Column, Row, as_markdown

#: The rows of one claim, those of each scene in a list.
Measured = list[list[Row]]

_TESTS: Final = Path(__file__).resolve().parents[1]
_DRAWS: Final = 2000  # of the bootstrap; the ends of an interval vary by a twentieth of its length
_LEVEL: Final = 95.0  # percent


class Gate(NamedTuple):
    """How a column of a group of scenes differs between two libraries.

    Args:
        before: Its value with the other library; None without a value.
        now: Its value with this one.
        low: The lower end of the interval of the difference; None if a draw has no value.
        high: The upper end.
        verdict: "worse", "better", "equal" or, if neither value is known, "-".
    """

    before: float | None
    now: float | None
    low: float | None
    high: float | None
    verdict: str


def gate(before: Measured, now: Measured, column: Column, larger_is_better: bool, seed: int = 0) -> Gate:
    """Compare a column over the tracks of a group, by a paired bootstrap (Efron and Tibshirani 1993, chapter 16).

    Args:
        before: The rows of each track, with the other library.
        now: The same with this one.
        column: Takes rows, and returns a number or None.
        larger_is_better: Whether it is worse if it is smaller.
        seed: Of the draws.
    """
    first, second = (_value(column, tracks, range(len(tracks))) for tracks in (before, now))
    if first is None or second is None:
        verdict = "worse" if first is not None else "better" if second is not None else "-"
        return Gate(first, second, None, None, verdict)
    drawn = np.random.default_rng(seed).integers(len(now), size=(_DRAWS, len(now)))
    differences = []
    for tracks in drawn.tolist():
        pair = _value(column, now, tracks), _value(column, before, tracks)
        if pair[0] is not None and pair[1] is not None:
            differences.append(pair[0] - pair[1])
    low, high = np.percentile(differences, [(100 - _LEVEL) / 2, (100 + _LEVEL) / 2]).tolist()
    worse, better = (high < 0, low > 0) if larger_is_better else (low > 0, high < 0)
    return Gate(first, second, low, high, "worse" if worse else "better" if better else "equal")


def _value(column: Column, tracks: Measured, chosen: Sequence[int]) -> float | None:
    """Return a column over the rows of some tracks; None if it has no value."""
    found = column([row for track in chosen for row in tracks[track]])
    return None if found is None or found != found else float(found)


def gates_of(claim: Claim, before: Measured, now: Measured) -> Iterator[Row]:
    """Yield the rows of a claim: for each group, how many tracks and frames, and each column that a limit bounds.

    Raises:
        ValueError: The libraries were measured on different scenes.
    """
    if [_groups(claim, rows) for rows in before] != [_groups(claim, rows) for rows in now]:
        raise ValueError(f"{claim.name}: the scenes differ between the libraries; expected the same rows of each.")
    better = {limit.column: limit.at_most is None for limit in claim.limits}
    shown = {name: column for name, column in claim.columns.items() if name in better or name == "ok [%]"}
    for group in dict.fromkeys(key for rows in now for key in _groups(claim, rows)):
        pair = [[part for rows in all_rows if (part := _of(claim, rows, group))] for all_rows in (before, now)]
        frames = sum(row.get("frames", 1) for rows in pair[1] for row in rows)
        for name, column in shown.items():
            found = gate(pair[0], pair[1], column, better.get(name, True))
            where = ", ".join(f"{field} {value}" for field, value in zip(claim.by, group, strict=True))
            yield Row(
                {"claim": claim.name, "scenes": where, "tracks": len(pair[1]), "frames": frames, "column": name},
                before=found.before, now=found.now, low=found.low, high=found.high, verdict=found.verdict,
            )  # fmt: skip


def _groups(claim: Claim, rows: Sequence[Row]) -> list[tuple[Any, ...]]:
    return [tuple(row[name] for name in claim.by) for row in rows]


def _of(claim: Claim, rows: Sequence[Row], group: tuple[Any, ...]) -> list[Row]:
    return [row for row, key in zip(rows, _groups(claim, rows), strict=True) if key == group]


def measured(claim: Claim, effort: Effort) -> Measured:
    """Return the rows of each scene of a claim."""
    scenes = (claim.measure(scene) for scene in claim.scenes(effort))
    return [[found] if isinstance(found, Row) else list(found) for found in scenes]


def _start(tree: Path, scratch: Path, file: Path, names: Sequence[str], effort: Effort) -> subprocess.Popen[bytes]:
    """Measure claims with the library of a work tree, in its Python, on the scenes of this one."""
    python = tree / ".venv" / "bin" / "python"
    if not python.exists():
        raise ValueError(f"{tree}: expected a work tree with an environment of its own, .venv; run `uv sync` in it.")
    command = [str(python), "-m", "tests.benchmarks.gates", "--rows", str(file), *names]
    command += ["--share", str(effort.share), "--seed", str(effort.seed)]
    one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    return subprocess.Popen(command, cwd=scratch, env={**os.environ, **one})


def compare(other: Path, names: Sequence[str], effort: Effort) -> list[Row]:
    """Return the rows of all claims.

    Raises:
        ValueError: The other work tree has no environment, or a claim's name is wrong.
        RuntimeError: A library could not be measured.
    """
    claims = [claim for claim in select(all_claims(), names) if claim.by and claim.columns and not claim.alone]
    with tempfile.TemporaryDirectory() as folder:
        scratch = Path(folder)
        (scratch / "tests").symlink_to(_TESTS, target_is_directory=True)  # the library is that of the Python
        files = [scratch / "before.pickle", scratch / "now.pickle"]
        trees = other.resolve(), _TESTS.parent
        running = [
            _start(tree, scratch, file, [each.name for each in claims], effort)
            for tree, file in zip(trees, files, strict=True)
        ]
        codes = [process.wait() for process in running]
        if any(codes):
            raise RuntimeError("a library could not be measured; its error stands above.")
        before, now = (pickle.loads(file.read_bytes()) for file in files)
    return [row for claim in claims for row in gates_of(claim, before[claim.name], now[claim.name])]


def main(argv: Sequence[str]) -> int:
    """Compare two libraries and print the table; return 1 if a row is worse, 2 for wrong arguments."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks gates", description="Compare the library with that of another work tree."
    )
    parser.add_argument("other", nargs="?", type=Path, help="the other work tree, with its own .venv")
    parser.add_argument("names", nargs="*", metavar="NAME", help="claims or groups of claims")
    parser.add_argument("--share", type=float, default=1.0, help="share of the full number of scenes (default: 1)")
    parser.add_argument("--seed", type=int, help="random seed (default: from the commit's hash)")
    parser.add_argument("--rows", type=Path, metavar="FILE", help=argparse.SUPPRESS)
    args = parser.parse_args(argv)
    seed = commit_seed() if args.seed is None else args.seed
    effort = Effort(args.share, seed)
    if args.rows:
        claims = select(all_claims(), [str(args.other), *args.names])
        args.rows.write_bytes(pickle.dumps({claim.name: measured(claim, effort) for claim in claims}))
        return 0
    if args.other is None:
        parser.error("the other work tree is missing")
    try:
        rows = compare(args.other, args.names, effort)
    except (ValueError, RuntimeError) as error:
        parser.error(str(error))
    print(f"{as_markdown(rows)}\n\nShare {effort.share:g}, seed {effort.seed}.")
    return int(any(row.verdict == "worse" for row in rows))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
