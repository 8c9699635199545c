"""Finished parts of a measurement are kept, and parts of another run are refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.benchmarks.tables import Parts

ROWS = [{"n": np.int64(3), "ms": math.nan, "ok": np.bool_(True)}, {"n": 4, "ms": None, "ok": False}]


def test_rows_can_be_read_again(tmp_path):
    parts = Parts(tmp_path, {"seed": 0})
    assert parts.read("contour/som/0000") is None
    parts.write("contour/som/0000", ROWS)
    rows = Parts(tmp_path, {"seed": 0}).read("contour/som/0000")
    assert rows is not None
    first, second = rows
    assert (first.n, first.ok) == (3, True)
    assert math.isnan(first.ms)
    assert second == ROWS[1]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"seed": 1}, "seed = 0, this run has 1: choose another folder"),
        ({"seed": 0, "frames": 9}, "frames = None, this run has 9"),
        ({}, "seed = 0, this run has None"),
    ],
)
def test_parts_of_another_run_are_refused(tmp_path, settings, message):
    Parts(tmp_path, {"seed": 0}).write("it", ROWS)
    with pytest.raises(ValueError, match=message):
        Parts(tmp_path, settings).read("it")


@pytest.mark.parametrize("text", ["", "[]", '{"rows": []}', '{"made_with": {}, "rows": [3]}', '{"made_with": 3}'])
def test_a_damaged_part_is_named(tmp_path, text):
    parts = Parts(tmp_path, {})
    parts.write("it", ROWS)
    parts.path("it").write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=r"it\.json: "):
        parts.read("it")
