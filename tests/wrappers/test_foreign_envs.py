"""Gymnasium's Swimmer, wrapped as the example with depth does it, against the simulator's truth."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import gymnasium_gl
import pytest

TRUTH = Path(__file__).parents[1] / "support" / "foreign_truth.py"
PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "wrap-gymnasium-envs.md"


@pytest.mark.nightly
def test_the_page_has_the_measured_figures_and_no_point_is_far_from_the_simulators(tmp_path):
    if gymnasium_gl.missing():
        pytest.skip(gymnasium_gl.missing())
    command, env = [sys.executable, TRUTH], gymnasium_gl.environment()
    done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=200, check=False)
    assert done.returncode == 0, done.stderr
    measured = json.loads(done.stdout.splitlines()[-1])
    assert measured["ok"]
    assert measured["worst_metres"] < 0.08, "the swimmer is 3.2 m long"
    row = re.search(r"foreign_env_depth\.py` \| (.*) px \| (.*) mm", PAGE.read_text(encoding="utf-8"))
    assert row is not None
    assert measured["pixels"] == pytest.approx(float(row[1]), abs=0.15)
    assert 1e3 * measured["metres"] == pytest.approx(float(row[2]), rel=0.25)
