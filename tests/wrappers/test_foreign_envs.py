"""Gymnasium's own MuJoCo envs, wrapped as the examples do it, against the simulator's truth."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import gymnasium_gl
import pytest

pytestmark = pytest.mark.nightly

TRUTH = Path(__file__).parents[1] / "support" / "foreign_truth.py"
PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "wrap-gymnasium-envs.md"


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    if gymnasium_gl.missing():
        pytest.skip(gymnasium_gl.missing())
    done = subprocess.run(
        [sys.executable, TRUTH],
        cwd=tmp_path_factory.mktemp("foreign"),
        env=gymnasium_gl.environment(),
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_the_page_has_the_measured_figures_and_no_point_is_far_from_the_simulators(measured):
    rows = re.findall(r"^\| (?:Swimmer|Reacher).*\|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    # The swimmer is 3.2 m long, the reacher 0.2 m.
    cases = ("rgb", "worst_pixels", 2.5), ("rgbd", "worst_metres", 0.08), ("reacher", "worst_metres", 0.008)
    for row, (case, worst, most) in zip(rows, cases, strict=True):
        _, pixels, metres, _ = (cell.strip() for cell in row.strip("|").split("|"))
        assert measured[case]["ok"]
        assert measured[case][worst] < most
        assert measured[case]["pixels"] == pytest.approx(float(pixels.removesuffix(" px")), abs=0.15)
        if metres:
            assert 1e3 * measured[case]["metres"] == pytest.approx(float(metres.removesuffix(" mm")), rel=0.25)
