"""A detector's constructor prepares the compiled functions that it calls, so that no live frame compiles any."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / "support" / "live_frames.py"


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """Return a cache folder, empty at first: the three configurations share some functions."""
    return tmp_path_factory.mktemp("cache")


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("kind", ["centerline", "contour", "surface"])
def test_a_detector_calls_only_functions_that_its_constructor_has_prepared(kind, cache):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    done = subprocess.run([sys.executable, SCRIPT, kind], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["late"] == []
    assert found["called"] == found["listed"]
    assert found["ok"] > 50
    assert "shape_obs: compiling" in done.stderr
