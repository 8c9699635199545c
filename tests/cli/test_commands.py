"""The command line as people and programs use it."""

import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from PIL import Image

from shape_obs.bench.scenes import draw_rope
from shape_obs.cli import main
from shape_obs.drawing import GOAL, VALID

BLUE = (30, 60, 200)
HSV = ["--hsv", "100", "100", "50", "130", "255", "255"]


@pytest.fixture
def photo(tmp_path):
    """Return a blue rope on gray, at millimetre depth 700 on a table at 720."""
    t = np.linspace(0, 1, 400)
    rope = draw_rope(np.stack([60 + 200 * t, 120 + 50 * np.sin(5 * t)], axis=1), 11.0, size=(240, 320))
    rgb = np.full((240, 320, 3), (190, 185, 180), np.uint8)
    rgb[rope.mask > 0] = BLUE
    depth = np.where(rope.mask > 0, 700, 720).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "rope.png"), rgb[..., ::-1])
    cv2.imwrite(str(tmp_path / "depth.png"), depth)
    return tmp_path


def run(capsys, *arguments):
    """Return (exit code, stdout, stderr) of a command run in this process."""
    with pytest.raises(SystemExit) as stop:
        main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return stop.value.code, captured.out, captured.err


def test_detect_prints_json_and_draws(photo, capsys):
    code, out, err = run(capsys, "detect", photo / "rope.png", *HSV, "--out", photo / "o", "--ends", "tips", "--n", 12)
    result = json.loads(out)
    shape = result["shapes"][0]
    assert code == 0
    assert err == (
        f"{photo / 'rope.png'}: centerline found, quality {shape['quality']:.2f}, 12 points; picture: "
        f"{photo / 'o' / 'rope.png'}\n"
    )
    assert result["ok"] is True
    assert len(shape["points2d"]) == 12
    assert np.allclose(shape["points2d"][0], (60, 120), atol=2)
    assert shape["points3d"] is None
    overlay = np.asarray(Image.open(result["overlay"]))
    assert overlay.shape == (240, 320, 3)
    assert (overlay != np.asarray(Image.open(photo / "rope.png"))).any()


def test_detect_lifts_with_depth_and_intrinsics(photo, capsys):
    code, out, _ = run(
        capsys, "detect", photo / "rope.png", *HSV, "--out", photo / "o",
        "--depth", photo / "depth.png", "--intrinsics", 200, 200, 160, 120,
    )  # fmt: skip
    shape = json.loads(out)["shapes"][0]
    points2d, points3d = np.array(shape["points2d"]), np.array(shape["points3d"])
    assert code == 0
    assert np.allclose(points3d[:, 2], 0.7)
    assert np.allclose(points3d[:, 0], (points2d[:, 0] - 160) / 200 * 0.7, atol=1e-4)


def test_pick_learns_colours_that_detect_then_reads(photo, capsys):
    config = photo / "rope.yaml"
    run(capsys, "detect", photo / "rope.png", "--pick", "160,143", "--save-config", config, "--out", photo / "o")
    segmentation = yaml.safe_load(config.read_text())["scene"]["segmentation"]
    assert segmentation["kind"] == "click"
    assert segmentation["picks"] == [[160.0, 143.0]]
    code, out, _ = run(capsys, "detect", photo / "rope.png", "--config", config, "--out", photo / "o")
    assert code == 0
    assert json.loads(out)["ok"] is True


def test_one_bad_file_does_not_lose_the_others(photo, capsys):
    (photo / "junk.png").write_bytes(b"this is no picture")
    code, out, err = run(
        capsys, "detect", photo / "junk.png", photo / "rope.png", photo / "none.png", *HSV, "--out", photo / "o"
    )
    results = [json.loads(line) for line in out.splitlines()]
    assert code == 1
    assert [result["ok"] for result in results] == [False, True, False]
    assert "not an image that can be read" in results[0]["error"]
    assert "no such file" in results[2]["error"]
    assert "junk.png" in err
    assert "image" in err, "a progress bar belongs to several files"


