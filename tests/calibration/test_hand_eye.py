"""Calibration and printed sheets, against true cameras, poses and sizes; `python -m tests.benchmarks calibration`."""

from __future__ import annotations

import io
import json
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest
from drawn_frames import record_drawn, run

from shape_obs import Extrinsics, SpecError
from shape_obs.calibration import Touch, fit_base, marker_points, read_touches, write_touches
from shape_obs.markers import find_markers
from tests.benchmarks.scenes.tabletop import CAMERA, LAYOUT, MarkerScene, marker_scene

PLACE = np.eye(4)
PLACE[:3, :3] = cv2.Rodrigues(np.array([2.2, 0.4, -0.3]))[0]
PLACE[:3, 3] = 0.45, -0.12, 0.83


def millimetres(metres: np.ndarray) -> np.ndarray:
    return np.round(1000 * metres).astype(np.uint16)


@pytest.fixture(scope="module")
def scene() -> MarkerScene:
    return marker_scene(3)


@pytest.fixture(scope="module")
def touches(scene) -> list[Touch]:
    corners = scene.to_camera(LAYOUT.array) @ PLACE[:3, :3].T + PLACE[:3, 3]
    noise = np.random.default_rng(0).normal(0, 0.0005, corners.shape)
    return [Touch(i, j, *(corners + noise)[i, j].tolist()) for i in range(4) for j in range(4)]


@pytest.fixture(scope="module")
def recording(tmp_path_factory, scene):
    folder = tmp_path_factory.mktemp("base") / "recording"
    rng = np.random.default_rng(5)
    depths = [millimetres(scene.depth(rng)) for _ in range(3)]
    record_drawn(folder, [scene.rgb] * 3, CAMERA, depths)
    return folder


class TestFitBase:
    rng = np.random.default_rng(1)
    seen = rng.uniform((-0.3, -0.2, 0.6), (0.3, 0.2, 0.9), (12, 3))
    touched = seen @ PLACE[:3, :3].T + PLACE[:3, 3]

    def test_noise(self):
        fit = fit_base(self.seen, self.touched + self.rng.normal(0, 0.0005, (12, 3)), CAMERA, "7")
        assert fit.rms <= 0.001
        np.testing.assert_allclose(fit.extrinsics.camera(CAMERA).to_base(self.seen), self.touched, atol=0.001)
        assert (fit.extrinsics.serial, fit.extrinsics.intrinsics, fit.extrinsics.rms) == ("7", CAMERA, fit.rms)

    @pytest.mark.parametrize("wrong", [0, 5, 11])
    def test_an_outlier_is_named(self, wrong):
        touched = self.touched + self.rng.normal(0, 0.0005, (12, 3))
        touched[wrong] += (0.004, -0.006, 0.003)
        fit = fit_base(self.seen, touched)
        assert fit.suspect == wrong
        assert fit.suspect_off == pytest.approx(0.0078, abs=0.002)

    def test_too_few_or_on_a_line(self):
        with pytest.raises(ValueError, match="3 touches are too few, at least 4 are needed"):
            fit_base(self.seen[:3], self.touched[:3])
        line = np.linspace((0, 0, 0.7), (0.3, 0.1, 0.8), 6)
        with pytest.raises(ValueError, match="lie within 0 mm of one line"):
            fit_base(line, line)


class TestMarkerPoints:
    def test_depth_of_the_whole_marker(self, scene):
        depth = millimetres(scene.depth(np.random.default_rng(0)))
        for each, corners in find_markers(scene.rgb).items():
            truth = scene.to_camera(LAYOUT.array[each])
            assert np.linalg.norm(marker_points(corners, CAMERA, depth) - truth, axis=1).max() < 0.002
            assert np.linalg.norm(marker_points(corners, CAMERA, size=0.06) - truth, axis=1).max() < 0.006

    def test_holes_and_what_lies_next_to_them(self, scene):
        depth = scene.depth(np.random.default_rng(0))
        depth[np.random.default_rng(1).uniform(size=depth.shape) < 0.4] = 0
        depth[::7, ::5] += 0.05
        corners = find_markers(scene.rgb)[0]
        truth = scene.to_camera(LAYOUT.array[0])
        assert np.linalg.norm(marker_points(corners, CAMERA, depth) - truth, axis=1).max() < 0.003


