"""``shape-obs bench``: stages at each size; scores and means of the table agree with independent ones."""

from __future__ import annotations

import csv
import importlib.util
import json
import math
from pathlib import Path

import numpy as np
import pytest

from shape_obs import ShapeDetector
from shape_obs.bench import table
from shape_obs.bench.report import machine
from shape_obs.bench.scenes import Sheet, draw_sheet, flat_cloth
from shape_obs.bench.table import CONFIGURATIONS, LABELS, MEASURES, in_right_order, markdown, pictures, summarised

IMAGE_STAGES = [
    "image to mask with OpenCV", "mask to points", "image to points", "image and depth to 3D points",
    "the same without a track",
]  # fmt: skip
ENV_STAGES = ["step of Cable", "step of Cable with ShapeObservation"]


def test_every_stage_is_timed_at_every_size(run):
    code, out, _ = run("bench", "speed", "--frames", "4", "--sizes", "84x84", "160x120", "--json")
    document, images = json.loads(out), ["84 x 84", "160 x 120"]
    expected = [(what, image) for some in (IMAGE_STAGES, ENV_STAGES) for image in images for what in some]
    assert [(row["what"], row["image"]) for row in document["stages"]] == expected
    assert all(0 < row["median_ms"] <= row["p99_ms"] and row["refused"] == 0 for row in document["stages"])
    assert (code, document["frames"], document["clock"], document["missing"]) == (0, 4, "wall", "")
    assert document["machine"] == machine()


def test_without_the_simulator_it_says_what_to_install(run, monkeypatch: pytest.MonkeyPatch):
    found = importlib.util.find_spec
    monkeypatch.setattr("shape_obs.cli.bench.speed.find_spec", lambda name: None if name == "mujoco" else found(name))
    code, out, _ = run("bench", "speed", "--frames", "2", "--sizes", "160x120")
    stages = [line.split(" | ")[0].strip("| ") for line in out.splitlines() if line.startswith("|")][2:]
    assert (code, stages) == (0, IMAGE_STAGES)
    assert out.splitlines()[-1].startswith("simulated steps were not timed, since MuJoCo is not installed: ")
    assert '".[sim]"' in out.splitlines()[-1]


@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_scores_are_those_of_scikit_learn_on_the_same_labels(name: str, monkeypatch: pytest.MonkeyPatch):
    from sklearn.metrics import calinski_harabasz_score, pairwise_distances_argmin, silhouette_score

    monkeypatch.setattr(table, "_SAMPLED", None)
    spec, drawn = CONFIGURATIONS[name], list(pictures(name, 0, 2, seed=3))
    detector = ShapeDetector([spec])
    for (mask, truth), row in zip(drawn, table.run(name, "som", drawn), strict=True):
        anchors = {"corner": tuple(truth.points[0, 0].tolist())} if isinstance(truth, Sheet) else {}
        points = detector.detect_mask(mask, anchors=anchors).shapes[0].pixels
        pixels = table.clustered_pixels(spec, mask)
        labels = pairwise_distances_argmin(pixels, points)
        assert row["pixels"] == len(pixels)
        assert row["ch"] == pytest.approx(calinski_harabasz_score(pixels, labels), rel=1e-6)
        if len(pixels) < 6000:
            assert row["sc"] == pytest.approx(silhouette_score(pixels, labels), abs=1e-6)
        assert row["ms"] > 0
        assert row["ordered"]
        assert row["cv"] < 0.02
    empty = drawn[0]._replace(mask=np.zeros_like(drawn[0].mask))
    assert list(table.run(name, "gmm", [empty])) == [{"ok": False}]


def test_order_is_judged_by_the_truth():
    circle = np.stack([np.cos(a := np.linspace(0, 2 * np.pi, 101)), np.sin(a)], axis=1) * 50
    circle[-1] = circle[0]
    around, half = circle[:-1:5], circle[:51]
    assert in_right_order(np.roll(around[::-1], 7, axis=0), circle)
    assert not in_right_order(np.roll(half[2::5], 1, axis=0), half)
    sheet = draw_sheet(flat_cloth(2.0) + 300)
    lattice = sheet.points[8::16, 4::8].reshape(-1, 2)
    gap = np.linalg.norm(lattice[1] - lattice[0])
    assert in_right_order(lattice[::-1] + (0.45 * gap, 0), sheet)
    assert not in_right_order(lattice + (0.6 * gap, 0), sheet)
    assert not in_right_order(lattice[[1, 0, *range(2, 32)]], sheet)


def test_means_and_intervals_are_those_of_the_episodes_and_the_ranking_is_compared_with_the_papers():
    from scipy.stats import bootstrap

    rng, values = np.random.default_rng(0), dict(zip(LABELS, (0.4, 0.3, 0.2, 0.1, 0.5), strict=True))
    rows = [
        {"configuration": name, "method": method, "episode": episode, "ok": True, "pixels": 9, "cv": 0.1,
         "ordered": True, **{key: values[method] + 0.01 * rng.normal() for key in MEASURES}}
        for name in CONFIGURATIONS for method in LABELS for episode in range(40) for _ in range(2)
    ]  # fmt: skip
    rows.append({"configuration": "contour", "method": "som", "episode": 0, "ok": False})
    page = markdown(found := summarised(rows))
    assert "GMM > SOM (paper's) > FCM > KMA. Here: GMM > FCM > KMA > SOM (paper's)." in page
    *each, whole = [row for row in found if row["method"] == "som"]
    assert [row["refused"] for row in (*each, whole)] == [0, 1, 0, 1]
    some = [r["sc"] for r in rows if (r["configuration"], r["method"], r["ok"]) == ("centerline", "som", True)]
    assert each[0]["sc"] == pytest.approx(np.mean(some))
    low, high = bootstrap((np.reshape(some, (40, 2)).mean(axis=1),), np.mean, rng=0).confidence_interval
    assert each[0]["sc_half"] == pytest.approx((high - low) / 2, rel=0.15)
    assert whole["sc_half"] == pytest.approx(math.hypot(*(row["sc_half"] for row in each)) / 3)


def test_the_table_is_written_as_it_is_printed(run, tmp_path: Path):
    arguments = ["table", "--frames", "10", "--only", "contour", "kmeans", "som", "--out", str(tmp_path), "--json"]
    code, out, _ = run("bench", *arguments)
    results = json.loads(out)["results"]
    assert (code, [(row["method"], row["frames"]) for row in results]) == (0, [("kmeans", 10), ("som", 10)])
    read = list(csv.DictReader((tmp_path / "table.csv").read_text(encoding="utf-8").splitlines()))
    assert [float(row["sc"]) for row in read] == [row["sc"] for row in results]
    assert f"{results[1]['sc']:.3f} ± " in (tmp_path / "table.md").read_text(encoding="utf-8")