def test_a_shape_that_is_not_there_is_reported(photo, capsys):
    red = ["--hsv", "170", "200", "200", "10", "255", "255"]
    code, out, _ = run(capsys, "detect", photo / "rope.png", *red, "--out", photo / "o")
    result = json.loads(out)
    assert code == 1
    assert result["ok"] is False
    assert result["shapes"][0]["reason"].startswith("the mask is empty: 0 of 76800 pixels match segmentation 'hsv';")
    assert result["shapes"][0]["points2d"][0] == [None, None]


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["detect", "{photo}"], 2, "--config FILE, --hsv ..., --segmentation module:function or --pick"),
        (["detect", "{photo}", "--pick", "middle"], 2, "--pick: expected u,v such as 300,123, got 'middle'"),
        (["detect", "{photo}", "--pick", "900,5"], 1, "pixel (900, 5) lies outside the image of 320 x 240"),
        (["detect", "{photo}", "--pick", "5,5"], 1, "of the image looks like (5, 5)"),
        (["detect", "{photo}", "--config", "none.yaml"], 1, "none.yaml: no such config file"),
        (["detect", "{photo}", *HSV, "--depth", "a.png", "b.png"], 2, "got 1 images but 2 depth files"),
        (["detect", "{photo}", *HSV, "--depth", "a.png"], 2, "--depth needs --intrinsics"),
        (["detect", "{photo}", "{photo}", *HSV], 2, "several images are named 'rope'"),
        (["demo", "--steps", "0"], 2, "--steps: expected 1...50, got 0"),
        (["bench", "peers", "--frames", "0"], 2, "--frames: expected at least 1, got 0"),
        (["bench", "peers", "--slow-frames", "-1"], 2, "--slow-frames: expected at least 0, got -1"),
        (["bench", "claim"], 2, "unknown measurement 'claim'; did you mean 'claims'?"),
        (["detect", "{photo}", *HSV, "--n", "4y8"], 2, "--n: expected a number of points such as 20, or ROWSxCOLUMNS"),
        (
            ["detect", "{photo}", *HSV, "--n", "4x8"],
            2,
            "--n: a centerline has one number of points such as 20, got '4x8'",
        ),
        (
            ["detect", "{photo}", *HSV, "--shape", "surface", "--n", "9"],
            2,
            "expected ROWSxCOLUMNS such as 4x8, got '9'",
        ),
        (["detect", "{photo}", *HSV, "--shape", "surface", "--n", "1x8"], 2, "rows"),
    ],
)
def test_bad_arguments_get_one_clear_line(photo, capsys, monkeypatch, arguments, code, message):
    monkeypatch.chdir(photo)
    ended, out, err = run(capsys, *(argument.format(photo=photo / "rope.png") for argument in arguments))
    assert ended == code
    assert out == ""
    assert message in err
    assert len(err.strip().splitlines()) == 1


def test_unknown_commands_get_a_hint(capsys):
    code, _, err = run(capsys, "detekt")
    assert code == 2
    assert "unknown command 'detekt'; did you mean 'detect'?" in err


def test_an_unwritable_folder_is_reported_before_work_begins(photo, capsys):
    blocked = photo / "file"
    blocked.write_text("")
    code, out, err = run(capsys, "detect", photo / "rope.png", *HSV, "--out", blocked / "o")
    assert code == 1
    assert out == ""
    assert f"cannot make the output folder {blocked / 'o'}" in err


