"""``shape-obs extract``: the same dataset even after interruptions, with the features that a policy would see."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("pyarrow")
pytest.importorskip("mujoco")

import pyarrow
from pyarrow import dataset, parquet

from shape_obs import save_config
from shape_obs.cli import main
from shape_obs.config.config_file import load_config, schema_hash
from shape_obs.detector import ShapeDetector
from shape_obs.features import FeatureContext, FeatureVector, read_features
from shape_obs.recording import record, replay
from shape_obs_envs.sources import open_source

COUNT, FRAMES, N = 20, 4, 8
ROPE = {"kind": "centerline", "name": "rope", "n": N, "anchor": "gripper0", "ends": "tips", "spacing": "m"}
BLUE = {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]}
FEATURES = ["points3d", {"kind": "points3d", "frame": "base"}, {"kind": "fourier", "harmonics": 3, "frame": "base"}]

# Dies as by the kernel's hand while the eighth file is half written.
KILLED = """
import os, signal, sys
import shape_obs.recording.table as table
from shape_obs.cli import main

whole, left = table.write_whole, [8]

def dying(path, write):
    def half(temporary):
        write(temporary)
        os.truncate(temporary, temporary.stat().st_size // 2)
        os.kill(os.getpid(), signal.SIGKILL)

    left[0] -= 1
    whole(path, write if left[0] else half)

table.write_whole = dying
main(sys.argv[1:])
"""


def content(folder):
    """Return the bytes of every file in a folder by name, including hidden files."""
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Return a folder with twenty recordings of a cable in ``recorded``, the last with two episodes, and a config."""
    folder = tmp_path_factory.mktemp("place")
    save_config(folder / "c.yaml", {"shapes": [ROPE], "segmentation": BLUE, "features": FEATURES})
    with open_source(
        "ShapeObs/Cable-v0", seed=0, actions="random", renderer="rays", camera=(96, 72), max_episode_steps=FRAMES - 1
    ) as source:
        for i in range(COUNT):
            record(source, folder / "recorded" / f"r{i:02d}", frames=FRAMES * (1 + (i == COUNT - 1)))
    return folder


@pytest.fixture(scope="module")
def clean(place):
    """Return the dataset of an undisturbed run."""
    with pytest.raises(SystemExit) as stop:
        main(["extract", str(place / "recorded"), "--config", str(place / "c.yaml"), "-o", str(place / "clean")])
    assert stop.value.code == 0
    return place / "clean"


def test_one_table_of_all_episodes(place, clean):
    table = dataset.dataset(clean, format="parquet").to_table()
    assert len(content(clean)) == COUNT + 2, "a file for each episode, and what made them"
    assert len(table) == (COUNT + 1) * FRAMES
    assert all(table["rope/ok"].to_pylist())
    assert set(table["source"].to_pylist()) == {str(place / "recorded" / f"r{i:02d}") for i in range(COUNT)}
    assert table["frame"].to_pylist()[:FRAMES] == list(range(FRAMES))
    assert len(set(table["episode"].to_pylist())) == COUNT + 1
    assert not {"received", "created"} & set(table.column_names)
    pandas = pytest.importorskip("pandas")
    frame = pandas.read_parquet(clean)
    assert len(frame) == len(table)
    assert np.stack(frame["rope/points3d"]).shape == (len(table), 3 * N)


def test_features_are_those_of_the_vector(place, clean):
    """The columns equal those of a separate detector and feature vector, and have units and hashes."""
    config = load_config(place / "c.yaml")
    detector = ShapeDetector(**{name: value for name, value in config.items() if name != "features"})
    with open_source(place / "recorded" / "r03") as source:
        seen = [(moment, detection, moment.frame.camera) for moment, detection in replay(source, detector)]
    view = FeatureContext(96, 72, seen[0][2], max_age=detector.config.max_age)
    vector = FeatureVector(read_features(FEATURES), detector.shapes, view)
    expected = []
    for moment, detection, camera in seen:
        x, y, z = moment.anchors["gripper0"]
        now = FeatureContext(96, 72, camera, max_age=0.5, anchor=(x, y, z), anchors=moment.anchors)
        expected.append(vector.compute(detection.shapes, [now]))
    (part,) = clean.glob("part-r03-*.parquet")
    table = parquet.read_table(part)
    names = ["rope/features/points3d", "rope/features/points3d_2", "rope/features/fourier"]
    for name, block in zip(names, vector.blocks, strict=True):
        assert str(table.schema.field(name).type).startswith("fixed_size_list<")
        assert np.array_equal(np.stack(table[name].to_pylist()).astype(np.float32), np.array(expected)[:, block.place])
        assert np.array(table[f"{name}/measured"].to_pylist()).all()
    points = np.stack(table["rope/points3d"].to_pylist()).astype(np.float32)
    assert np.array_equal(points, [np.ravel(np.asarray(detection["rope"].points3d)) for _, detection, _ in seen])
    report = json.loads(table.schema.metadata[b"shape_obs"])
    assert report["schema_hash"] == report["made_with"]["schema_hash"] == schema_hash(config)
    assert report["features"][names[1]] == {
        "feature": read_features(FEATURES[1])[0].to_dict(),
        "units": 3 * N * ["m"],
    }


def test_killed_and_restarted_is_one_clean_run(place, clean, extract, monkeypatch):
    arguments = [str(place / "recorded"), "--config", str(place / "c.yaml"), "-o", str(place / "killed")]
    died = subprocess.run([sys.executable, "-c", KILLED, "extract", *arguments], capture_output=True, timeout=120)
    assert died.returncode == -signal.SIGKILL
    before = content(place / "killed")
    half = [name for name in before if name.startswith(".")]
    assert len(half) == 1, "one temporary file"
    assert sum(name.startswith("part-") for name in before) == 7
    code, report, _ = extract(*arguments)
    assert (code, report["done"], report["kept"], report["failed"]) == (0, COUNT + 1 - 7, 7, [])
    assert (report["frames"], report["ok"]) == ((COUNT + 1) * FRAMES, {"rope": (COUNT + 1) * FRAMES})
    assert content(place / "killed") == content(clean)
    assert extract(*arguments)[1]["kept"] == COUNT + 1


def test_processes_give_the_same(place, clean, extract):
    sources = sorted((place / "recorded").iterdir())[-3:]
    code, report, err = extract(*sources, "--config", place / "c.yaml", "-o", place / "two", "--jobs", 2)
    assert (code, report["done"]) == (0, 4)
    assert "extracting" in err, "a progress bar"
    assert content(place / "two").items() <= content(clean).items()


@pytest.mark.nightly
def test_ray_gives_the_same(place, clean, extract, monkeypatch):
    pytest.importorskip("ray")
    monkeypatch.setenv("RAY_ADDRESS", "127.0.0.1:1")  # of somebody's cluster, which the command was not asked to join
    arguments = ["--config", place / "c.yaml", "-o", place / "ray", "--engine", "ray", "--jobs", 2]
    shutil.copytree(place / "recorded" / "r00", place / "bad")
    (place / "bad" / "rgb" / "000001.png").write_bytes(b"junk")
    code, report, _ = extract(place / "bad", *sorted((place / "recorded").iterdir())[-3:], *arguments)
    assert (code, report["done"]) == (1, 4)
    assert [failure["source"] for failure in report["failed"]] == [str(place / "bad")]
    found = {name: data for name, data in content(place / "ray").items() if name != "_failures.json"}
    assert found.items() <= content(clean).items()


def test_a_damaged_recording_loses_only_itself(place, tmp_path, extract):
    """An image of one recording is damaged, and the lines of another; of two episodes in a third, only one fails."""
    for name in ("r00", "r01", "r02", "r19"):
        shutil.copytree(place / "recorded" / name, tmp_path / "in" / name)
    whole = (tmp_path / "in" / "r01" / "rgb" / "000002.png").read_bytes()
    (tmp_path / "in" / "r01" / "rgb" / "000002.png").write_bytes(b"junk")
    (tmp_path / "in" / "r02" / "frames.jsonl").write_bytes(b"no lines\n" * 5)
    (tmp_path / "in" / "r19" / "depth" / f"{FRAMES:06d}.npy").unlink(missing_ok=True)
    (tmp_path / "in" / "r19" / "depth" / f"{FRAMES:06d}.png").unlink(missing_ok=True)
    arguments = (tmp_path / "in", "--config", place / "c.yaml", "-o", tmp_path / "out")
    code, report, err = extract(*arguments)
    assert (code, report["done"], report["files"]) == (1, 2, 2)
    assert [Path(failure["source"]).name for failure in report["failed"]] == ["r01", "r02", "r19"]
    assert [failure["index"] for failure in report["failed"]] == [0, 0, 1]
    assert "rgb/000002.png: damaged" in report["failed"][0]["reason"]
    assert f"failed: {tmp_path / 'in' / 'r02'}: " in err
    assert json.loads((tmp_path / "out" / "_failures.json").read_text()) == report["failed"]
    assert len(dataset.dataset(tmp_path / "out", format="parquet").to_table()) == 2 * FRAMES
    (tmp_path / "in" / "r01" / "rgb" / "000002.png").write_bytes(whole)
    shutil.rmtree(tmp_path / "in" / "r02")
    shutil.rmtree(tmp_path / "in" / "r19")
    code, report, _ = extract(*arguments)
    assert (code, report["done"], report["kept"], report["failed"]) == (0, 1, 1, [])
    assert not (tmp_path / "out" / "_failures.json").exists()


def test_what_changed_is_done_again_or_refused(place, tmp_path, extract):
    shutil.copytree(place / "recorded" / "r00", tmp_path / "in" / "a")
    shutil.copytree(place / "recorded" / "r19", tmp_path / "in" / "b")
    arguments = (tmp_path / "in", "--config", place / "c.yaml", "-o", tmp_path / "out")
    assert extract(*arguments)[1]["done"] == 3
    shutil.rmtree(tmp_path / "in" / "b")
    shutil.copytree(place / "recorded" / "r05", tmp_path / "in" / "b")  # one episode where there were two
    report = extract(*arguments)[1]
    assert (report["done"], report["kept"], report["files"]) == (1, 1, 2)
    assert len(dataset.dataset(tmp_path / "out", format="parquet").to_table()) == 2 * FRAMES
    before = content(tmp_path / "out")
    for extra, message in (
        (("--features", "centroid"), "with config_hash "),
        (("--frames", "2"), "with frames None, this run has 2: choose another --out, or remove the folder."),
    ):
        code, report, err = extract(*arguments, *extra)
        assert (code, report) == (1, None)
        assert message in err
    assert content(tmp_path / "out") == before
    # Recordings that come later join the others.
    shutil.copytree(place / "recorded" / "r07", tmp_path / "in" / "c")
    report = extract(*arguments)[1]
    assert (report["done"], report["kept"]) == (1, 2)


def test_bad_input_gets_one_clear_line(place, clean, tmp_path, extract):
    good = (place / "recorded" / "r00", "--config", place / "c.yaml", "-o", tmp_path / "out")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").write_text("notes")
    for arguments, message in (
        ((tmp_path / "none", *good[1:]), "none: no such file or folder; record a camera or an environment first"),
        ((tmp_path / "*.bag", *good[1:]), "*.bag: found no recording there"),
        ((tmp_path, *good[1:]), "found no recording there: no recorded folder, images, .db3"),
        ((*good[:3], "-o", tmp_path / "full"), "full: the folder is not empty, and holds no extraction"),
        ((*good, "--jobs", "0"), "--jobs: expected at least 1, got 0"),
        ((*good, "--address", "auto"), "--address: only for a Ray cluster"),
        ((*good, "--features", "centriod"), "centroid"),
        ((*good, "--extrinsics", "none.json"), "none.json: no such file of extrinsics"),
    ):
        code, report, err = extract(*arguments)
        lines = [line for line in err.replace("\r", "\n").splitlines() if line.startswith("shape-obs extract: ")]
        wrong_usage = {"--jobs", "--address", "--features"} & set(map(str, arguments))
        assert (code, report) == (2 if wrong_usage else 1, None), arguments
        assert len(lines) == 1
        assert message in lines[0]
    assert not (tmp_path / "out").exists()
    assert os.listdir(tmp_path / "full") == ["notes.txt"]


# ---- recordings with unlike robots, and without any

STEPS = ("action", "reward", "terminated", "truncated")


@pytest.fixture(scope="module")
def extracted(tmp_path_factory):
    """Return the dataset of four photos (of five), a rope held by two grippers (three frames), and by one (four)."""
    folder = tmp_path_factory.mktemp("place")
    save_config(folder / "c.yaml", {"shapes": [{"kind": "centerline", "n": 8}], "segmentation": BLUE})
    (folder / "in" / "a").mkdir(parents=True)
    for i in range(5):
        rgb = np.full((72, 96, 3), 200, np.uint8)
        cv2.line(rgb, (15, 30 + i), (80, 40), (200, 60, 20), 5)
        cv2.imwrite(str(folder / "in" / "a" / f"{i}.png"), rgb)
    for name, grippers, frames in (("b", 2, 3), ("c", 1, 4)):
        options = {"actions": "random", "renderer": "rays", "camera": (96, 72), "grippers": grippers}
        with open_source("ShapeObs/Cable-v0", seed=0, **options) as source:
            record(source, folder / "in" / name, frames=frames)
    options = ["-o", str(folder / "out"), "--frames", "4", "--features", "{kind: centroid, frame: pixels}", "ok"]
    with pytest.raises(SystemExit) as stop:
        main(["extract", str(folder / "in"), "--config", str(folder / "c.yaml"), *options])
    assert stop.value.code == 0
    return folder / "out"


def rows(extracted, name):
    """Return the rows of a recording, from a table of the whole dataset."""
    table = dataset.dataset(extracted, format="parquet").to_table()
    return [row for row in table.to_pylist() if row["source"].endswith(f"/{name}")]


def test_all_parts_have_the_same_columns(extracted):
    schemas = [part.physical_schema for part in dataset.dataset(extracted, format="parquet").get_fragments()]
    assert len(schemas) == 3
    assert all(schema.equals(schemas[0]) for schema in schemas)
    assert schemas[0].field("action").type == pyarrow.list_(pyarrow.float64())
    assert schemas[0].field("terminated").type == pyarrow.bool_()


def test_actions_of_each_robot_stand_in_its_rows(extracted):
    for name, size, state, count in (("b", 6, 10, 3), ("c", 3, 5, 4)):
        found = rows(extracted, name)
        assert [row["step"] for row in found] == list(range(count))
        assert [row["action"] and len(row["action"]) for row in found] == [*(count - 1) * [size], None]
        assert all(len(row["state"]) == state for row in found)
        assert all(found[-1][column] is None for column in STEPS), "no step followed the last frame"
        assert all(row[column] is not None for row in found[:-1] for column in STEPS)


def test_what_has_no_robot_has_nulls_and_what_has_no_depth_has_nan(extracted):
    found = rows(extracted, "a")
    assert len(found) == 4
    for row in found:
        assert np.isfinite(row["centerline/features/centroid"]).all()
        assert np.isnan(row["centerline/points3d"]).all()
        assert [row[column] for column in ("step", "state", *STEPS)] == 6 * [None]
        assert row["centerline/ok"]


def test_the_metadata_of_a_part_name_the_values(extracted):
    names = {}
    for part in dataset.dataset(extracted, format="parquet").get_fragments():
        metadata = json.loads(part.physical_schema.metadata[b"shape_obs"])
        names[metadata["source"]["name"][-1]] = metadata["robot"] and metadata["robot"]["action"]
    assert names["a"] is None
    assert names["c"] == ["gripper0/x", "gripper0/y", "gripper0/yaw"]
    assert len(names["b"]) == 6
