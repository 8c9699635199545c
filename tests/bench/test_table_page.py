"""The bars of the paper's Table I are drawn again from the tables of the page, as they are written."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest

from tests.benchmarks.table.frames import CONFIGURATIONS
from tests.benchmarks.table.methods import METHODS
from tests.benchmarks.table.report import markdown
from tests.benchmarks.table.run import Plan
from tests.benchmarks.tables import Row

SCRIPT = Path(__file__).parents[2] / "docs" / "pictures" / "table.py"
REST = {"cv": 0.1, "ordered": 1, "own_order": 1, "settled": 1, "pixels": 9, "refused": 0}


def bars(i: int) -> dict[str, float]:
    """Return measures that the page's digits keep; one episode has no interval."""
    halves = {"sc_half_interval": np.nan if i == 0 else 0.002, "ch_half_interval": 12 + i, "ms_half_interval": 0.2}
    return halves | {"sc": 0.436 + i / 1000, "ch": 40_000 + i, "ms": 5.6 + i}


@pytest.fixture
def read_page():
    return runpy.run_path(str(SCRIPT))["read_page"]


def test_what_is_written_is_read_back(read_page, tmp_path):
    page = tmp_path / "page.md"
    read_page.__globals__["PAGES"] = {"details": page}
    names = [(name, method) for name in CONFIGURATIONS for method in METHODS]
    written = [Row(REST | bars(i), configuration=name, method=method) for i, (name, method) in enumerate(names)]
    page.write_text(markdown(Plan(60), {}, written, [], []), encoding="utf-8")
    read = read_page()
    assert [(row.pop("configuration"), row.pop("method")) for row in read] == names
    for i, row in enumerate(read):
        assert row == pytest.approx(bars(i), nan_ok=True)
    page.write_text(page.read_text(encoding="utf-8").replace("## Surface", "### Surface"), encoding="utf-8")
    with pytest.raises(ValueError, match=r"page\.md: expected the heading '## Surface, \.\.\.'"):
        read_page()


def test_the_page_of_the_docs_is_read(read_page):
    assert [(row.configuration, row.method) for row in read_page()] == [
        (name, method) for name in CONFIGURATIONS for method in METHODS
    ]
