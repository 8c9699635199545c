"""``shape-obs fit-features`` as people and programs use it, on tables of known ropes."""

from __future__ import annotations

import json

import numpy as np
import pytest
from known_ropes import WORKSPACE, N, ropes, seen
from rope_env import BLUE

from shape_obs import Shape, ShapeDetector, save_config
from shape_obs.extrinsics import Extrinsics
from shape_obs.features import FeatureContext, PointDistribution, PrincipalComponents
from shape_obs.frame import Frame
from shape_obs.geometry.topology import Chain
from shape_obs.recording import Moment, ShapeLog, ShapeTable
from shape_obs.shape import Detection

BASE = ("--frame", "base")


@pytest.fixture
def table(overhead) -> ShapeTable:
    """Return ten episodes of 12 ropes; in each one rope is lost and one has a hole."""
    detector = ShapeDetector([{"kind": "centerline", "name": "rope", "n": N}], BLUE)  # type: ignore[list-item, arg-type]
    log = ShapeLog(detector)
    log.metadata["camera"] = {
        "intrinsics": overhead.intrinsics.to_dict(),
        "transform_camera_to_base": overhead.transform_camera_to_base.tolist(),
    }
    frame = Frame(np.zeros((240, 320, 3), np.uint8))
    for i, points in enumerate(ropes(120)):
        shape = seen(points, overhead, np.arange(N) != (3 if i % 12 == 5 else -1))
        if i % 12 == 6:
            shape = Shape("rope", shape.points2d, shape.points3d, shape.visible, shape.valid, Chain(N), ok=False)
        log.add(Moment(frame, episode=i // 12), Detection((shape,), 0.1 * i))
    return log.table()


def test_a_table_becomes_a_feature(run, table, tmp_path, overhead):
    table.save(tmp_path / "t.npz")
    out = tmp_path / "new" / "rope.npz"
    code, text, err = run("fit-features", tmp_path / "t.npz", "-o", out, *BASE, "--align", "--components", 3, "--json")
    report = json.loads(text)
    assert code == 0
    assert "reading" in err, "a progress bar"
    assert (report["shapes"], report["held_out"], report["left_out"]) == (80, 20, 20)
    assert report["unit"] == "mm"
    assert report["error"]["mean"] < report["error"]["p95"] < report["error"]["max"] < 10
    assert sum(report["explained"]) > 0.99
    feature = PrincipalComponents(str(out))
    assert feature.identity()["sha256"] == report["sha256"]
    about = feature.model.about
    assert (about["schema_hashes"], about["shapes"]) == ([table.metadata["schema_hash"]], 80)
    view = FeatureContext(320, 240, overhead, WORKSPACE)
    back = [feature.error(seen(points, overhead), view) for points in ropes(20, seed=9)]
    assert np.mean(back) < 2e-3


def test_tables_of_any_format_make_the_same_file(run, table, tmp_path):
    pytest.importorskip("pyarrow")
    half = [{name: column[part] for name, column in table.columns.items()} for part in np.split(np.arange(120), 2)]
    files = []
    for suffix in ("npz", "csv", "parquet"):
        parts = [tmp_path / f"{i}.{suffix}" for i in range(2)]
        for path, columns in zip(parts, half, strict=True):
            ShapeTable(columns, table.metadata).save(path)
        files.append(tmp_path / f"{suffix}-out.npz")
        code, text, _ = run("fit-features", *parts, "-o", files[-1], "--frame", "pixels", "--origin", "centroid")
        assert code == 0
        assert " px" in text
    assert len({path.read_bytes() for path in files}) == 1


def test_another_place_of_the_camera(run, table, tmp_path, overhead):
    table.save(tmp_path / "t.npz")
    raised = overhead.transform_camera_to_base.copy()
    raised[2, 3] += 0.5
    Extrinsics(T=raised.tolist()).save(tmp_path / "e.json")
    heights = []
    for extra in ((), ("--extrinsics", tmp_path / "e.json")):
        assert run("fit-features", tmp_path / "t.npz", "-o", tmp_path / f"{len(extra)}.npz", *BASE, *extra)[0] == 0
        heights.append(PointDistribution.load(tmp_path / f"{len(extra)}.npz").mean[:, 2])
    np.testing.assert_allclose(heights[1] - heights[0], 0.5, atol=1e-6)


def test_mistakes_are_reported_in_a_line(run, table, tmp_path):
    def save(name, columns, metadata):
        ShapeTable(columns, metadata).save(tmp_path / f"{name}.npz")

    save("t", table.columns, table.metadata)
    save("blind", table.columns, {**table.metadata, "camera": None})
    save("flat", {name: each for name, each in table.columns.items() if "points3d" not in name}, table.metadata)
    save("other", table.columns, {**table.metadata, "config": table.metadata["config"].replace("n: 20", "n: 21")})
    save_config(tmp_path / "c.yaml", {"segmentation": BLUE})
    for sources, extra, message in (
        (["t.npz"], ("--name", "rop"), "has no shape 'rop'; did you mean 'rope'"),
        (["t.npz"], ("--components", 70), "components: expected 1 to 59"),
        (["blind.npz"], BASE, "--frame base needs the camera's intrinsics, and the table has none"),
        (["flat.npz"], BASE, "the shape has no points3d"),
        (["t.npz", "other.npz"], BASE, "is Chain(count=21), but Chain(count=20) came before"),
        ([""], (), "is not a table (.npz, .parquet, .csv): give --config FILE"),
        ([""], ("--config", tmp_path / "c.yaml"), "found neither"),
    ):
        paths = [tmp_path / name for name in sources]
        code, text, err = run("fit-features", *paths, "-o", tmp_path / "o.npz", *extra)
        (line,) = [line for line in err.split("\r")[-1].splitlines() if line.strip()]
        usage = "--name" in extra or "--config FILE" in message or not sources
        assert (code, text) == (2 if usage else 1, ""), (sources, extra)
        assert line.startswith("shape-obs fit-features: ")
        assert message in line
        assert not (tmp_path / "o.npz").exists()
