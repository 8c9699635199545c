"""Training with envs in separate processes never hangs, for all ways to start them and after other work."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.nightly
@pytest.mark.parametrize("method", ["fork", "forkserver", "spawn"])
def test_subproc_and_async_train(method):
    pytest.importorskip("mujoco")
    pytest.importorskip("stable_baselines3")
    if method not in multiprocessing.get_all_start_methods():
        pytest.skip(f"there is no {method} here")
    # As users run it: libraries may start as many threads as they like.
    free = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run(
        [sys.executable, Path(__file__).parents[1] / "support" / "vector_training.py", method],
        capture_output=True, text=True, timeout=280, env=free, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["trained", "100", "100"]