def test_demo_runs_without_gl_and_writes_its_pictures(tmp_path, capsys):
    code, out, _ = run(capsys, "demo", "--out", tmp_path, "--steps", 6, "--camera", "rl", "--renderer", "rays")
    assert code == 0
    assert "20 points" in out
    assert "not ok: 0, order reversed: 0" in out
    picture = np.asarray(Image.open(tmp_path / "demo.png"))
    assert 1000 < picture.shape[1] < 2000
    assert picture.shape[0] < picture.shape[1] / 2, "cropped to the cable"
    for colour in (GOAL, VALID):
        assert (picture == colour).all(axis=2).any()
    assert getattr(Image.open(tmp_path / "demo.gif"), "n_frames", 1) >= 5
    assert sorted(path.name for path in tmp_path.iterdir()) == ["demo.gif", "demo.png"], "nothing half-written stays"


def test_bench_claims_gives_json(capsys):
    code, out, _ = run(capsys, "bench", "claims", "--only", "noise", "outlines", "--share", 0.02, "--json")
    tables = json.loads(out)
    assert code == 0
    assert {row["ropes"] > 0 for row in tables["drawn ropes in noise, cold"]} == {True}
    assert {row["flipped"] for row in tables["outlines at rest in masks that flicker"]} == {0.05, 0.1}


def test_bench_claims_prints_tables(capsys):
    code, out, _ = run(capsys, "bench", "claims", "--only", "outlines", "--share", 0.02)
    assert code == 0
    assert "outlines at rest in masks that flicker" in out
    assert "horseshoe" in out


@pytest.mark.parametrize(
    "command",
    [[], ["demo"], ["detect"], ["bench"], ["bench", "claims"], ["bench", "peers"], ["bench", "latency"]],
)
def test_every_command_has_help(command):
    script = Path(sys.executable).with_name("shape-obs")
    done = subprocess.run(
        [script, *command, "--help"], capture_output=True, text=True, timeout=60, env={**os.environ, "COLUMNS": "100"}
    )
    assert done.returncode == 0
    assert "usage" in done.stdout.lower()
    assert done.stderr == ""


def towel(folder):
    """Draw a blue rectangle with its corners at (60, 50) and (260, 190)."""
    rgb = np.full((240, 320, 3), (190, 185, 180), np.uint8)
    rgb[50:191, 60:261] = BLUE
    cv2.imwrite(str(folder / "towel.png"), rgb[..., ::-1])
    return folder / "towel.png"


def test_a_surface_has_rows_and_columns(tmp_path, capsys):
    options = ["--shape", "surface", "--n", "3x5", "--ends", "tips", "--out", tmp_path / "o"]
    code, out, _ = run(capsys, "detect", towel(tmp_path), *HSV, *options)
    points = np.array(json.loads(out)["shapes"][0]["points2d"])
    assert code == 0
    assert points.shape == (15, 2)
    lattice = points.reshape(3, 5, 2)
    assert np.allclose(lattice[0, 0], (60, 50), atol=2)
    assert np.allclose(lattice[-1, -1], (260, 190), atol=2)
    assert np.allclose(lattice[1, :, 0], np.linspace(60, 260, 5), atol=3)


def test_an_outline_has_a_number_of_points_and_the_config_keeps_it(tmp_path, capsys):
    photo, config = towel(tmp_path), tmp_path / "c.yaml"
    options = ["--shape", "contour", "--n", "16", "--save-config", config, "--out", tmp_path / "o"]
    code, out, _ = run(capsys, "detect", photo, "--pick", "150,120", *options)
    drawn = json.loads(out)["shapes"][0]
    assert code == 0
    assert drawn["name"] == "contour"
    assert len(drawn["points2d"]) == 16
    _, out, _ = run(capsys, "detect", photo, "--config", config, "--out", tmp_path / "o")
    assert json.loads(out)["shapes"][0]["points2d"] == drawn["points2d"]
    code, _, err = run(capsys, "detect", photo, "--config", config, "--n", "4x4", "--out", tmp_path / "o")
    assert code == 2
    assert "a contour has one number of points" in err
    code, out, _ = run(capsys, "detect", photo, "--config", config, "--shape", "surface", "--out", tmp_path / "o")
    assert json.loads(out)["shapes"][0]["name"] == "surface"
