"""Check the tests by breaking the code: each mutant is one small fault that at least one test must notice.

    uv run python tests/support/mutants.py                 # all of them, a few minutes
    uv run python tests/support/mutants.py --only lift     # those whose name contains the word
    uv run python tests/support/mutants.py --list
    uv run python tests/support/mutants.py --constants --only rope_match   # one constant takes 5 s to 5 min

With ``--constants`` the faults are the numeric constants of the tracking, multiplied and divided by ``--factor``. One
line for each reports the direction and the test that failed first; the exit code is 1 if one survives both directions
without an explanation.

Each fault is put into a copy of the package in a temporary folder, never into the working tree, and the test files
named with it run there. The exit code is 1 if a mutant survives without an explanation, 2 if nothing can be concluded.
The lists are in ``tests/support/mutation``; ``tests/project/test_mutants.py`` checks that every one still applies.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import product
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))

from constants import constant_mutants, named, stages  # noqa: E402
from mutation import MUTANTS, Mutant  # noqa: E402

COPIED = ("shape_obs", "envs", "tests", "pyproject.toml")
TIMEOUT = 300.0  # seconds; a mutant that hangs is noticed too


def mutated(text: str, mutant: Mutant) -> str:
    """Return a file's text with the fault in it.

    Raises:
        ValueError: The text to replace does not occur exactly once.
    """
    count = text.count(mutant.old)
    if count != 1:
        raise ValueError(
            f"mutant {mutant.name!r}: {mutant.old!r} occurs {count} times in {mutant.file}, expected once."
        )
    return text.replace(mutant.old, mutant.new)


def run(mutants: Sequence[Mutant]) -> int:
    """Run the tests against each mutant, print what became of it, and return the exit code."""
    with _copied([test for mutant in mutants for test in mutant.tests]) as copy:
        survivors = 0
        for mutant in mutants:
            begin, (verdict, noticed, _) = time.monotonic(), _run_one(copy, mutant)
            print(f"{verdict:10} {time.monotonic() - begin:5.1f} s  {mutant.name}", flush=True)
            if verdict == "survived" and mutant.equivalent:
                print(f"{'':19}explained: {mutant.equivalent}")
            survivors += not noticed
    print(f"{len(mutants)} mutants, {survivors} unexplained")
    return int(survivors > 0)


def run_constants(pairs: Sequence[tuple[Mutant, Mutant]]) -> int:
    """Run the tests against each constant until one fails in either direction; return the exit code."""
    with _copied([test for times, _ in pairs for test in times.tests]) as copy:
        survivors = 0
        for pair in pairs:
            begin, (tested, what) = time.monotonic(), _run_pair(copy, pair)
            print(f"{time.monotonic() - begin:6.1f} s  {pair[0].name[:-2]:36} {what}", flush=True)
            survivors += not tested
    print(f"{len(pairs)} constants, {survivors} survived in both directions without an explanation")
    return int(survivors > 0)


def _run_pair(copy: Path, pair: Sequence[Mutant]) -> tuple[bool, str]:
    """Return whether a constant is as it should be, and what became of each direction that was run."""
    results = {mutant.name[-1]: "not run" for mutant in pair}
    noticed = False
    for tests, mutant in product(stages(pair[0].tests), pair):
        verdict, _, failed = _run_one(copy, mutant._replace(tests=tests))
        results[mutant.name[-1]] = f"{verdict} {failed}".strip()
        noticed = verdict in ("killed", "hangs")
        if noticed:
            break
    what = "; ".join(f"{sign} {result}" for sign, result in results.items())
    explained = pair[0].equivalent
    return noticed or bool(explained), what if noticed or not explained else f"{what}; explained: {explained}"


@contextmanager
def _copied(tests: Iterable[str]) -> Iterator[Path]:
    """Give a copy of the package and its tests, in which these pass.

    Raises:
        SystemExit: They fail; the exit code is 2.
    """
    with tempfile.TemporaryDirectory(prefix="mutants") as folder:
        copy = Path(folder)
        for name in COPIED:
            # Times are kept, so that what Numba has compiled stays valid.
            if (ROOT / name).is_dir():
                shutil.copytree(ROOT / name, copy / name)
            else:
                shutil.copy2(ROOT / name, copy / name)
        files = sorted(set(tests))
        if _tests(copy, files)[0] != 0:
            print(f"the tests fail without any mutant: {' '.join(files)}")
            raise SystemExit(2)
        yield copy


def _run_one(copy: Path, mutant: Mutant) -> tuple[str, bool, str]:
    """Return what became of a mutant, whether that is as it should be, and the test that failed."""
    original, target = ROOT / mutant.file, copy / mutant.file
    target.write_text(mutated(original.read_text(encoding="utf-8"), mutant), encoding="utf-8")
    code, failed = _tests(copy, mutant.tests)
    shutil.copy2(original, target)
    if code == 0:
        return "survived", bool(mutant.equivalent), ""
    if code is None:
        return "hangs", True, ""
    if code == 1 or code < 0:  # a test failed, or the interpreter crashed
        return "killed", True, failed
    return f"error {code}", False, failed  # it does not even load: no test has noticed anything


def _tests(copy: Path, files: Sequence[str]) -> tuple[int | None, str]:
    """Return the exit code of the tests of a copy, None if they hang, and the first test that failed."""
    paths = os.pathsep.join([str(copy), str(copy / "envs")])
    environment = {**os.environ, "PYTHONPATH": paths, "PYTHONDONTWRITEBYTECODE": "1", "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider"]
    try:
        done = subprocess.run(
            [*command, *files],
            cwd=copy,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            encoding="utf-8",
            timeout=TIMEOUT,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return None, ""
    lines = [line.split() for line in done.stdout.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    return done.returncode, lines[0][1] if lines else ""


def main() -> int:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", action="append", default=[], help="a part of the name; may be given several times")
    parser.add_argument("--list", action="store_true", help="print the names and stop")
    parser.add_argument("--constants", action="store_true", help="the constants of the tracking instead of the list")
    parser.add_argument("--factor", type=float, default=10.0, help="by which constants are multiplied and divided")
    arguments = parser.parse_args()
    if arguments.constants:
        pairs = named(constant_mutants(arguments.factor), arguments.only)
        return run_constants(pairs) if pairs else _nothing(arguments.only)
    chosen = [mutant for mutant in MUTANTS if not arguments.only or any(part in mutant.name for part in arguments.only)]
    if not chosen:
        return _nothing(arguments.only)
    if arguments.list:
        for mutant in chosen:
            print(f"{mutant.name:60} {mutant.file}")
        return 0
    return run(chosen)


def _nothing(words: Sequence[str]) -> int:
    print(f"no mutant is named {words}; --list shows all.")
    return 2


if __name__ == "__main__":
    sys.exit(main())
