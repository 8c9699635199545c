"""``shape-obs detect``: one line for people per image on stderr, JSON on stdout, and a segmentation of one's own."""

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from shape_obs.bench.scenes import draw_rope

HSV = ["--hsv", "100", "100", "50", "130", "255", "255"]
MASKS = """
def blue(rgb, depth):
    return rgb[..., 2] > rgb[..., 0].astype(int) + 60

def floats(rgb, depth):
    return rgb[..., 2] / 255.0
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with a photo of a blue rope, one with its channels swapped, depth, and a module of masks."""
    folder = tmp_path_factory.mktemp("photos")
    t = np.linspace(0, 1, 400)
    rope = draw_rope(np.stack([60 + 200 * t, 120 + 50 * np.sin(5 * t)], axis=1), 11.0, size=(240, 320))
    rgb = np.where(rope.mask[..., None] > 0, np.array([30, 60, 200]), np.array([190, 185, 180])).astype(np.uint8)
    cv2.imwrite(str(folder / "rope.png"), rgb[..., ::-1])
    cv2.imwrite(str(folder / "swapped.png"), rgb)
    cv2.imwrite(str(folder / "depth.png"), np.where(rope.mask > 0, 30000, 30200).astype(np.uint16))
    (folder / "my_masks.py").write_text(MASKS)
    return folder


def detect(folder, *arguments):
    """Run the installed command in the folder; return the exit code, the results and the lines of stderr."""
    command = [Path(sys.executable).parent / "shape-obs", "detect", *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=False)
    results = [json.loads(line) for line in done.stdout.splitlines()]
    lines = [line for line in done.stderr.replace("\r", "\n").splitlines() if "%|" not in line and line.strip()]
    return done.returncode, results, lines


def test_each_image_has_a_line_for_people_and_a_line_of_json(folder):
    code, results, lines = detect(folder, "rope.png", "swapped.png", "none.png", *HSV)
    assert code == 1
    assert [result["ok"] for result in results] == [True, False, False]
    quality = results[0]["shapes"][0]["quality"]
    assert len(lines) == 3
    assert lines[0] == (
        f"rope.png: centerline found, quality {quality:.2f}, 20 points; picture: {Path('overlays/rope.png')}"
    )
    assert lines[1].startswith(
        "swapped.png: centerline not found: the mask is empty: 0 of 76800 pixels match segmentat"
    )
    assert "with red and blue swapped" in lines[1]
    assert "`shape-obs detect IMAGE --pick u,v` proposes" in lines[1]
    assert lines[1].endswith(f"; picture: {Path('overlays/swapped.png')}")
    assert lines[2] == "none.png: no such file" or lines[2].startswith("none.png: ")


def test_a_wrong_unit_of_depth_is_a_line_too(folder):
    code, results, lines = detect(
        folder, "rope.png", *HSV, "--depth", "depth.png", "--intrinsics", "200", "200", "160", "120"
    )
    assert code == 0
    assert results[0]["shapes"][0]["points3d"][0][2] == pytest.approx(30, rel=0.01)
    assert lines[0] == (
        "shape-obs detect: depth: the object is 30 m away: uint16 depth is read as millimetres, but these look like "
        "tenths of a millimetre; give depth // 10, or depth * 1e-4 as float32 metres. This warning is shown once."
    )
    assert lines[1].endswith(f"20 points, 20 with depth; picture: {Path('overlays/rope.png')}")


def test_a_function_in_the_current_folder_segments(folder):
    code, results, _ = detect(folder, "rope.png", "--segmentation", "my_masks:blue")
    _, expected, _ = detect(folder, "rope.png", *HSV)
    assert code == 0
    assert results[0]["shapes"][0]["points2d"] == expected[0]["shapes"][0]["points2d"]


def test_a_function_in_a_config_file_segments(folder):
    (folder / "shape.yaml").write_text(
        "version: 1\nscene:\n  segmentation: {kind: callable, function: my_masks:blue}\n"
    )
    assert detect(folder, "rope.png", "--config", "shape.yaml")[0] == 0
    (folder / "short.yaml").write_text("version: 1\nscene:\n  segmentation: my_masks:blue\n")
    assert detect(folder, "rope.png", "--config", "short.yaml")[0] == 0


@pytest.mark.parametrize(
    ("function", "message"),
    [
        ("my_masks", "shape-obs detect: --segmentation: expected module:function, got 'my_masks'."),
        ("my_masks:bleu", "shape-obs detect: segmentation: module 'my_masks' has no 'bleu'; did you mean 'blue'?"),
        ("your_masks:blue", "shape-obs detect: segmentation: cannot import 'your_masks': No module named 'your_masks'"),
        (
            "my_masks:floats",
            "rope.png: segmentation my_masks:floats: expected a numpy array of bool or uint8, got an",
        ),
    ],
)
def test_a_wrong_function_is_one_clear_line(folder, function, message):
    code, _, lines = detect(folder, "rope.png", "--segmentation", function)
    assert code == (1 if ":" in function else 2)
    assert len(lines) == 1
    assert lines[0].startswith(message)
