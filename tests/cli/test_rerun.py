"""``--rerun`` of the commands and ``shape-obs view``: files that rerun's own reader reads."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from installed import needs
from rerun_reading import entities, points, read_rrd

from shape_obs import save_config
from shape_obs.recording import ShapeTable

pytestmark = needs("rerun")

BLUE = {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]}
CABLE = ["--set", "actions=random", "seed=2", "renderer=rays", "camera=[96, 72]"]
RGB = "/camera/image/rgb"
FLAT = "/camera/image/shapes/rope/points", "Points2D:positions"
SPACE = "/camera/shapes/rope/points", "Points3D:positions"


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Return a folder with photos and a config, in which commands run, without a display."""
    rope = {"kind": "centerline", "name": "rope", "n": 8}
    save_config(tmp_path / "pixels.yaml", {"segmentation": BLUE, "shapes": [rope], "features": ["points2d"]})
    save_config(tmp_path / "base.yaml", {"shapes": [rope], "segmentation": BLUE, "features": ["length"]})
    (tmp_path / "photos").mkdir()
    for i in range(3):
        rgb = np.full((72, 96, 3), 190, np.uint8)
        cv2.line(rgb, (10, 30 + 4 * i), (80, 40), (200, 60, 30), 6)
        cv2.imwrite(str(tmp_path / "photos" / f"{i}.png"), rgb)
    monkeypatch.chdir(tmp_path)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path


def test_a_replay_logs_the_points_of_its_table(place, run):
    code, out, err = run("replay", "photos", "--rerun", "--config", "pixels.yaml", "--npz", "out/s.npz")
    assert code == 0, err
    assert "wrote           out/s.rrd" in out
    assert "shape-obs replay: logs to out/s.rrd; open it with: rerun out/s.rrd" in err
    table, logged = ShapeTable.load(place / "out" / "s.npz"), read_rrd(place / "out" / "s.rrd", *FLAT)
    assert len(logged) == len(table) == 3
    for row, values in enumerate(logged.values()):
        np.testing.assert_array_equal(points(values), table["rope/points2d"][row])
    features = read_rrd(place / "out" / "s.rrd", "/plots/features/rope/points2d", "Scalars:scalars")
    np.testing.assert_allclose(next(iter(features.values())), table["rope/points2d"][0].ravel(), atol=1e-4)
    assert "/camera/image/mask" in entities(place / "out" / "s.rrd")


def test_a_view_shows_images_and_with_a_config_the_shapes(place, run):
    code, out, err = run("view", "photos")
    assert code == 0, err
    assert out == "frames          3\nwrote           photos.rrd\n"
    assert len(read_rrd(place / "photos.rrd", RGB, "EncodedImage:blob")) == 3
    assert FLAT[0] not in entities(place / "photos.rrd")
    code, _, err = run("view", "photos", "--config", "pixels.yaml", "-o", "new/v.rrd", "--frames", "2")
    assert code == 0, err
    assert [len(values) for values in read_rrd(place / "new" / "v.rrd", *FLAT).values()] == [8, 8]


def test_a_recording_is_logged_while_it_is_made_and_shown_in_space(place, run):
    pytest.importorskip("mujoco")
    arguments = ["--source", "ShapeObs/Cable-v0", "-o", "cable", "--frames", "4", *CABLE, "--rerun"]
    code, _, err = run("record", *arguments)
    assert code == 0, err
    assert len(read_rrd(place / "cable.rrd", "/camera/image/depth", "DepthImage:buffer")) == 4
    code, _, err = run("replay", "cable", "--config", "base.yaml", "--rerun", "r.rrd", "--npz", "s.npz")
    assert code == 0, err
    table, logged = ShapeTable.load(place / "s.npz"), read_rrd(place / "r.rrd", *SPACE)
    for row, values in enumerate(logged.values()):
        wanted = table["rope/points3d"][row]
        np.testing.assert_array_equal(points(values), wanted[np.isfinite(wanted).all(axis=1)])
    assert read_rrd(place / "r.rrd", "/camera", "Transform3D:translation"), "the pose of the camera"


@pytest.mark.parametrize(
    ("arguments", "exit_code", "message"),
    [
        (["view", "none"], 1, "source 'none' is not a camera, path, class or environment"),
        (["view", "photos", "--out", "v.mp4"], 2, "--out: expected FILE.rrd or rerun+http://HOST:9876/proxy"),
        (["view", "ShapeObs/Cable-v0"], 2, "ShapeObs/Cable-v0 never ends: give --frames N"),
        (["view", "photos", "-o", "rerun+http://127.0.0.1:9/proxy"], 1, "no rerun viewer at rerun+http://127.0.0.1:9"),
    ],
)
def test_mistakes_are_reported_in_one_line(place, run, arguments, exit_code, message):
    code, out, err = run(*arguments)
    assert (code, out) == (exit_code, "")
    assert message in err
    assert sum(line.startswith("shape-obs") for line in err.splitlines()) == 1
    assert not list(place.rglob("*.rrd"))
