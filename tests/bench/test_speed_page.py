"""The page on speed is filled from results as they are written."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
MACHINE = {"processor": "a processor", "cores": "2", "system": "Linux", "python": "3.12.1"}
CLAIMS = [{"what": "a figure", "asked": ">= 2x", "seen": 1.5, "reached": "no"}]


def method(name, milliseconds, over, sc, ch):
    return {
        "method": name, "frames": 3, "median_ms": milliseconds, "over_ours": over, "sc": sc, "ch": ch,
        "spacing_cv": 0.02,
    }  # fmt: skip


WORK = {
    "points": 20, "samples": 8000, "frames": 3, "refused": 0,
    "rows": [
        method("shape_obs, warm", 1.0, 1.0, 0.45, 1000.0),
        method("a fast one", 0.5, 0.5, 0.44, 900.0),
        method("a slow one", 1234.5, 1234.5, 0.46, 1100.0),
    ],
}  # fmt: skip
RESULTS = {
    "peers": {
        "measurement": "peers", "machine": MACHINE, "frames": 3, "seed": 0, "clock": "wall", "burst": 10,
        "claims": CLAIMS,
        "works": {"rope": WORK, "contour": WORK, "cloth": WORK},
    },
    "latency": {
        "measurement": "latency", "machine": MACHINE, "frames": 3, "seed": 0, "clock": "wall", "burst": 10,
        "claims": CLAIMS,
        "totals": [
            {"image": "640 x 480", "method": name, "median_ms": 1.0, "p95_ms": 2.0, "passes": 40.0,
             "faster_than_classic": 4.0, "refused": 0}
            for name in ("one pass: sumElems", "shape_obs, warm")
        ],
        "stages": [{"image": "640 x 480", "method": "shape_obs, warm", "segmentation": 0.5, "total": 1.0}],
        "growth": [
            {"grows": grows, "amount": amount, "median_ms": 1.0, "times_smallest": 1.0}
            for grows in ("points", "shapes") for amount in (1, 10)
        ],
    },
}  # fmt: skip


@pytest.fixture(scope="module")
def speed():
    pytest.importorskip("matplotlib")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(DOCS / "pictures"))
        import speed  # pyright: ignore[reportMissingImports]

    return speed


@pytest.fixture(scope="module")
def pages(speed):
    return {name: page.read_text(encoding="utf-8") for name, page in speed.PAGES.items()}


@pytest.mark.parametrize("measurement", ["peers", "latency"])
def test_every_block_of_a_page_is_filled(speed, pages, measurement):
    page, blocks = pages[measurement], speed.blocks({measurement: RESULTS[measurement]})
    assert sorted(blocks) == sorted(name for name in re.findall(r"<!-- (.+?) -->", page) if name in blocks)
    for name, block in blocks.items():
        assert block in speed.filled(page, name, block)
    with pytest.raises(ValueError, match="expected one block <!-- nothing -->"):
        speed.filled(page, "nothing", "")


def test_it_says_where_it_loses(speed):
    blocks = speed.blocks(RESULTS)
    assert "- rope: a fast one takes 0.5 times as long as ours." in blocks["losses"]
    assert "a slow one has a Calinski-Harabasz score 10.0 % higher, has a silhouette 0.010 higher." in blocks["losses"]
    assert "| 640 x 480 | 1 (2) | – | 1 (2) | – |" in blocks["totals"]
    assert "| 640 x 480, warm | 0.5 | 1 |" in blocks["stages"]
    assert "| shapes | 1, 10 | 1, 1 | 1 |" in blocks["growth"]
    assert "| a figure | >= 2x | 1.5x | **no** |" in blocks["asked peers"]
    assert "| a slow one | 1 234 | 1 234 | 0.460 | 1 100 | 2.0 % |" in blocks["rope"]


def test_every_picture_of_the_pages_is_drawn_and_small(speed, pages, tmp_path):
    pictures = speed.pictures(RESULTS)
    assert sorted(re.findall(r"images/speed_(\w+)\.png", "".join(pages.values()))) == sorted(pictures)
    for name, draw in pictures.items():
        draw().savefig(tmp_path / "picture.png")
        assert (DOCS / "images" / f"speed_{name}.png").stat().st_size < 200_000
