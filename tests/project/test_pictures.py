"""The scripts of the pictures can be imported; the page on failures has their results."""

from __future__ import annotations

import ast
import re
import runpy
from importlib import import_module
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.parametrize("script", sorted((DOCS / "pictures").glob("*.py")), ids=lambda script: script.name)
def test_a_script_finds_what_it_imports(script):
    for statement in ast.walk(ast.parse(script.read_text(encoding="utf-8"))):
        if isinstance(statement, ast.ImportFrom) and str(statement.module).startswith("shape_obs"):
            module = import_module(str(statement.module))
            for alias in statement.names:
                assert hasattr(module, alias.name), f"{statement.module} has no {alias.name}"


@pytest.fixture(scope="module")
def cases():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(DOCS / "pictures"))
        from failures import CASES  # pyright: ignore[reportMissingImports]

    return {name: make() for name, make in CASES.items()}


@pytest.fixture(scope="module")
def page():
    return (DOCS / "concepts" / "what-can-go-wrong.md").read_text(encoding="utf-8")


def unnumbered(text: str) -> str:
    """Hide the digits: the last ones differ between versions of NumPy and OpenCV."""
    return re.sub(r"\d+(\.\d+)?", "#", text)


def test_every_case_has_its_picture_on_the_page(cases, page):
    for name in cases:
        assert f"images/wrong_{name}.jpg" in page
        assert (DOCS / "images" / f"wrong_{name}.jpg").exists()


def test_reasons_and_qualities_on_the_page_are_those_that_come_out(cases, page):
    for name, case in cases.items():
        (row,) = [line for line in page.splitlines() if f"wrong_{name}.jpg" in line]
        if case.shape.reason:
            assert f'"{unnumbered(case.shape.reason)}"' in unnumbered(row)
        else:
            (quality,) = re.findall(r"0\.\d\d", row)
            assert case.shape.quality == pytest.approx(float(quality), abs=0.02)


def test_what_is_called_a_silent_failure_is_one(cases, page):
    silent = page.split("## Silent failures")[1]
    for name, case in cases.items():
        flagged = bool(case.shape.reason) or not case.shape.valid.all()
        assert flagged, name
        assert f"wrong_{name}.jpg" not in silent


def test_the_goals_lost_are_read_from_the_page_on_training():
    from shape_obs.ablation import load_study

    study = load_study(DOCS.parent / "examples" / "ablations" / "cable.yaml")
    read = runpy.run_path(str(DOCS / "pictures" / "ablation.py"))["read_page"]()
    assert read.keys() <= study.arms.keys()
    for arm in read.values():
        assert arm.lost.keys() == study.evaluation.disturbances.keys()
        assert all(value.low <= value.value <= value.high for value in arm.lost.values())
