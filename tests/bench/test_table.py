"""``shape-obs bench table``: its scores agree with independent ones, its order with the truth, its means with SciPy."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import bootstrap
from sklearn.metrics import calinski_harabasz_score, pairwise_distances_argmin, silhouette_score

from shape_obs import ShapeDetector
from shape_obs.bench import table
from shape_obs.bench.scenes import Sheet, draw_sheet, flat_cloth
from shape_obs.bench.table import CONFIGURATIONS, LABELS, MEASURES, in_right_order, markdown, pictures, summarised
from shape_obs.cli import main


@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_scores_are_those_of_scikit_learn_on_the_same_labels(name: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(table, "_SAMPLED", None)
    spec, drawn = CONFIGURATIONS[name], list(pictures(name, 0, 2, seed=3))
    detector = ShapeDetector([spec])
    for (mask, truth), row in zip(drawn, table.run(name, "som", drawn), strict=True):
        anchors = {"corner": tuple(truth.points[0, 0].tolist())} if isinstance(truth, Sheet) else {}
        points = detector.detect_mask(mask, anchors=anchors).shapes[0].pixels
        pixels = table.clustered_pixels(spec, mask)
        if name != "contour":  # whose pixels are those of the outline
            assert len(pixels) == np.count_nonzero(mask)
        labels = pairwise_distances_argmin(pixels, points)
        assert row["pixels"] == len(pixels)
        assert row["ch"] == pytest.approx(calinski_harabasz_score(pixels, labels), rel=1e-6)
        if len(pixels) < 6000:
            assert row["sc"] == pytest.approx(silhouette_score(pixels, labels), abs=1e-6)
        assert row["ms"] > 0
        assert row["ordered"]
        assert row["cv"] < 0.02


@pytest.mark.parametrize("method", ["gmm", "fcm", "kmeans", "kohonen"])
def test_a_clusterer_finds_centres_and_its_own_time_counts(method: str):
    drawn = list(pictures("contour", 0, 2, seed=0))
    rows = list(table.run("contour", method, drawn))
    assert all(row["ok"] and row["ms"] > 0 and 0.4 < row["sc"] < 0.55 for row in rows)
    empty = drawn[0]._replace(mask=np.zeros_like(drawn[0].mask))
    assert list(table.run("contour", method, [empty])) == [{"ok": False}]
    ours = list(table.run("contour", "som", drawn))
    assert all(theirs["cv"] > 3 * row["cv"] for theirs, row in zip(rows, ours, strict=True))


def test_order_is_judged_by_the_truth():
    circle = np.stack([np.cos(a := np.linspace(0, 2 * np.pi, 101)), np.sin(a)], axis=1) * 50
    circle[-1] = circle[0]
    around = circle[:-1:5]
    assert in_right_order(around, circle)
    assert in_right_order(np.roll(around[::-1], 7, axis=0), circle)
    assert not in_right_order(around[[1, 0, *range(2, 20)]], circle)
    half = circle[:51]
    assert in_right_order(half[2::5], half)
    assert not in_right_order(np.roll(half[2::5], 1, axis=0), half)
    sheet = draw_sheet(flat_cloth(2.0) + 300)
    lattice = sheet.points[8::16, 4::8].reshape(-1, 2)
    gap = np.linalg.norm(lattice[1] - lattice[0])
    assert in_right_order(lattice, sheet)
    assert in_right_order(lattice[::-1], sheet)
    assert in_right_order(lattice + (0.45 * gap, 0), sheet)
    assert not in_right_order(lattice + (0.6 * gap, 0), sheet)
    assert not in_right_order(lattice[[1, 0, *range(2, 32)]], sheet)


def test_means_and_intervals_are_those_of_the_episodes_and_the_ranking_is_compared_with_the_papers():
    rng = np.random.default_rng(0)
    values = dict(zip(LABELS, (0.4, 0.3, 0.2, 0.1, 0.5), strict=True))
    rows = [
        {"configuration": name, "method": method, "episode": episode, "ok": True, "pixels": 9, "cv": 0.1,
         "ordered": True, **{key: values[method] + 0.01 * rng.normal() for key in MEASURES}}
        for name in CONFIGURATIONS for method in LABELS for episode in range(40) for _ in range(2)
    ]  # fmt: skip
    rows.append({"configuration": "contour", "method": "som", "episode": 0, "ok": False})
    found = summarised(rows)
    page = markdown(found)
    assert "GMM > SOM (paper's) > FCM > KMA. Here: GMM > FCM > KMA > SOM (paper's)." in page
    assert [line for line in page.splitlines() if line.startswith("## ")][-1] == "## All"
    *each, whole = [row for row in found if row["method"] == "som"]
    assert [row["refused"] for row in (*each, whole)] == [0, 1, 0, 1]
    for row in each:
        some = [
            r["sc"] for r in rows if (r["configuration"], r["method"], r["ok"]) == (row["configuration"], "som", True)
        ]
        assert row["sc"] == pytest.approx(np.mean(some))
        low, high = bootstrap((np.reshape(some, (40, 2)).mean(axis=1),), np.mean, rng=0).confidence_interval
        assert row["sc_half"] == pytest.approx((high - low) / 2, rel=0.15)
    assert whole["sc_half"] == pytest.approx(math.hypot(*(row["sc_half"] for row in each)) / 3)


def test_the_command_writes_what_it_prints(capsys: pytest.CaptureFixture[str], tmp_path: Path):
    arguments = ["bench", "table", "--frames", "10", "--only", "contour", "kmeans", "som", "--out", str(tmp_path)]
    with pytest.raises(SystemExit) as end:
        main([*arguments, "--json"])
    assert end.value.code == 0
    results = json.loads(capsys.readouterr().out)["results"]
    assert [(row["configuration"], row["method"], row["frames"]) for row in results] == [
        ("contour", "kmeans", 10), ("contour", "som", 10),
    ]  # fmt: skip
    assert sorted(path.name for path in tmp_path.iterdir()) == ["table.csv", "table.md"]
    with (tmp_path / "table.csv").open(encoding="utf-8") as file:
        read = list(csv.DictReader(file))
    assert [float(row["sc"]) for row in read] == [row["sc"] for row in results]
    assert f"{results[1]['sc']:.3f} ± " in (tmp_path / "table.md").read_text(encoding="utf-8")
