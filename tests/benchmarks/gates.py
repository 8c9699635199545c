"""Compare the library with that of another work tree on the same scenes, paired by track.

``python -m tests.benchmarks gates OTHER [NAME ...]`` measures one claim after the other with both libraries at the same
time, each in a Python of its own, and prints the table of each as soon as both have ended. Scenes and measures are
those of this work tree for both, so that only ``shape_obs`` differs; their seed derives from the hash of this commit.
``OTHER`` is a work tree of the same repository with its own ``.venv``::

    git worktree add --detach ../before HEAD~1 && (cd ../before && uv sync)
    uv run python -m tests.benchmarks gates ../before hidden record several

A row of a table is a column of the claim's own table that a limit bounds, in one group of its scenes. It is worse or
better only if zero is outside the interval that a bootstrap over the tracks gives for the difference, and not with
few tracks, whose interval says little. Each row also says how many frames were ok before and now, in percent: errors
are easily smaller where more is refused.
"""

from __future__ import annotations

import argparse
import os
import pickle
import subprocess
import sys
import tempfile
import time
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
_FEWEST: Final = 6  # tracks; fewer that all differ in one direction do so by chance in more than a twentieth of cases


class Gate(NamedTuple):
    """How a column of a group of scenes differs between two libraries.

    Args:
        before: Its value with the other library; None without a value.
        now: Its value with this one.
        low: The lower end of the interval of the difference; None if a draw has no value.
        high: The upper end.
        verdict: "worse", "better", "equal", "few" with too few tracks for one of these, or "-" if no value is known.
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
    few = (worse or better) and len(now) < _FEWEST
    return Gate(first, second, low, high, "few" if few else "worse" if worse else "better" if better else "equal")


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
        raise ValueError("the scenes differ between the libraries; expected the same rows of each.")
    better = {limit.column: limit.at_most is None for limit in claim.limits}
    for group in dict.fromkeys(key for rows in now for key in _groups(claim, rows)):
        pair = [[part for rows in all_rows if (part := _of(claim, rows, group))] for all_rows in (before, now)]
        frames, ok = sum(_frames(row) for rows in pair[1] for row in rows), [_ok(claim, tracks) for tracks in pair]
        where = ", ".join(f"{field} {value}" for field, value in zip(claim.by, group, strict=True))
        for name, larger_is_better in better.items():
            found = gate(pair[0], pair[1], claim.columns[name], larger_is_better)
            yield Row(
                {"scenes": where, "tracks": len(pair[1]), "frames": frames, "column": name},
                before=found.before, now=found.now, low=found.low, high=found.high, verdict=found.verdict,
                ok_before=ok[0], ok_now=ok[1],
            )  # fmt: skip


def _frames(row: Row) -> int:
    return int(row.get("frames", 1))


def _ok(claim: Claim, tracks: Measured) -> float | None:
    """Return the frames that are ok, in percent, by the columns of the claim; None if none of them says so."""
    columns, rows = claim.columns, [row for track in tracks for row in track]
    if "ok [%]" in columns:
        return float(columns["ok [%]"](rows))
    if "refused [%]" in columns:
        return 100 - float(columns["refused [%]"](rows))
    return 100 - 100 * float(columns["refused"](rows)) / sum(map(_frames, rows)) if "refused" in columns else None


def _groups(claim: Claim, rows: Sequence[Row]) -> list[tuple[Any, ...]]:
    return [tuple(row[name] for name in claim.by) for row in rows]


def _of(claim: Claim, rows: Sequence[Row], group: tuple[Any, ...]) -> list[Row]:
    return [row for row, key in zip(rows, _groups(claim, rows), strict=True) if key == group]


def measured(claim: Claim, effort: Effort) -> Measured:
    """Return the rows of each scene of a claim."""
    scenes = (claim.measure(scene) for scene in claim.scenes(effort))
    return [[found] if isinstance(found, Row) else list(found) for found in scenes]


def python_of(tree: Path) -> Path:
    """Return the Python of a work tree.

    Raises:
        ValueError: It has none.
    """
    python = tree.resolve() / ".venv" / "bin" / "python"
    if not python.exists():
        raise ValueError(f"{tree}: expected a work tree with an environment of its own, .venv; run `uv sync` in it.")
    return python


def compare(pythons: Sequence[Path], claim: Claim, effort: Effort) -> list[Row]:
    """Return the rows of a claim, measured with the libraries of two Pythons: the other one and this one.

    Raises:
        ValueError: The libraries were measured on different scenes.
        RuntimeError: A library could not be measured.
    """
    one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    with tempfile.TemporaryDirectory() as folder:
        scratch = Path(folder)
        (scratch / "tests").symlink_to(_TESTS, target_is_directory=True)  # the library is that of the Python
        files = [scratch / "before.pickle", scratch / "now.pickle"]
        running: list[subprocess.Popen[bytes]] = []
        try:
            for python, file in zip(pythons, files, strict=True):
                what = str(file), claim.name, str(effort.share), str(effort.seed)
                command = [str(python), "-m", "tests.benchmarks.gates", *what]
                running.append(subprocess.Popen(command, cwd=scratch, env={**os.environ, **one}))
            codes = [process.wait() for process in running]
        finally:
            for process in running:  # those that an interruption has left
                process.kill()
        if any(codes):
            raise RuntimeError("a library could not be measured; its error stands above.")
        before, now = (pickle.loads(file.read_bytes()) for file in files)
    return list(gates_of(claim, before, now))


def main(argv: Sequence[str]) -> int:
    """Compare two libraries and print the table of each claim.

    Returns:
        3 if a claim could not be compared; 2 for wrong arguments; 1 if a row is worse; otherwise 0.
    """
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks gates", description="Compare the library with that of another work tree."
    )
    parser.add_argument("other", type=Path, help="the other work tree, with its own .venv")
    parser.add_argument("names", nargs="*", metavar="NAME", help="claims or groups of claims")
    parser.add_argument("--share", type=float, default=1.0, help="share of the full number of scenes (default: 1)")
    parser.add_argument("--seed", type=int, help="random seed (default: from the commit's hash)")
    args = parser.parse_args(argv)
    effort = Effort(args.share, commit_seed() if args.seed is None else args.seed)
    try:
        pythons = [python_of(tree) for tree in (args.other, _TESTS.parent)]
        claims = [each for each in select(all_claims(), args.names) if each.by and each.columns and not each.alone]
    except ValueError as error:
        parser.error(str(error))
    verdicts, failed = set[str](), list[str]()
    for claim in claims:
        print(f"## {claim.name}\n", flush=True)
        begin = time.perf_counter()
        try:
            rows = compare(pythons, claim, effort)
        except (ValueError, RuntimeError) as error:
            failed.append(claim.name)
            print(f"{claim.name}: {error}\n", flush=True)
            continue
        verdicts |= {row.verdict for row in rows}
        seconds = time.perf_counter() - begin
        print(as_markdown(rows) if rows else "No scene was measured.")
        print(f"\nShare {effort.share:g}, seed {effort.seed}, {seconds:.0f} s.\n", flush=True)
    if failed:
        print(f"not compared: {', '.join(failed)}")
    return 3 if failed else int("worse" in verdicts)


def _write_rows(file: str, name: str, share: str, seed: str) -> None:
    """Measure a claim with the library of this Python; other claims may need what that library does not have."""
    claim = all_claims([name.partition(".")[0]])[name]
    Path(file).write_bytes(pickle.dumps(measured(claim, Effort(float(share), int(seed)))))


if __name__ == "__main__":
    _write_rows(*sys.argv[1:])
