"""The notebook of the first tutorial has the code and the output of the page, and runs from top to bottom."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "tutorials" / "first-vector.md"
NOTEBOOK = ROOT / "examples" / "first_vector.ipynb"


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def test_the_notebook_equals_the_page():
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    again = "run `uv run python docs/pictures/notebook.py`"
    assert ["".join(cell["source"]) for cell in cells] == [block.strip("\n") for block in blocks("python")], again
    printed = ["".join(output["text"]) for cell in cells for output in cell["outputs"] if "text" in output]
    assert printed == blocks("text"), again
    assert "image/png" in cells[-1]["outputs"][-1]["data"]
    assert not re.search(r"/(home|root|tmp|work|Users)/", "".join(printed)), "a trace of the machine that ran it"
    assert set(notebook["metadata"]) == {"kernelspec", "language_info"}
    assert NOTEBOOK.stat().st_size < 300_000


@pytest.mark.nightly
def test_the_notebook_runs(tmp_path):
    pytest.importorskip("mujoco")
    pytest.importorskip("ipykernel")
    nbclient = pytest.importorskip("nbclient")
    nbformat = pytest.importorskip("nbformat")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbclient.NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(tmp_path)}}).execute()
    *_, last = (cell for cell in notebook.cells if cell.cell_type == "code")
    assert "image/png" in last.outputs[-1].data
