"""`shape-obs detect --count` finds every rope of a photo, separates them and lists their crossings."""

import json

import cv2
import numpy as np
import pytest
from PIL import Image

from shape_obs.cli import main
from shape_obs.drawing import SLOTS

BLUE, HSV = (30, 60, 200), ["--hsv", "100", "100", "50", "130", "255", "255"]
ROPES = (((40, 60), (280, 180)), ((60, 190), (250, 40)), ((30, 220), (290, 225)))


@pytest.fixture
def photo(tmp_path):
    """Return the path of a photo of three blue ropes; the second lies over the first, in its own shadow."""
    rgb = np.full((240, 320, 3), (190, 185, 180), np.uint8)
    for (start, end), shade in zip(ROPES, (BLUE, BLUE, BLUE), strict=True):
        cv2.line(rgb, start, end, tuple(channel // 2 for channel in shade), 11, cv2.LINE_AA)
        cv2.line(rgb, start, end, shade, 7, cv2.LINE_AA)
    path = tmp_path / "ropes.png"
    cv2.imwrite(str(path), rgb[..., ::-1])
    return path


def detect(capsys, photo, *arguments):
    with pytest.raises(SystemExit) as stop:
        main(["detect", str(photo), *HSV, "--ends", "tips", "--out", str(photo.parent / "o"), *arguments])
    captured = capsys.readouterr()
    return stop.value.code, captured.out, captured.err


def test_all_ropes_are_found_and_drawn_in_their_own_colours(photo, capsys):
    code, out, _ = detect(capsys, photo, "--count", "all")
    result = json.loads(out)
    assert code == 0
    assert [shape["name"] for shape in result["shapes"]] == ["centerline0", "centerline1", "centerline2"]
    assert all(shape["ok"] for shape in result["shapes"])
    assert result["more"] == {}
    found = {tuple(sorted(tuple(shape["points2d"][k]) for k in (0, -1))) for shape in result["shapes"]}
    for rope, ends in zip(sorted(map(sorted, ROPES)), sorted(found), strict=True):
        assert np.allclose(rope, ends, atol=8)
    overlay = np.asarray(Image.open(result["overlay"])).reshape(-1, 3)
    for colour in SLOTS[:3]:
        assert (np.abs(overlay - np.array(colour)).max(axis=1) < 5).sum() > 80


def test_crossings_are_in_the_json(photo, capsys):
    _, out, _ = detect(capsys, photo, "--count", "all")
    result = json.loads(out)
    (crossing,) = result["crossings"]
    ends = {shape["name"]: np.array(shape["points2d"])[[0, -1]] for shape in result["shapes"]}
    assert np.allclose(crossing["pixel"], (153.1, 116.6), atol=2)
    assert crossing["above"] in (0, 1)
    upper = ends[crossing["slots"][crossing["above"]]]
    assert np.allclose(sorted(map(tuple, upper)), sorted(ROPES[1]), atol=8)


def test_a_count_leaves_out_what_has_no_slot(photo, capsys):
    code, out, _ = detect(capsys, photo, "--count", "2", "--n", "9")
    result = json.loads(out)
    assert code == 0
    assert [len(shape["points2d"]) for shape in result["shapes"]] == [9, 9]
    assert result["more"] == {"centerline": 1}


@pytest.mark.parametrize(
    ("count", "message"),
    [("many", "--count: expected a number or 'all', got 'many'"), ("0", "count must lie in 1...16")],
)
def test_other_counts_are_refused(photo, capsys, count, message):
    code, out, err = detect(capsys, photo, "--count", count)
    assert (code, out) == (2, "")
    assert message in err
