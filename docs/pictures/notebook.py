"""The notebook of the first tutorial: uv run python docs/pictures/notebook.py."""

from __future__ import annotations

import re
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient

DOCS = Path(__file__).parents[1]
PAGE = DOCS / "tutorials" / "first-vector.md"
NOTEBOOK = DOCS.parent / "examples" / "first_vector.ipynb"
LINK = re.compile(r"\[([^\]]*)\]\(([^)]+)\)")
LEFT_OUT = re.compile(
    r"^```text\n.*?^```\n\n?|^:::\{figure\}.*?^:::\n\n?|^- The same steps as .*?\n", re.DOTALL | re.MULTILINE
)


def convert(page: Path) -> nbformat.NotebookNode:
    """Return a page as a notebook: its text, its Python blocks as cells, without the printed outputs and pictures."""
    text = LEFT_OUT.sub("", page.read_text(encoding="utf-8"))
    text = LINK.sub(lambda link: link[1] or title(page.parent / link[2]), text)
    notebook = jupytext.reads(text, fmt="md")
    notebook.metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    for number, cell in enumerate(notebook.cells):
        cell.id, cell.metadata = f"cell-{number}", {}
    return notebook


def title(page: Path) -> str:
    """Return the heading of a page."""
    return page.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")


def main() -> None:
    notebook = convert(PAGE)
    NotebookClient(notebook, timeout=120, record_timing=False).execute()
    notebook.metadata["language_info"] = {"name": "python"}  # without the version that ran it
    nbformat.write(notebook, NOTEBOOK)
    print(NOTEBOOK.relative_to(DOCS.parent), f"{NOTEBOOK.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
