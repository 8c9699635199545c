"""Extracted datasets of recordings with unlike robots, and without any."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

pytest.importorskip("pyarrow")
pytest.importorskip("mujoco")

import pyarrow
from pyarrow import dataset

from shape_obs import save_config
from shape_obs.cli import main
from shape_obs.recording import record
from shape_obs_envs.sources import open_source

BLUE = {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]}
STEPS = ("action", "reward", "terminated", "truncated")


@pytest.fixture(scope="module")
def extracted(tmp_path_factory):
    """Return the dataset of photos (four), a rope held by two grippers (three frames), and one held by one (four)."""
    folder = tmp_path_factory.mktemp("place")
    save_config(folder / "c.yaml", {"shapes": [{"kind": "centerline", "n": 8}], "segmentation": BLUE})
    (folder / "in" / "a").mkdir(parents=True)
    for i in range(4):
        rgb = np.full((72, 96, 3), 200, np.uint8)
        cv2.line(rgb, (15, 30 + i), (80, 40), (200, 60, 20), 5)
        cv2.imwrite(str(folder / "in" / "a" / f"{i}.png"), rgb)
    for name, grippers, frames in (("b", 2, 3), ("c", 1, 4)):
        options = {"actions": "random", "renderer": "rays", "camera": (96, 72), "grippers": grippers}
        with open_source("ShapeObs/Cable-v0", seed=0, **options) as source:
            record(source, folder / "in" / name, frames=frames)
    with pytest.raises(SystemExit) as stop:
        main(["extract", str(folder / "in"), "--config", str(folder / "c.yaml"), "-o", str(folder / "out")])
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


def test_what_has_no_robot_has_nulls(extracted):
    for row in rows(extracted, "a"):
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
