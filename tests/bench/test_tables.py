"""Rows of results and the printer that all measurements share."""

from __future__ import annotations

import csv
import io
import json
import math
import pickle

import pytest

from tests.benchmarks import run_tasks
from tests.benchmarks.tables import (
    Row,
    as_csv,
    as_markdown,
    as_text,
    at_least,
    at_most,
    failures,
    grouped,
    mean,
    median,
    of,
    summary,
    worst,
)

ROWS = [{"name": "a", "ms": 1.25, "n": 3, "ok": True}, {"name": "longer", "ms": None, "n": 12345, "ok": False}]


@pytest.mark.parametrize(
    ("row", "asked", "reached"),
    [
        (at_least("it", 3, 3.0), ">= 3x", "yes"),
        (at_least("it", 3, 2.9), ">= 3x", "no"),
        (at_most("it", 0.5, 0.5, " mm"), "<= 0.5 mm", "yes"),
        (at_most("it", 0, 1, ""), "<= 0", "no"),
        (at_least("it", 3, None), ">= 3x", "not measured"),
        (at_most("it", 3, math.nan), "<= 3x", "no"),
    ],
)
def test_a_target_is_compared_with_the_result(row, asked, reached):
    assert (row["asked"], row["reached"]) == (asked, reached)


def test_text_has_aligned_columns():
    assert as_text(ROWS).splitlines() == [
        "  name     ms      n     ok",
        "     a  1.250      3   True",
        "longer      -  12345  False",
    ]


def test_markdown_aligns_numbers_to_the_right():
    lines = as_markdown([{"law": "rls", "mm": 3.14159}, {"law": "mfac", "mm": 123.4}]).splitlines()
    assert lines == ["| law | mm |", "| --- | ---: |", "| rls | 3.14 |", "| mfac | 123 |"]


def test_csv_can_be_read_again():
    rows = list(csv.DictReader(io.StringIO(as_csv([{"a": True, "b": None, "c": "x, y", "d": 0.1}]))))
    assert rows == [{"a": "1", "b": "", "c": "x, y", "d": "0.1"}]


def test_the_fields_of_a_row_are_attributes():
    row = pickle.loads(pickle.dumps(Row(name="a", error=0.5)))
    assert (row.name, row["error"]) == ("a", 0.5)
    assert json.dumps(row) == '{"name": "a", "error": 0.5}'
    with pytest.raises(AttributeError, match="mm"):
        _ = row.mm


def test_a_summary_has_a_row_for_each_group():
    rows = [Row(kind=kind, mm=mm, ok=mm < 3, score=complex(mm)) for kind, mm in (("a", 1), ("b", 2), ("a", 5))]
    columns = {
        "n": len,
        "not_ok": failures("ok"),
        "worst": of(worst, "mm"),
        "small": of(worst, "mm", lambda row: row.ok),
        "sum": of(sum, "score.real"),
    }
    assert summary(rows, ("kind",), columns) == [
        {"kind": "a", "n": 2, "not_ok": 1, "worst": 5, "small": 1, "sum": 6},
        {"kind": "b", "n": 1, "not_ok": 0, "worst": 2, "small": 2, "sum": 2},
    ]


def test_groups_and_summaries():
    assert grouped([3, 1, 4, 1, 5], lambda value: value % 2) == {1: [3, 1, 1, 5], 0: [4]}
    assert mean(iter([1, 2, 6])) == 3
    assert (worst([1.0, 4.0]), worst([])) == (4, 0)
    assert (median([1.0, None, 3.0, math.nan]), median([None])) == (2, None)


@pytest.mark.parametrize("jobs", [1, 2])
def test_tasks_give_the_same_results_in_one_process_and_in_two(jobs):
    assert sorted(run_tasks(divmod, [(7, 2), (9, 4)], jobs)) == [(2, 1), (3, 1)]
