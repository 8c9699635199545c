"""Read hostile and damaged bundles, and kill processes that save one."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from fuzzing.bundle_attacks import attacks
from fuzzing.bundle_bombs import bombs
from fuzzing.bundle_canary import VARIABLE, write_canary
from fuzzing.bundle_mutations import mutations
from fuzzing.bundle_sample import TRUSTED, members_of, save_sample
from fuzzing.bundle_sizes import sizes
from tests.benchmarks.tables import at_least, at_most

_SECONDS: Final = 2.0
_MEGABYTES: Final = 300.0
_MINUTES: Final = 60
#: (name, content) of a file.
Named = tuple[str, bytes]


def bundle_claims(mutated: int = 1000, every: int = 1, kills: int = 30, seed: int = 0) -> list[dict[str, Any]]:
    """Read damaged and crafted bundles, and kill processes that save one.

    Args:
        mutated: How many damaged files.
        every: Of the crafted files, each so many-th one.
        kills: How many processes are killed.
        seed: Of the damage and of the instants.

    Returns:
        Rows: what, asked, seen and whether it was reached.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sample = members_of(save_sample(folder))
        crafted = [*attacks(sample), *bombs(sample), *sizes(sample)][::every]
        damaged = [*mutations(sample, mutated, seed)]
        hostile = [*attacks(sample)][:: max(every // 2, 1)]
        seen, killed = read_all(folder, [*damaged, *crafted], hostile, kills, seed)
    trusted = seen[len(damaged) + len(crafted) :]
    rows = _rows(f"{mutated} mutated bundles", seen[: len(damaged)])
    rows += _rows(f"{len(crafted)} crafted bundles", seen[len(damaged) : len(damaged) + len(crafted)])
    ran = sum(one["code"] for one in trusted)
    rows.append(at_least("attacks that run code with trust=True, so that the canary works", len(trusted) // 6, ran, ""))
    what = f"{kills} kills while a bundle is saved"
    return [
        *rows,
        at_most(f"{what}: lost or half-written bundles", 0, killed["broken"], ""),
        at_most(f"{what}: bundles that do not load", 0, killed["unread"], ""),
        at_least(f"{what}: kills during the writing of the file", 1, killed["writing"], ""),
        at_most(f"{what}: temporary files left next to it, per kill", 1, killed["left"] / kills, ""),
    ]


def read_all(
    folder: Path, files: Sequence[Named], trusted: Sequence[Named] = (), kills: int = 0, seed: int = 0
) -> tuple[list[dict[str, Any]], dict[str, int]]:
    """Read files, each in a separate process, then kill processes that save a bundle.

    Args:
        folder: With ``sample.policy``.
        files: (name, content).
        trusted: Those that are loaded with ``trust=True``.
        kills: How many processes are killed.
        seed: Of the instants.

    Returns:
        What ``bundle_trials.attempt`` returns for each file, with its ``name``; and what ``kill_savers`` returns.
    """
    with tempfile.TemporaryDirectory(dir=folder) as name:
        work = Path(name)
        (work / "files").mkdir()
        (work / "path").mkdir()
        write_canary(work / "path")
        (work / "sample.policy").write_bytes((folder / "sample.policy").read_bytes())
        for number, (_, content) in enumerate([*files, *trusted]):
            kind = TRUSTED if number >= len(files) else ".policy"
            (work / "files" / f"{number:05}{kind}").write_bytes(content)
        module = "fuzzing.bundle_trials"
        path = os.pathsep.join(
            [str(work / "path"), str(Path(__file__).parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])]
        )
        threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        done = subprocess.run(
            [sys.executable, "-m", module, str(work), str(kills), str(seed)],
            env={**os.environ, **threads, "PYTHONPATH": path, VARIABLE: str(work / "canary")},
            cwd=work,
            capture_output=True,
            text=True,
            timeout=60 * _MINUTES,
            check=False,
        )
    if done.returncode:
        raise RuntimeError(f"reading bundles failed: {done.stderr[-2000:]}")
    seen = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    names = [name for name, _ in [*files, *trusted]]
    killed = seen.pop() if kills else {}
    return [{**one, "name": name} for one, name in zip(seen, names, strict=True)], killed


def _rows(what: str, seen: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [
        at_most(f"{what}: code run", 0, sum(one["code"] for one in seen), ""),
        at_most(f"{what}: undeclared exceptions", 0, sum(bool(one["undeclared"]) for one in seen), ""),
        at_most(f"{what}: the slowest", _SECONDS, max(one["seconds"] for one in seen), " s"),
        at_most(f"{what}: the largest", _MEGABYTES, max(one["mb"] for one in seen), " MB"),
        at_most(f"{what}: temporary files left", 0, sum(one["left"] for one in seen), ""),
    ]
