"""Replaying gives exactly the frames and shapes of the original; tables of them are restored exactly."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from noise_frames import equal
from recorded_cable import CONFIG, FRAMES, detector

import shape_obs
from shape_obs import ShapeDetector, schema_hash
from shape_obs.config.config_file import config_hash, load_config
from shape_obs.config.detector_config import ALGORITHM
from shape_obs.recording import Moment, ShapeLog, ShapeTable, replay
from shape_obs.recording.format import read_moments
from shape_obs_envs.sources import FolderSource


def test_a_recording_gives_every_frame_back_to_the_bit(cable, recorded):
    with FolderSource(recorded) as source:
        assert source.recording is not None
        assert source.recording.warning == ""
        played = list(read_moments(source))
    assert len(played) == FRAMES
    assert {moment.episode for moment in played} == {0, 1}
    live: Any
    back: Any
    for live, back in zip(cable, played, strict=True):
        assert equal(live.frame.rgb, back.frame.rgb)
        assert equal(live.frame.depth, back.frame.depth)
        assert (live.frame.stamp, live.frame.number, live.episode) == (
            back.frame.stamp, back.frame.number, back.episode,
        )  # fmt: skip
        assert live.frame.camera.intrinsics == back.frame.camera.intrinsics
        assert equal(live.frame.camera.transform_camera_to_base, back.frame.camera.transform_camera_to_base)
        assert {name: tuple(point) for name, point in back.anchors.items()} == live.anchors


def test_replaying_finds_exactly_the_shapes_that_were_found_live(cable, recorded):
    finder, live = detector(), []
    for moment in cable:
        if moment.frame.number == 51:  # the environment's second episode
            finder.reset()
        frame = moment.frame
        live.append(finder.detect(frame.rgb, frame.depth, frame.camera, stamp=frame.stamp, anchors=moment.anchors))
    with FolderSource(recorded) as source:
        back = [detection for _, detection in replay(source, detector())]
    assert sum(detection["rope"].ok for detection in live) > 0.9 * FRAMES
    for one, other in zip(live, back, strict=True):
        assert one.stamp == other.stamp
        for a, b in zip(one, other, strict=True):
            assert (a.ok, a.age, a.quality, a.reason) == (b.ok, b.age, b.quality, b.reason)
            assert (a.track_id, a.new, a.length) == (b.track_id, b.new, b.length)
            for name in ("points2d", "points3d", "visible", "valid", "sigma"):
                assert equal(getattr(a, name), getattr(b, name)), name


def test_a_source_without_depth_leaves_out_points_in_space(blue):
    segmentation = {"kind": "hsv", "low": [90, 60, 30], "high": [130, 255, 255]}
    finder = ShapeDetector(["centerline"], segmentation)
    log = ShapeLog(finder)
    log.add(Moment(shape_obs.Frame(blue)), finder.detect(blue))
    table = log.table()
    assert "centerline/points3d" not in table.columns
    assert table["number"].tolist() == [-1]
    assert np.isnan(table["received"]).all()


# ---- tables of shapes


@pytest.mark.parametrize("suffix", ["csv", "npz", "parquet"])
def test_tables_come_back_to_the_bit(log, tmp_path, suffix):
    if suffix == "parquet":
        pytest.importorskip("pyarrow")
    table = log[0].table()
    table.save(tmp_path / f"t.{suffix}")
    back = ShapeTable.load(tmp_path / f"t.{suffix}")
    assert list(back.columns) == list(table.columns)
    for name, column in table.columns.items():
        assert back[name].shape == column.shape, name
        if column.dtype.kind == "f":
            assert equal(back[name], column), name
        else:
            assert np.array_equal(back[name], column), name
    assert back.metadata == table.metadata
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_a_table_holds_what_the_detector_said(log):
    pairs, table = log[1], log[0].table()
    assert len(table) == FRAMES + 3
    assert table["rope/points2d"].shape == (FRAMES + 3, 12, 2)
    assert table["contour/points3d"].shape == (FRAMES + 3, 16, 3)
    for i, (moment, detection) in enumerate(pairs):
        assert (table["frame"][i], table["number"][i], table["stamp"][i]) == (i, moment.frame.number, detection.stamp)
        assert table["episode"][i] == moment.episode
        assert table["warning"][i] == detection.warning
        for shape in detection:
            assert table[f"{shape.name}/ok"][i] == shape.ok
            assert (table[f"{shape.name}/track_id"][i], table[f"{shape.name}/new"][i]) == (shape.track_id, shape.new)
            assert equal(table[f"{shape.name}/sigma"][i], shape.sigma)
            assert np.isnan(table[f"{shape.name}/length"][i]) == (shape.length is None)
            if shape.ok:
                assert equal(table[f"{shape.name}/points3d"][i], shape.points3d)
                assert equal(table[f"{shape.name}/valid"][i], shape.valid)
    assert table["rope/ok"][-3:].tolist() == [True, False, False], "held for half a second"
    assert np.isnan(table["rope/points3d"][-2:]).all()
    assert np.isnan(table["rope/points2d"][-2:]).all()
    assert table["rope/reason"][-1] == "the mask is empty"
    assert np.allclose(table["rope/age"][-3:], (0.4, 0.8, 1.2))


def test_a_table_says_what_made_it(log, recorded, tmp_path):
    stored = log[0].table().metadata
    assert stored["schema_hash"] == schema_hash(CONFIG)
    assert stored["config_hash"] == config_hash(CONFIG)
    assert stored["source"] == {"kind": "folder", "name": str(recorded)}
    assert stored["algorithm"] == ALGORITHM
    assert stored["software"]["shape_obs"] == shape_obs.__version__
    (tmp_path / "again.yaml").write_text(stored["config"])
    assert config_hash(load_config(tmp_path / "again.yaml")) == config_hash(CONFIG)
    assert config_hash({**CONFIG, "max_age": 0.1}) != config_hash(CONFIG)


@pytest.mark.parametrize("suffix", ["csv", "npz", "parquet"])
def test_a_table_of_an_earlier_version_loads_and_says_what_it_lacks(log, tmp_path, suffix):
    if suffix == "parquet":
        pytest.importorskip("pyarrow")
    now = log[0].table()
    later = ("warning", "track_id", "new", "length", "sigma")
    columns = {name: column for name, column in now.columns.items() if name.rpartition("/")[2] not in later}
    ShapeTable(columns, {"shapes": now.metadata["shapes"]}).save(tmp_path / f"t.{suffix}")
    table = ShapeTable.load(tmp_path / f"t.{suffix}")
    assert equal(table["rope/points3d"], now["rope/points3d"])
    with pytest.raises(KeyError, match=r"no column 'rope/sigma'.*Tables of earlier versions do not have it: replay"):
        table["rope/sigma"]
    with pytest.raises(KeyError, match="no column 'rope/point3d'; did you mean 'rope/points3d'"):
        table["rope/point3d"]


def test_what_is_no_table_is_refused(log, tmp_path):
    for name in ("t.npz", "t.parquet", "t.csv"):
        (tmp_path / name).write_text("junk")
        with pytest.raises(ValueError, match=f"{name}: not a table of shapes"):
            ShapeTable.load(tmp_path / name)
    with pytest.raises(ValueError, match=r"expected a file named \*\.csv, \*\.npz, \*\.parquet"):
        log[0].table().save(tmp_path / "t.xlsx")
    with pytest.raises(ValueError, match="no frame was added"):
        ShapeLog(detector()).table()
