"""The notebook of the first tutorial has the code of the page, and runs from top to bottom."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "tutorials" / "first-vector.md"
NOTEBOOK = ROOT / "examples" / "first_vector.ipynb"
AGAIN = "run `uv run python docs/pictures/notebook.py`"


@pytest.fixture(scope="module")
def cells():
    return [cell for cell in json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code"]


def test_its_cells_are_the_blocks_of_the_page(cells):
    blocks = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert ["".join(cell["source"]) for cell in cells] == [block.strip("\n") for block in blocks], AGAIN


def test_the_page_prints_what_the_notebook_prints(cells):
    printed = re.findall(r"^```text\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    stored = ["".join(output["text"]) for cell in cells for output in cell["outputs"] if "text" in output]
    assert stored == printed, AGAIN


def test_it_is_stored_with_its_outputs(cells):
    assert all(cell["outputs"] for cell in cells)
    assert "image/png" in cells[-1]["outputs"][-1]["data"]
    assert NOTEBOOK.stat().st_size < 300_000


def test_it_has_no_trace_of_the_machine_that_ran_it(cells):
    text = json.dumps([output.get("text", "") for cell in cells for output in cell["outputs"]])
    assert not re.search(r"/(home|root|tmp|work|Users)/", text)
    assert set(json.loads(NOTEBOOK.read_text(encoding="utf-8"))["metadata"]) == {"kernelspec", "language_info"}


def test_it_runs(tmp_path):
    pytest.importorskip("mujoco")
    pytest.importorskip("ipykernel")
    nbclient = pytest.importorskip("nbclient")
    nbformat = pytest.importorskip("nbformat")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbclient.NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(tmp_path)}}).execute()
    *_, last = (cell for cell in notebook.cells if cell.cell_type == "code")
    assert "image/png" in last.outputs[-1].data
