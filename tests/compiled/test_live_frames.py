"""A detector's constructor prepares the compiled functions that it calls, so that no live frame compiles any."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / "support" / "live_frames.py"


@pytest.mark.nightly
@pytest.mark.timeout(1800)
def test_detectors_call_only_functions_that_their_constructors_have_prepared(tmp_path):
    """The cache is empty at first: everything is compiled from scratch, once for the three configurations."""
    for kind in ("centerline", "contour", "surface"):
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
        done = subprocess.run([sys.executable, SCRIPT, kind], env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        found = json.loads(done.stdout)
        assert found["late"] == []
        assert found["called"] == found["listed"]
        assert found["ok"] > 50
        assert "shape_obs: compiling" in done.stderr
