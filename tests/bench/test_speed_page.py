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
            {"image": "640 x 480", "method": name, "median_ms": time, "p95_ms": 2.0, "passes": 40.0,
             "faster_than_classic": 4.0, "refused": 0}
            for name, time in {"one pass: sumElems": 0.25, "shape_obs, warm": 1.0}.items()
        ],
        "stages": [{"image": "640 x 480", "method": "shape_obs, warm", "segmentation": 0.5, "total": 1.0}],
        "growth": [
            {"grows": grows, "amount": amount, "median_ms": 1.0 * amount, "times_smallest": 1.0 * amount}
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
    assert "| 640 x 480 | 0.25 (2) | – | 1 (2) | – |" in blocks["totals"]
    assert "| 640 x 480, warm | 0.5 | 1 |" in blocks["stages"]
    assert "| shapes | 1, 10 | 1, 10 | 10 |" in blocks["growth"]
    assert "| a figure | >= 2x | 1.5x | **no** |" in blocks["asked peers"]
    assert "| a slow one | 1 234 | 1 234 | 0.460 | 1 100 | 2.0 % |" in blocks["rope"]


def shown(read, written):
    """Keep what was read of a result; a page has three digits of each number."""
    if isinstance(read, dict):
        return {key: shown(value, written[key]) for key, value in read.items()}
    if isinstance(read, list):
        return [shown(*pair) for pair in zip(read, written, strict=True)]
    return pytest.approx(written, rel=5e-3) if isinstance(written, float) else written


def test_what_is_written_into_the_pages_is_read_back(speed, pages, tmp_path, monkeypatch):
    for name, page in pages.items():
        for block, text in speed.blocks({name: RESULTS[name]}).items():
            page = speed.filled(page, block, text)
        (tmp_path / f"{name}.md").write_text(page, encoding="utf-8")
        monkeypatch.setitem(speed.PAGES, name, tmp_path / f"{name}.md")
    read = speed.read_pages()
    assert read == shown(read, RESULTS)
    assert speed.pictures(read).keys() == speed.pictures(RESULTS).keys()


def test_a_table_that_is_not_found_is_reported(speed, pages, tmp_path, monkeypatch):
    broken = tmp_path / "speed.md"
    monkeypatch.setitem(speed.PAGES, "latency", broken)
    for old, new, message in [
        ("<!-- growth -->", "", "speed.md: expected a block <!-- growth -->"),
        ("| Numbers |", "| To |", "speed.md: expected a table .*'Numbers'.* <!-- growth -->, got 'What grows', 'To'"),
    ]:
        broken.write_text(pages["latency"].replace(old, new), encoding="utf-8")
        with pytest.raises(ValueError, match=message):
            speed.read_pages()


def test_every_picture_of_the_pages_is_drawn_and_small(speed, pages, tmp_path):
    pictures = speed.pictures(RESULTS)
    assert pictures.keys() == speed.pictures(speed.read_pages()).keys()
    assert sorted(re.findall(r"images/speed_(\w+)\.png", "".join(pages.values()))) == sorted(pictures)
    for name, draw in pictures.items():
        draw().savefig(tmp_path / "picture.png")
        assert (DOCS / "images" / f"speed_{name}.png").stat().st_size < 200_000
