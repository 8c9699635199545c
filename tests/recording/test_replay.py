"""Replaying and exporting: nothing changes by a bit."""

from __future__ import annotations

import json
from typing import Any

import cv2
import numpy as np
import pytest
from scripted_source import equal

import shape_obs
from shape_obs import ShapeDetector, schema_hash
from shape_obs.config import config_hash, detector_arguments, load_config
from shape_obs.recording import Moment, OverlayVideo, ShapeLog, ShapeTable, record, replay
from shape_obs.recording.format import read_moments
from shape_obs_envs.sources import EnvSource, FolderSource

CABLE = "shape_obs_envs:ShapeObs/Cable-v0"
OPTIONS: dict[str, Any] = {"actions": "random", "seed": 4, "renderer": "rays", "camera": [128, 96]}
CONFIG: dict[str, Any] = {
    "shapes": [
        {"kind": "centerline", "name": "rope", "n": 12, "anchor": "gripper0", "ends": "tips", "spacing": "m"},
        {"kind": "contour", "n": 16},
    ],
    "segmentation": {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]},
    "features": ["points3d"],
    "backend": "numpy",
}
FRAMES = 56  # beyond the end of the first episode


@pytest.fixture(scope="module")
def cable():
    pytest.importorskip("mujoco")
    with EnvSource(CABLE, **OPTIONS) as source:
        return list(read_moments(source, FRAMES))


@pytest.fixture(scope="module")
def recorded(cable, tmp_path_factory):
    """The same frames, recorded by another run of the same environment."""
    folder = tmp_path_factory.mktemp("cable") / "recording"
    with EnvSource(CABLE, **OPTIONS) as source:
        told = record(source, folder, frames=FRAMES)
    assert (told.frames, told.missed, told.dropped, told.stopped) == (FRAMES, 0, 0, "done")
    return folder


def detector():
    return ShapeDetector(**detector_arguments(CONFIG))


# ---- to the bit


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
            for name in ("points2d", "points3d", "visible", "valid"):
                assert equal(getattr(a, name), getattr(b, name)), name


# ---- tables


@pytest.fixture(scope="module")
def log(recorded):
    """Of the recording, but for the three last frames blackened: the rope is gone."""
    finder = detector()
    with FolderSource(recorded) as source:
        log = ShapeLog(finder, CONFIG, source)
        pairs = list(replay(source, finder))
        for moment, detection in pairs:
            log.add(moment, detection)
        for i in range(3):
            moment = pairs[-1][0]
            frame: Any = moment.frame
            black, stamp = np.zeros_like(frame.rgb), frame.stamp + 0.4 * (i + 1)
            log.add(moment, finder.detect(black, frame.depth, frame.camera, stamp=stamp, anchors=moment.anchors))
    return log, pairs


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
        for shape in detection:
            assert table[f"{shape.name}/ok"][i] == shape.ok
            if shape.ok:
                assert equal(table[f"{shape.name}/points3d"][i], shape.points3d)
                assert equal(table[f"{shape.name}/valid"][i], shape.valid)
    assert table["rope/ok"][-3:].tolist() == [True, False, False], "held for half a second"
    assert np.isnan(table["rope/points3d"][-2:]).all()
    assert np.isnan(table["rope/points2d"][-2:]).all()
    assert table["rope/reason"][-1] == "the mask is empty"
    assert np.allclose(table["rope/age"][-3:], (0.4, 0.8, 1.2))


def test_a_table_says_what_made_it(log, recorded, tmp_path):
    told = log[0].table().metadata
    assert told["schema_hash"] == schema_hash(CONFIG)
    assert told["config_hash"] == config_hash(CONFIG)
    assert told["source"] == {"kind": "folder", "name": str(recorded)}
    assert told["software"]["shape_obs"] == shape_obs.__version__
    (tmp_path / "again.yaml").write_text(told["config"])
    assert config_hash(load_config(tmp_path / "again.yaml")) == config_hash(CONFIG)
    assert config_hash({**CONFIG, "max_age": 0.1}) != config_hash(CONFIG)


def test_parquet_can_be_read_without_us(log, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    log[0].table().save(tmp_path / "t.parquet")
    content = parquet.read_table(tmp_path / "t.parquet")
    points = np.stack(content["rope/points2d"].to_pylist()).reshape(-1, 12, 2).astype(np.float32)
    assert equal(points, log[0].table()["rope/points2d"])
    assert json.loads(content.schema.metadata[b"shape_obs"])["schema_hash"] == schema_hash(CONFIG)


def test_what_is_no_table_is_refused(log, tmp_path):
    for name in ("t.npz", "t.parquet", "t.csv"):
        (tmp_path / name).write_text("junk")
        with pytest.raises(ValueError, match=f"{name}: not a table of shapes"):
            ShapeTable.load(tmp_path / name)
    with pytest.raises(ValueError, match=r"expected a file named \*\.csv, \*\.npz, \*\.parquet"):
        log[0].table().save(tmp_path / "t.xlsx")
    with pytest.raises(ValueError, match="no frame was added"):
        ShapeLog(detector()).table()


def test_a_source_without_depth_leaves_out_points_in_space(blue):
    segmentation = {"kind": "hsv", "low": [90, 60, 30], "high": [130, 255, 255]}
    finder = ShapeDetector(["centerline"], segmentation, backend="numpy")
    log = ShapeLog(finder)
    log.add(Moment(shape_obs.Frame(blue)), finder.detect(blue))
    table = log.table()
    assert "centerline/points3d" not in table.columns
    assert table["number"].tolist() == [-1]
    assert np.isnan(table["received"]).all()


# ---- videos


@pytest.mark.parametrize("suffix", [".mp4", ".avi"])
def test_an_overlay_shows_every_frame_with_its_points(recorded, tmp_path, suffix):
    path = tmp_path / f"overlay{suffix}"
    with FolderSource(recorded) as source, OverlayVideo(path) as video:
        for moment, detection in replay(source, detector(), frames=20):
            video.add(moment, detection)
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]
    capture = cv2.VideoCapture(str(path))
    assert capture.get(cv2.CAP_PROP_FPS) == pytest.approx(20, abs=0.1), "as the stamps say"
    pictures = [capture.read()[1] for _ in range(20)]
    assert not capture.read()[0]
    assert pictures[0].shape == (480, 640, 3)
    green = (pictures[-1][..., 1].astype(int) - pictures[-1][..., ::2].max(axis=2)) > 80
    assert green.sum() > 12 * 20


def test_an_overlay_that_fails_leaves_no_file(tmp_path):
    finder = ShapeDetector(["centerline"], {"kind": "gray", "low": 1, "high": 2}, backend="numpy")
    frame, other = np.zeros((60, 80, 3), np.uint8), np.zeros((90, 80, 3), np.uint8)
    detection = finder.detect(frame)

    def draw():
        with OverlayVideo(tmp_path / "o.mp4", 30) as video:
            for image in (frame, frame, other):
                video.add(Moment(shape_obs.Frame(image)), detection)

    with pytest.raises(ValueError, match="has another size than the first"):
        draw()
    assert not any(tmp_path.iterdir())
    with pytest.raises(ValueError, match=r"expected a video named \*\.mp4 or \*\.avi"):
        OverlayVideo(tmp_path / "o.gif")
