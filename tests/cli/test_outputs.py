"""No command writes over an input, and an existing file is replaced only with ``--overwrite`` or if it is its own."""

from __future__ import annotations

import os
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from shape_obs import save_config
from shape_obs.cli import outputs
from shape_obs.cli.parsing import options_of
from tests.cli.test_usage import COMMAND_LINES

HSV = {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]}
# Every file that a command writes, with a command line that would write it: FILE stands for the name.
FILES = {
    "demo": ["demo.png: --out .", "demo.gif: --out .", "demo.rrd: --out . --rerun", "r.rrd: --rerun FILE"],
    "detect": ["p.png: photos/p.png --config c.yaml --out .", "s.yaml: p.png --pick 9,9 --save-config FILE",
               "shape.yaml: p.png --pick 9,9"],
    "tune": ["s.yaml: p.png --save FILE", "shape.yaml: p.png"],
    "record": ["r.rrd: --source photos -o new --rerun FILE", "new.rrd: --source photos -o new --rerun"],
    "replay": [*(f"a{suffix}: photos --config c.yaml --{suffix[1:]} FILE" for suffix in (".csv", ".npz", ".parquet")),
               "a.csv.meta.json: photos --config c.yaml --csv a.csv", "a.gif: photos --config c.yaml --video FILE",
               "r.rrd: photos --config c.yaml --rerun FILE", "a.rrd: photos --config c.yaml --npz a.npz --rerun"],
    "view": ["r.rrd: photos -o FILE", "photos.rrd: photos"],
    "fit-features": ["a.npz: photos --config c.yaml -o FILE"],
    "goal": ["g.yaml: --config c.yaml -o FILE", "g.png: --config c.yaml -o g.yaml"],
    "ablate": [f"{name}: c.yaml -o ." for name in ("results.csv", "table.md", "curves.png")],
    "deploy": ["r.rrd: --robot a:B --rerun FILE", "run.rrd: --robot a:B --log run --rerun"],
    "markers": ["m.png: -o FILE", "markers.pdf:"],
    "calibrate base": ["e.json: --source photos -o FILE", "e_touches.csv: --source photos -o e.json"],
    "calibrate intrinsics": ["i.json: --source photos -o FILE"],
    "bench table": ["table.md: --out .", "table.csv: --out ."],
}  # fmt: skip
# What is no file of one command: folders that must be new, or hold an extraction of the same config.
FOLDERS = {("record", "out"), ("deploy", "log"), ("deploy", "record"), ("extract", "out"), ("extract", "to")}


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Return a folder with a photo p.png, also in photos, and a config c.yaml, in which commands run."""
    rgb = np.full((72, 96, 3), 190, np.uint8)
    cv2.line(rgb, (10, 30), (80, 40), (200, 60, 30), 6)
    (tmp_path / "photos").mkdir()
    for name in ("p.png", "photos/p.png"):
        cv2.imwrite(str(tmp_path / name), rgb)
    save_config(tmp_path / "c.yaml", {"segmentation": HSV, "shapes": [{"kind": "centerline", "n": 8}]})
    monkeypatch.chdir(tmp_path)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path


def content() -> dict[str, Any]:
    """Return all files below the working folder."""
    return {str(path): path.read_bytes() for path in Path().rglob("*") if path.is_file()}


def test_every_option_that_names_an_output_is_tried_here():
    for command in COMMAND_LINES:
        arguments: Any = import_module(f"shape_obs.cli.{command.replace(' ', '.').replace('-', '_')}").Arguments
        hints = {name: option for name, option in options_of(arguments).items() if option.group == "output"}
        tried = " ".join(FILES.get(command, []))
        for name, option in hints.items():
            kind = str(arguments.__dataclass_fields__[name].type)
            if ("Path" in kind or "str" in kind) and (command, name) not in FOLDERS:
                assert f"--{name.replace('_', '-')}" in tried or f"{option.short or None} " in tried, (command, name)
        assert ("overwrite" in hints) == (command != "bench speed"), command


@pytest.mark.parametrize(("command", "case"), [(name, case) for name, cases in FILES.items() for case in cases])
def test_an_existing_file_is_kept_without_overwrite(place, run, command, case):
    name, _, arguments = case.partition(":")
    before = dict(content(), **({} if (Path(name)).exists() else {name: b"mine"}))
    Path(name).write_bytes(before[name])
    code, out, err = run(*command.split(), *arguments.replace("FILE", name).split())
    assert (code, out, content()) == (1, "", before)
    assert err.count("\n") == 1
    assert f"{name} exists" in err
    assert "--overwrite" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("detect p.png --config c.yaml --out .", "over the input p.png"),
        ("detect p.png --config c.yaml --out new/..", "over the input p.png"),
        ("detect photos/p.png --config c.yaml --out link", "over the input photos/p.png"),
        ("detect hard.png --config c.yaml --out same", "over the input hard.png"),
        ("detect p.png --depth d.png --intrinsics 1 1 1 1 --pick 9,9 --save-config d.png", "over the input d.png"),
        ("detect p.png photos/p.png --config c.yaml", "overlays/p.png would be written twice"),
        ("detect p.png P.png --config c.yaml", "overlays/P.png would be written twice"),
        ("replay photos/../v.avi --config c.yaml --video v.avi", "over the input photos/../v.avi"),
        ("replay v.avi --config c.yaml --video new/../v.avi", "over the input v.avi"),
        ("replay photos --config c.yaml --video photos/v.avi", "in the folder photos, which is read"),
        ("replay . --config c.yaml --npz t.npz", "in the folder ., which is read"),
        ("fit-features t.npz -o t.npz", "over the input t.npz"),
        ("goal --config c.yaml -o g.png", "g.png would be written twice"),
        ("goal --config c.yaml -o c.yaml", "over the input c.yaml"),
        ("tune p.png --save p.png", "over the input p.png"),
        ("calibrate base --source photos --touches t.csv -o t.csv", "over the input t.csv"),
    ],
)
def test_nothing_is_written_over_an_input_or_twice(place, run, monkeypatch, arguments, message):
    monkeypatch.setattr(sys, "platform", "darwin")  # whose names P.png and p.png are one file
    Path("link").symlink_to("photos")
    for name in ("d.png", "v.avi", "photos/v.avi", "t.npz", "t.csv"):
        Path(name).write_bytes(b"mine")
    Path("same").mkdir()
    os.link("p.png", "same/hard.png")
    os.link("p.png", "hard.png")
    before = content()
    code, out, err = run(*arguments.split(), "--overwrite")
    assert (code, out, content()) == (2, "", before)
    assert message in err


def test_pictures_are_replaced_as_long_as_nobody_changes_them(place, run):
    for _ in range(2):
        assert run("detect", "p.png", "--config", "c.yaml")[0] == 0
    picture = Path("overlays/p.png")
    ours = picture.read_bytes()
    picture.write_bytes(b"mine")
    assert run("detect", "p.png", "--config", "c.yaml")[0] == 1
    assert picture.read_bytes() == b"mine"
    assert run("detect", "p.png", "--config", "c.yaml", "--overwrite")[0] == 0
    assert picture.read_bytes() == ours
    assert run("detect", picture, "--config", "c.yaml")[0] == 2, "it is an input"
    (place / "overlays" / outputs.MANIFEST).write_bytes(b"\xff damaged")
    assert run("detect", "p.png", "--config", "c.yaml")[0] == 1
    picture.unlink()
    picture.mkdir()
    code, _, err = run("detect", "p.png", "--config", "c.yaml", "--overwrite")
    assert (code, "there is a folder" in err) == (1, True)
