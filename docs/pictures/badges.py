"""Draw the badges of the README from pyproject.toml: `uv run python docs/pictures/badges.py` (Python 3.11 or newer)."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Final
from xml.sax.saxutils import escape

import tomllib

DOCS: Final = Path(__file__).parents[1]
BADGES: Final = DOCS / "images" / "badges"
GREY, BLUE, GREEN, ORANGE = "#555", "#0a6aa8", "#2b7a3d", "#a85400"  # white text has a contrast of 4.5 on each
NARROW, WIDE = "fijlrt.,:-' I|()", "mwMW%@"
GPU: Final = {"torch", "tensorflow", "jax", "cupy", "onnxruntime-gpu"}


def facts(project: dict[str, Any]) -> dict[str, tuple[str, str, str]]:
    """Return label, value and colour of each badge, by the name of its file."""
    classifiers = project["classifiers"]
    (status,) = (line.split(" - ")[1].lower() for line in classifiers if line.startswith("Development Status"))
    minors = sorted(int(found[1]) for line in classifiers if (found := re.search(r"Python :: 3\.(\d+)$", line)))
    if project["requires-python"] != f">=3.{minors[0]}" or minors != list(range(minors[0], minors[-1] + 1)):
        raise ValueError(f"requires-python and the classifiers disagree: {project['requires-python']}, 3.{minors}")
    needed = {re.split(r"[\s\[<>=;!~]", line)[0] for line in project["dependencies"]}
    if needed & GPU:
        raise ValueError(f"the library does not run on a CPU alone: it needs {sorted(needed & GPU)}")
    return {
        "version": ("version", f"{project['version']} {status}", ORANGE if status == "alpha" else BLUE),
        "python": ("python", f"3.{minors[0]} – 3.{minors[-1]}", BLUE),
        "licence": ("licence", project["license"], GREEN),
        "device": ("runs on", "CPU", GREEN),
    }


def width(text: str) -> int:
    """Return about the width of a text in pixels, at 11 pixels of a sans-serif font."""
    sizes = (3.9 if char in NARROW else 9.8 if char in WIDE else 7.6 if char.isupper() else 6.7 for char in text)
    return round(sum(sizes))


def badge(label: str, value: str, colour: str) -> str:
    """Return a badge as SVG; the texts are stretched to the widths, so that any font fits."""
    pad, height = 6, 20
    left, right = width(label) + 2 * pad, width(value) + 2 * pad
    text = '<text x="{}" y="14" textLength="{}">{}</text>'
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{left + right}" height="{height}" role="img" '
        f'aria-label="{escape(label)}: {escape(value)}">\n'
        f"<title>{escape(label)}: {escape(value)}</title>\n"
        f'<clipPath id="r"><rect width="{left + right}" height="{height}" rx="3"/></clipPath>\n'
        f'<g clip-path="url(#r)"><rect width="{left}" height="{height}" fill="{GREY}"/>'
        f'<rect x="{left}" width="{right}" height="{height}" fill="{colour}"/></g>\n'
        f'<g fill="#fff" font-family="Verdana,DejaVu Sans,Geneva,sans-serif" font-size="11">\n'
        f"{text.format(pad, left - 2 * pad, escape(label))}\n"
        f"{text.format(left + pad, right - 2 * pad, escape(value))}\n</g>\n</svg>\n"
    )


def badges() -> dict[str, str]:
    """Return the SVG of each badge, by the name of its file."""
    project = tomllib.loads((DOCS.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return {name: badge(*fact) for name, fact in facts(project).items()}


if __name__ == "__main__":
    BADGES.mkdir(parents=True, exist_ok=True)
    for name, svg in badges().items():
        (BADGES / f"{name}.svg").write_text(svg, encoding="utf-8")
