"""Check the tests by breaking the code: each mutant is one small fault that at least one test must notice.

    uv run python tests/support/mutants.py                 # all of them, a few minutes
    uv run python tests/support/mutants.py --only lift     # those whose name contains the word
    uv run python tests/support/mutants.py --list

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
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))

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
    with tempfile.TemporaryDirectory(prefix="mutants") as folder:
        copy = Path(folder)
        for name in COPIED:
            # Times are kept, so that what Numba has compiled stays valid.
            if (ROOT / name).is_dir():
                shutil.copytree(ROOT / name, copy / name)
            else:
                shutil.copy2(ROOT / name, copy / name)
        files = sorted({test for mutant in mutants for test in mutant.tests})
        if _tests(copy, files) != 0:
            print(f"the tests fail without any mutant: {' '.join(files)}")
            return 2
        survivors = 0
        for mutant in mutants:
            begin, (verdict, noticed) = time.monotonic(), _run_one(copy, mutant)
            print(f"{verdict:10} {time.monotonic() - begin:5.1f} s  {mutant.name}", flush=True)
            if verdict == "survived" and mutant.equivalent:
                print(f"{'':19}explained: {mutant.equivalent}")
            survivors += not noticed
    print(f"{len(mutants)} mutants, {survivors} unexplained")
    return int(survivors > 0)


def _run_one(copy: Path, mutant: Mutant) -> tuple[str, bool]:
    """Return what became of a mutant, and whether that is as it should be."""
    original, target = ROOT / mutant.file, copy / mutant.file
    target.write_text(mutated(original.read_text(encoding="utf-8"), mutant), encoding="utf-8")
    code = _tests(copy, mutant.tests)
    shutil.copy2(original, target)
    if code == 0:
        return "survived", bool(mutant.equivalent)
    if code is None:
        return "hangs", True
    if code == 1 or code < 0:  # a test failed, or the interpreter crashed
        return "killed", True
    return f"error {code}", False  # it does not even load: no test has noticed anything


def _tests(copy: Path, files: Sequence[str]) -> int | None:
    """Return the exit code of the tests of a copy; None if they hang."""
    paths = os.pathsep.join([str(copy), str(copy / "envs")])
    environment = {**os.environ, "PYTHONPATH": paths, "PYTHONDONTWRITEBYTECODE": "1", "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider"]
    try:
        return subprocess.run(
            [*command, *files], cwd=copy, env=environment, capture_output=True, timeout=TIMEOUT, check=False
        ).returncode
    except subprocess.TimeoutExpired:
        return None


def main() -> int:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", action="append", default=[], help="a part of the name; may be given several times")
    parser.add_argument("--list", action="store_true", help="print the names and stop")
    arguments = parser.parse_args()
    chosen = [mutant for mutant in MUTANTS if not arguments.only or any(part in mutant.name for part in arguments.only)]
    if not chosen:
        print(f"no mutant is named {arguments.only}; --list shows all.")
        return 2
    if arguments.list:
        for mutant in chosen:
            print(f"{mutant.name:60} {mutant.file}")
        return 0
    return run(chosen)


if __name__ == "__main__":
    sys.exit(main())