class TestBase:
    def test_from_a_recording_and_a_file(self, tmp_path, recording, touches, scene, capsys):
        write_touches(tmp_path / "touches.csv", touches)
        out = tmp_path / "extrinsics.json"
        assert run("calibrate", "base", "--source", recording, "--touches", tmp_path / "touches.csv", "-o", out) == 0
        printed = capsys.readouterr().out
        assert printed.startswith("16 touches, ")
        assert "corners located by depth" in printed
        assert "marker 3, corner 2 (bottom right)" in printed
        place = Extrinsics.load(out)
        corners = scene.to_camera(scene.grid())
        truth = corners @ PLACE[:3, :3].T + PLACE[:3, 3]
        assert np.linalg.norm(place.camera(CAMERA).to_base(corners) - truth, axis=1).max() < 0.002
        assert place.intrinsics == CAMERA

    def test_json_both_ways_and_a_suspect(self, tmp_path, recording, touches, capsys):
        wrong = [replace(touch, z=touch.z + 0.009) if i == 6 else touch for i, touch in enumerate(touches)]
        (tmp_path / "touches.json").write_text(json.dumps([touch.to_dict() for touch in wrong]))
        words = ["calibrate", "base", "--source", recording, "--touches", tmp_path / "touches.json"]
        assert run(*words, "-o", tmp_path / "e.json", "--json") == 1
        printed, errors = capsys.readouterr()
        assert [touch["suspect"] for touch in json.loads(printed)["touches"]].index(True) == 6
        assert "nothing was written: marker 1, corner 2 (bottom right) lies" in errors
        assert not (tmp_path / "e.json").exists()
        assert run(*words, "-o", tmp_path / "e.json", "--leave-out") == 0
        printed, errors = capsys.readouterr()
        assert "left out: marker 1, corner 2 (bottom right)" in errors
        assert printed.startswith("15 touches, ")
        assert run(*words, "-o", tmp_path / "f.json", "--leave-out", "--max-rms", 0.1) == 1
        assert "more than --max-rms 0.1" in capsys.readouterr().err

    def test_asked_at_the_terminal(self, tmp_path, recording, touches, capsys, monkeypatch):
        lines = [f"{touch.x} {touch.y}, {touch.z}" for touch in touches]
        lines[3:5] = ["", "0.1 0.2", "412 100 20", lines[4]]
        monkeypatch.setattr(sys, "stdin", io.StringIO("\n".join([*lines[:12], "done", "no more"])))
        out = tmp_path / "extrinsics.json"
        assert run("calibrate", "base", "--source", recording, "-o", out) == 0
        errors = capsys.readouterr().err
        assert "expected three numbers such as 0.412 -0.105 0.021, got '0.1 0.2'" in errors
        assert "are they millimetres?" in errors
        assert out.exists()
        kept = read_touches(tmp_path / "extrinsics_touches.csv")
        assert kept == [touch for i, touch in enumerate(touches) if i < 10 and i != 3]

    def test_without_depth(self, tmp_path, touches, scene, capsys):
        record_drawn(tmp_path / "recording", [scene.rgb], CAMERA)
        write_touches(tmp_path / "t.csv", touches)
        words = ["calibrate", "base", "--source", tmp_path / "recording", "--touches", tmp_path / "t.csv"]
        assert run(*words, "-o", tmp_path / "e.json") == 1
        assert "are visible, but have no depth: give the size of the markers" in capsys.readouterr().err
        assert run(*words, "-o", tmp_path / "e.json", "--size", 60) == 0
        assert "by the size of the markers" in capsys.readouterr().out

    @pytest.mark.parametrize(
        ("name", "text", "message"),
        [
            ("t.csv", "marker,corner,x,y\n0,0,1,2\n", "expected the header marker,corner,x,y,z, got marker,corner,x,y"),
            ("t.csv", "marker,corner,x,y,z\n0,0,1,2,3\n0,1,x,2,3\n", "line 3: expected five numbers"),
            ("t.csv", "marker,corner,x,y,z\n0,4,1,2,3\n", "line 2: corner: expected 0 to 3"),
            ("t.csv", "marker,corner,x,y,z\n0,1,412,20,3\n", "line 2: x, y, z: expected metres, got 412.0, 20.0, 3.0"),
            ("t.csv", "marker,corner,x,y,z\n", "holds no touches"),
            ("t.json", '{"marker": 0}', "expected a list of touches, got dict"),
        ],
    )
    def test_bad_touches(self, tmp_path, name, text, message):
        (tmp_path / name).write_text(text)
        with pytest.raises(SpecError, match=message):
            read_touches(tmp_path / name)
