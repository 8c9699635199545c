"""The scripts of the pictures can be imported; the page on failures has their results."""

from __future__ import annotations

import ast
import re
from importlib import import_module
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"


def test_the_scripts_find_what_they_import():
    for script in sorted((DOCS / "pictures").glob("*.py")):
        for statement in ast.walk(ast.parse(script.read_text(encoding="utf-8"))):
            if isinstance(statement, ast.ImportFrom) and str(statement.module).startswith(("shape_obs", "tests")):
                module = import_module(str(statement.module))
                for alias in statement.names:
                    assert hasattr(module, alias.name), f"{script.name}: {statement.module} has no {alias.name}"


def unnumbered(text: str) -> str:
    """Hide the digits: the last ones differ between versions of NumPy and OpenCV."""
    return re.sub(r"\d+(\.\d+)?", "#", text)


def test_the_page_on_failures_has_the_reasons_and_qualities_that_come_out(monkeypatch):
    monkeypatch.syspath_prepend(str(DOCS / "pictures"))
    from failures import CASES  # pyright: ignore[reportMissingImports]

    page = (DOCS / "concepts" / "what-can-go-wrong.md").read_text(encoding="utf-8")
    silent = page.split("## Silent failures")[1]
    for name, make in CASES.items():
        shape = make().shape
        (row,) = [line for line in page.splitlines() if f"images/wrong_{name}.jpg" in line]
        assert (DOCS / "images" / f"wrong_{name}.jpg").exists()
        assert shape.reason or not shape.valid.all(), name
        assert f"wrong_{name}.jpg" not in silent
        if shape.reason:
            assert f'"{unnumbered(shape.reason)}"' in unnumbered(row)
        else:
            (quality,) = re.findall(r"0\.\d\d", row)
            assert shape.quality == pytest.approx(float(quality), abs=0.02)
