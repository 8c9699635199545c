"""``shape-obs detect`` and ``demo``: one line for people per image on stderr, JSON on stdout, pictures in files."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from shape_obs import HSVRange, ShapeDetector
from shape_obs.drawing import GOAL, SLOTS, VALID, draw_detection

BLUE = (30, 60, 200)
HSV = ["--hsv", "100", "100", "50", "130", "255", "255"]
ROPES = (((40, 60), (280, 180)), ((60, 190), (250, 40)), ((30, 220), (290, 225)))
MASKS = """
def blue(rgb, depth):
    return rgb[..., 2] > rgb[..., 0].astype(int) + 60

def floats(rgb, depth):
    return rgb[..., 2] / 255.0
"""


def gray() -> np.ndarray:
    return np.full((240, 320, 3), (190, 185, 180), np.uint8)


def save(path: Path, rgb: np.ndarray) -> Path:
    cv2.imwrite(str(path), rgb[..., ::-1])
    return path


@pytest.fixture
def photo(tmp_path, monkeypatch):
    """Return rope.png: a blue rope on gray; next to it swapped.png, depth (700 mm, or in tenths) and my_masks.py."""
    t = np.linspace(0, 1, 400)
    curve = np.stack([60 + 200 * t, 120 + 50 * np.sin(5 * t)], axis=1)
    rgb = gray()
    cv2.polylines(rgb, [np.rint(curve).astype(np.int32)], False, BLUE, 11)
    blue = (rgb == BLUE).all(axis=2)
    save(tmp_path / "swapped.png", rgb[..., ::-1])
    cv2.imwrite(str(tmp_path / "depth.png"), np.where(blue, 700, 720).astype(np.uint16))
    cv2.imwrite(str(tmp_path / "tenths.png"), np.where(blue, 30000, 30200).astype(np.uint16))
    (tmp_path / "my_masks.py").write_text(MASKS)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(__import__("sys").modules, "my_masks", raising=False)
    return save(tmp_path / "rope.png", rgb)


def lines(err: str) -> list[str]:
    """Return the lines of stderr without progress bars."""
    return [line for line in err.replace("\r", "\n").splitlines() if "%|" not in line and line.strip()]


def test_detect_prints_json_and_draws(photo, run):
    code, out, err = run("detect", photo, *HSV, "--out", "o", "--ends", "tips", "--n", 12)
    result = json.loads(out)
    (shape,) = result["shapes"]
    assert code == 0
    picture = Path("o/rope.png")
    assert err == f"{photo}: centerline found, quality {shape['quality']:.2f}, 12 points; picture: {picture}\n"
    assert result["ok"] is True
    assert len(shape["points2d"]) == 12
    assert np.allclose(shape["points2d"][0], (60, 120), atol=6)
    assert shape["points3d"] is None
    overlay = np.asarray(Image.open(result["overlay"]))
    assert overlay.shape == (240, 320, 3)
    assert (overlay != np.asarray(Image.open(photo))).any()


def test_detect_lifts_with_depth_and_intrinsics(photo, run):
    code, out, _ = run("detect", photo, *HSV, "--depth", "depth.png", "--intrinsics", 200, 200, 160, 120)
    (shape,) = json.loads(out)["shapes"]
    points2d, points3d = np.array(shape["points2d"]), np.array(shape["points3d"])
    assert code == 0
    assert np.allclose(points3d[:, 2], 0.7)
    assert np.allclose(points3d[:, 0], (points2d[:, 0] - 160) / 200 * 0.7, atol=1e-4)


def test_a_wrong_unit_of_depth_is_a_line(photo, run):
    code, out, err = run("detect", photo, *HSV, "--depth", "tenths.png", "--intrinsics", 200, 200, 160, 120)
    assert code == 0
    assert json.loads(out)["shapes"][0]["points3d"][0][2] == pytest.approx(30, rel=0.01)
    assert "depth: the object is 30 m away: uint16 depth is read as millimetres" in lines(err)[0]
    assert lines(err)[1].endswith(f"20 points, 20 with depth; picture: {Path('overlays/rope.png')}")


def test_each_image_has_a_line_and_one_bad_file_does_not_lose_the_others(photo, run):
    Path("junk.png").write_bytes(b"this is no picture")
    code, out, err = run("detect", "junk.png", "rope.png", "swapped.png", "none.png", *HSV)
    results = [json.loads(line) for line in out.splitlines()]
    assert code == 1
    assert [result["ok"] for result in results] == [False, True, False, False]
    assert "not an image that can be read" in results[0]["error"]
    assert results[2]["shapes"][0]["points2d"][0] == [None, None]
    assert "no such file" in results[3]["error"]
    junk, rope, swapped, none = lines(err)
    assert junk.startswith("junk.png: ")
    assert rope.startswith("rope.png: centerline found, quality 0.")
    assert "swapped.png: centerline not found: the mask is empty: 0 of 76800 pixels match segmentation 'hsv'" in swapped
    assert "with red and blue swapped" in swapped
    assert "`shape-obs detect IMAGE --pick u,v` proposes" in swapped
    assert none.startswith("none.png: ")
    assert "%|" in err, "a progress bar belongs to several files"


def test_a_function_in_the_current_folder_segments(photo, run, monkeypatch):
    monkeypatch.syspath_prepend(".")
    Path("shape.yaml").write_text("version: 1\nscene:\n  segmentation: my_masks:blue\n")
    _, expected, _ = run("detect", photo, *HSV)
    for arguments in (["--segmentation", "my_masks:blue"], ["--config", "shape.yaml"]):
        code, out, _ = run("detect", photo, *arguments)
        assert code == 0
        assert json.loads(out)["shapes"][0]["points2d"] == json.loads(expected)["shapes"][0]["points2d"]


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        ("rope.png", 2, "--config FILE, --hsv ..., --segmentation module:function or --pick"),
        ("rope.png --pick 900,5", 1, "pixel (900, 5) lies outside the image of 320 x 240"),
        ("rope.png --pick 5,5", 1, "nothing at (5, 5) stands out from what is around it"),
        ("rope.png HSV --depth a.png", 2, "--depth needs --intrinsics"),
        ("rope.png o/rope.png HSV", 2, "overlays/rope.png would be written twice"),
        ("rope.png HSV --count 0", 2, "count"),
        ("rope.png HSV --n 4x8", 2, "--n: a centerline has one number of points such as 20, got '4x8'"),
        ("rope.png HSV --out rope.png/o", 1, "cannot make the output folder rope.png/o"),
        ("rope.png --segmentation my_masks:bleu", 1, "module 'my_masks' has no 'bleu'; did you mean 'blue'?"),
    ],
)
def test_bad_arguments_get_one_clear_line(photo, run, monkeypatch, arguments, code, message):
    monkeypatch.syspath_prepend(".")
    ended, out, err = run("detect", *arguments.replace("HSV", " ".join(HSV)).split())
    assert (ended, out) == (code, "")
    assert message in err
    assert len(err.strip().splitlines()) == 1


def towel(folder: Path) -> Path:
    """Draw a blue rectangle with its corners at (60, 50) and (260, 190)."""
    rgb = gray()
    rgb[50:191, 60:261] = BLUE
    return save(folder / "towel.png", rgb)


def test_a_surface_has_rows_and_columns(tmp_path, run):
    options = ["--shape", "surface", "--n", "3x5", "--ends", "tips", "--out", tmp_path / "o"]
    code, out, _ = run("detect", towel(tmp_path), *HSV, *options)
    assert code == 0
    lattice = np.array(json.loads(out)["shapes"][0]["points2d"]).reshape(3, 5, 2)
    assert np.allclose(lattice[0, 0], (60, 50), atol=2)
    assert np.allclose(lattice[-1, -1], (260, 190), atol=2)
    assert np.allclose(lattice[1, :, 0], np.linspace(60, 260, 5), atol=3)


def test_an_outline_has_a_number_of_points_and_the_config_keeps_it(tmp_path, run):
    photo, config = towel(tmp_path), tmp_path / "o" / "c.yaml"  # in the folder that it makes
    place = ["--out", tmp_path / "o"]
    learned = ["--pick", "150,120", "--shape", "contour", "--n", "16", "--save-config", config]
    code, out, _ = run("detect", photo, *learned, *place)
    (drawn,) = json.loads(out)["shapes"]
    assert (code, drawn["name"], len(drawn["points2d"])) == (0, "contour", 16)
    _, out, _ = run("detect", photo, "--config", config, *place)
    assert json.loads(out)["shapes"][0]["points2d"] == drawn["points2d"]
    code, _, err = run("detect", photo, "--config", config, "--n", "4x4", *place)
    assert code == 2
    assert "a contour has one number of points" in err
    _, out, _ = run("detect", photo, "--config", config, "--shape", "surface", *place)
    assert json.loads(out)["shapes"][0]["name"] == "surface"


@pytest.fixture
def three(tmp_path, monkeypatch):
    """Return a photo of three blue ropes; the second lies over the first, in its own shadow."""
    rgb = gray()
    for start, end in ROPES:
        cv2.line(rgb, start, end, tuple(channel // 2 for channel in BLUE), 11, cv2.LINE_AA)
        cv2.line(rgb, start, end, BLUE, 7, cv2.LINE_AA)
    monkeypatch.chdir(tmp_path)
    return save(tmp_path / "ropes.png", rgb)


def test_all_ropes_are_found_drawn_in_their_own_colours_with_their_crossing(three, run):
    code, out, _ = run("detect", three, *HSV, "--ends", "tips", "--count", "all")
    result = json.loads(out)
    assert code == 0
    assert [shape["name"] for shape in result["shapes"]] == ["centerline0", "centerline1", "centerline2"]
    assert all(shape["ok"] for shape in result["shapes"])
    assert result["more"] == {}
    ends = {shape["name"]: sorted(tuple(shape["points2d"][k]) for k in (0, -1)) for shape in result["shapes"]}
    assert np.allclose(sorted(map(sorted, ROPES)), sorted(ends.values()), atol=8)
    overlay = np.asarray(Image.open(result["overlay"])).reshape(-1, 3)
    for colour in SLOTS[:3]:
        assert (np.abs(overlay - np.array(colour)).max(axis=1) < 5).sum() > 80
    (crossing,) = result["crossings"]
    assert np.allclose(crossing["pixel"], (153.1, 116.6), atol=2)
    assert np.allclose(ends[crossing["slots"][crossing["above"]]], sorted(ROPES[1]), atol=8)


@pytest.mark.parametrize("size", [(64, 48), (640, 480), (1200, 1600)])
def test_marks_have_the_same_share_of_every_picture(size, tmp_path, run):
    width, height = size
    t = np.linspace(0, 1, 200)
    curve = np.stack([width * (0.15 + 0.7 * t), height * (0.5 + 0.2 * np.sin(6 * t))], axis=1)
    rgb = np.full((height, width, 3), (190, 185, 180), np.uint8)
    cv2.polylines(rgb, [np.rint(curve * 16).astype(np.int32)], False, BLUE, max(3, round(width * 0.03)), cv2.LINE_AA, 4)
    photo = save(tmp_path / "p.png", rgb)
    code, out, err = run("detect", photo, *HSV, "--out", tmp_path / "o")
    assert code == 0, err
    picture = np.asarray(Image.open(json.loads(out)["overlay"])).astype(int)
    assert picture.shape == ((480, 640, 3) if width < 640 else rgb.shape)
    share = (np.abs(picture - VALID).max(axis=2) < 12).mean()
    assert share == pytest.approx(20 * np.pi * 4**2 / (640 * 480), rel=0.3)
    if width == 640:
        detection = ShapeDetector(["centerline"], segmentation=HSVRange((100, 100, 50), (130, 255, 255))).detect(rgb)
        np.testing.assert_array_equal(picture, draw_detection(rgb, detection, size=1.0))


def test_demo_runs_without_gl_and_writes_its_pictures(tmp_path, run):
    pytest.importorskip("mujoco")
    code, out, _ = run("demo", "--out", tmp_path, "--steps", 6, "--camera", "rl", "--renderer", "rays")
    assert code == 0
    assert "20 points" in out
    assert "not ok: 0, order reversed: 0" in out
    picture = np.asarray(Image.open(tmp_path / "demo.png"))
    assert 1000 < picture.shape[1] < 2000
    assert picture.shape[0] < picture.shape[1] / 2, "cropped to the cable"
    for colour in (GOAL, VALID):
        assert (picture == colour).all(axis=2).any()
    assert getattr(Image.open(tmp_path / "demo.gif"), "n_frames", 1) >= 5
    assert sorted(path.name for path in tmp_path.iterdir()) == [".shape_obs.sha256", "demo.gif", "demo.png"], (
        "nothing half-written stays"
    )
