"""Config files: three sections, errors that help, whole or not at all; and the schema hash."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
import yaml

from shape_obs import Centerline, GrayRange, HSVRange, Rectangle, ShapeDetector, load_config, save_config, schema_hash
from shape_obs.config.config_file import detector_arguments
from shape_obs.features import Ok, Points3D

ARGUMENTS: dict[str, Any] = {
    "shapes": [
        Centerline(n=7, name="rope", anchor="gripper", segmentation=GrayRange(1, 9), length=0.62),
        {"kind": "centerline"},
    ],
    "segmentation": HSVRange((170, 60, 30), (10, 255, 255), close=5),
    "roi": Rectangle(1, 2, 30, 40),
    "features": ["points2d", Points3D(frame="base"), "ok"],
    "workspace": ((-1.0, -1.0, 0.0), np.array([1.0, 1.0, 0.5])),
    "on_missing": "truncate",
    "max_speed": 1.5,
    "dt": 0.1,
}


def test_a_saved_config_comes_back(tmp_path):
    path = tmp_path / "rope.yaml"
    save_config(path, ARGUMENTS)
    loaded = load_config(path)
    assert ShapeDetector(**detector_arguments(loaded)).config == ShapeDetector(**detector_arguments(ARGUMENTS)).config
    assert (loaded["max_speed"], loaded["shapes"][0]["length"], loaded["shapes"][1]["length"]) == (1.5, 0.62, None)
    assert loaded["workspace"] == [[-1.0, -1.0, 0.0], [1.0, 1.0, 0.5]]
    assert loaded["features"][1] == {"kind": "points3d", "frame": "base", "max_depth": 2.0, "origin": None}
    assert schema_hash(loaded) == schema_hash(ARGUMENTS)
    save_config(tmp_path / "again.yaml", loaded)
    assert (tmp_path / "again.yaml").read_text() == path.read_text()


def test_the_file_has_a_version_and_three_sections(tmp_path):
    save_config(tmp_path / "c.yaml", {})
    data = yaml.safe_load((tmp_path / "c.yaml").read_text())
    assert list(data) == ["version", "shape", "scene", "runtime"]
    assert data["version"] == 1
    assert data["shape"]["shapes"][0]["n"] == 20
    assert data["runtime"]["on_missing"] == "hold"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[]\n", "expected 'version', 'shape', 'scene' and 'runtime', got list."),
        ("version: 2\n", "expected 'version: 1', got 2."),
        ("shape: {}\n", "expected 'version: 1', got None."),
        ("a: [1\n", "not valid YAML: "),
        ("version: 1\nscenes: {}\n", "unknown section 'scenes'; did you mean 'scene'? Known: shape, scene, runtime."),
        ("version: 1\nscene:\n  segmentaton: {}\n", "scene: unknown field 'segmentaton'; did you mean 'segmentation'?"),
        ("version: 1\nruntime:\n  segmentation: {}\n", "runtime: unknown field 'segmentation'."),
        ("version: 1\nshape:\n  shapes: [{kind: centerline, m: 3}]\n", "DetectorConfig.shapes[0]: centerline: unknown"),
        ("version: 1\nshape:\n  features: [point3d]\n", "feature: unknown kind 'point3d'; did you mean 'points3d'?"),
        ("version: 1\nshape:\n  shapes: [{kind: centerline, length: 0}]\n", "centerline: length must be above 0"),
        ("version: 1\nruntime:\n  max_speed: 0\n", "max_speed: expected more than 0 metres a second (with depth) or"),
    ],
)  # fmt: skip
def test_a_wrong_file_is_reported_with_its_name(tmp_path, text, message):
    path = tmp_path / "c.yaml"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"c\.yaml") as error:
        load_config(path)
    assert str(error.value).startswith(f"{path}: {message}")


def test_a_config_that_is_refused_leaves_the_old_file(tmp_path):
    path = tmp_path / "c.yaml"
    save_config(path, {"dt": 0.25})
    before = path.read_text()
    with pytest.raises(ValueError, match="unknown field 'dtt'"):
        save_config(path, {"dtt": 1})
    assert path.read_text() == before
    assert os.listdir(tmp_path) == ["c.yaml"]


BASE = {"shapes": [{"kind": "centerline"}], "features": ["points3d"]}


@pytest.mark.parametrize(
    "same",
    [
        {"shapes": [Centerline(n=20, order="tracked", ends="centers", radius=0)]},
        {"order": "tracked", "ends": "centers", "anchor": None},
        {"features": "points3d"},
        {"features": [{"kind": "points3d", "frame": "camera", "max_depth": 2}]},
        {"segmentation": {"kind": "gray"}},
        {"shapes": [{"kind": "centerline", "segmentation": {"kind": "gray"}}]},
        {"roi": Rectangle(0, 0, 9, 9), "workspace": [[0, 0, 0], [1, 1, 1]]},
        {"on_missing": "raise", "on_invalid": "hold", "max_age": 3, "dt": 0.1, "max_speed": 2},
        {"shapes": [{"kind": "centerline", "length": 0.62}]},
    ],
)
def test_the_hash_ignores_how_it_is_said_and_where_it_runs(same):
    assert schema_hash({**BASE, **same}) == schema_hash(BASE)


@pytest.mark.parametrize(
    "other",
    [
        {"shapes": [{"kind": "centerline", "n": 21}]},
        {"shapes": [{"kind": "centerline", "anchor": "gripper"}]},
        {"shapes": [{"kind": "centerline", "spacing": "m"}]},
        {"shapes": ["centerline", {"kind": "centerline", "name": "second"}]},
        {"order": "image"},
        {"ends": "tips"},
        {"anchor": [3, 4]},
        {"features": ["points3d", Ok()]},
        {"features": [Ok(), "points3d"]},
        {"features": [Points3D(frame="base")]},
    ],
)
def test_the_hash_changes_with_what_a_policy_reads(other):
    assert schema_hash({**BASE, **other}) != schema_hash(BASE)


def test_the_hash_is_the_same_in_every_process():
    """The hash does not depend on ids or on the order of sets. If the schema changes, document the new value."""
    script = f"from shape_obs import schema_hash; print(schema_hash({BASE!r}))"
    for seed in ("0", "1"):
        done = subprocess.run(
            [sys.executable, "-c", script], capture_output=True, text=True, env={**os.environ, "PYTHONHASHSEED": seed}
        )
        assert done.stdout.strip() == schema_hash(BASE)
