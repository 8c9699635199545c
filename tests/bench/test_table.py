"""``shape-obs bench table``: measurements, resumed runs, and written files."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from shape_obs.bench.scenes import Sheet
from shape_obs.cli import main
from shape_obs.clustering.kmeans import KMeans
from tests.benchmarks.table import methods
from tests.benchmarks.table.frames import CONFIGURATIONS, OF, scenes
from tests.benchmarks.table.methods import METHODS, Runner
from tests.benchmarks.table.report import markdown
from tests.benchmarks.table.run import Done, Plan, run
from tests.benchmarks.table.summary import PAPER, rankings, results
from tests.benchmarks.tables import Parts, Row


def command(capsys: Any, *arguments: object) -> tuple[int, str, str]:
    """Return (exit code, stdout, stderr) of the command."""
    with pytest.raises(SystemExit) as stop:
        main(["bench", "table", *map(str, arguments)])
    captured = capsys.readouterr()
    assert isinstance(stop.value.code, int)
    return stop.value.code, captured.out, captured.err


def nothing(done: int, total: int) -> None:
    """Ignore the progress."""


def without_times(chunks: list[list[Row]]) -> list[Row]:
    """Return all rows without their times."""
    return [Row(row, ms=0.0) for row in chain(*chunks)]


class StopError(Exception):
    """Raised in place of an interruption."""


@pytest.fixture(scope="module")
def outlines(tmp_path_factory):
    """Return the folder and the output of the command's run of ten frames of contours."""
    import contextlib
    import io

    folder = tmp_path_factory.mktemp("table")
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(io.StringIO()), pytest.raises(SystemExit):
        main(["bench", "table", "--frames", "10", "--only", "contour", "--out", str(folder)])
    return folder, printed.getvalue()


class TestFrames:
    @pytest.mark.parametrize("name", ["contour", "surface"])
    def test_any_worker_makes_the_same_frames(self, name):
        one, two = (list(scenes(name, 3, 2, 7, "auto")) for _ in range(2))
        other = next(scenes(name, 4, 1, 7, "auto"))
        for a, b in zip(one, two, strict=True):
            np.testing.assert_array_equal(a.rgb, b.rgb)
            np.testing.assert_array_equal(a.mask, b.mask)
        assert (one[0].mask != other.mask).any()
        assert (one[0].mask != one[1].mask).any(), "they move"

    def test_a_cloth_has_as_many_pixels_as_it_should(self):
        scene = next(scenes("surface", 0, 1, 0, "auto"))
        assert 15_000 < np.count_nonzero(scene.mask) < 25_000
        assert isinstance(scene.truth, Sheet)
        assert np.mean((scene.mask > 0) != (scene.truth.mask > 0)) < 0.003

    def test_the_cable_is_the_simulators(self):
        pytest.importorskip("mujoco")
        scene = next(scenes("centerline", 0, 1, 0, "auto"))
        assert scene.rgb.shape == (480, 640, 3)
        assert isinstance(scene.truth, np.ndarray)
        u, v = np.rint(scene.truth).astype(int).T
        assert (scene.mask[v, u] > 0).mean() > 0.98


class TestMeasuring:
    def test_ours_is_in_order_and_even_and_k_means_is_not_even(self):
        made = list(enumerate(scenes("contour", 0, 3, 0, "auto")))
        ours, kmeans = (list(methods.measured("contour", method, made, np.array([0]))) for method in ("som", "kmeans"))
        for row in ours + kmeans:
            assert row.ok
            assert row.ordered
            assert 0.3 < row.sc < 0.6
        assert max(row.cv for row in ours) < 0.01 < min(row.cv for row in kmeans)
        assert [row.exact for row in ours] == [True, False, False]
        assert {row.pixels for row in ours} == {row.pixels for row in kmeans}
        assert not any(row.own_order for row in kmeans), "K-means has no order"

    def test_the_lattice_of_a_turned_cloth_lies_along_it(self):
        for chunk in range(6):
            scene = next(scenes("surface", chunk, 1, 0, "auto"))
            _, row = Runner("surface", "som").measure(scene, 0, exact=False)
            assert row.ordered
            assert row.sc > 0.3

    def test_a_shape_that_is_not_there_has_no_measures(self):
        scene = next(scenes("contour", 0, 1, 0, "auto"))
        points, row = Runner("contour", "kmeans").measure(
            scene._replace(mask=np.zeros_like(scene.mask)), 0, exact=False
        )
        assert points is None
        assert not row.ok
        assert np.isnan(row.sc)

    def test_the_papers_methods_have_their_own_settings(self):
        assert list(METHODS) == ["gmm", "fcm", "kmeans", "kohonen", "som"]
        assert METHODS["kmeans"] == KMeans()
        assert PAPER.keys() == METHODS.keys() - {"som"}


class TestGoingOn:
    def test_an_interrupted_run_goes_on_and_ends_as_one_that_was_not(self, tmp_path):
        plan = Plan(15, names=("contour",), methods=("kmeans", "som"), tracings=("contours",))

        def stop_after_one(done, total):
            assert total == 3
            if done == 1:
                raise StopError

        with pytest.raises(StopError):
            run(plan, tmp_path, tick=stop_after_one)
        first = tmp_path / "parts" / "contour" / "kmeans" / "0000.json"
        written = first.stat().st_mtime_ns
        assert not (first.parent / "0001.json").exists()
        seen: list[int] = []
        found = run(plan, tmp_path, tick=lambda done, total: seen.append(done))
        assert seen == [1, 2, 3]
        assert first.stat().st_mtime_ns == written
        assert not list(tmp_path.rglob(".*")), "nothing half-written stays"
        whole = run(plan, tmp_path / "again", tick=nothing)
        assert len(found["contour", "kmeans"]) == 3
        assert without_times(found["contour", "kmeans"]) == without_times(whole["contour", "kmeans"])

    def test_one_method_is_measured_again_alone(self, tmp_path):
        plan = Plan(10, names=("contour",), methods=("kmeans", "som"), tracings=())
        run(plan, tmp_path, tick=nothing)
        files = {name: tmp_path / "parts" / "contour" / name / "0001.json" for name in ("kmeans", "som")}
        before = {name: file.stat().st_mtime_ns for name, file in files.items()}
        run(replace(plan, methods=("som",)), tmp_path, redo=True, tick=nothing)
        assert files["kmeans"].stat().st_mtime_ns == before["kmeans"]
        assert files["som"].stat().st_mtime_ns > before["som"]

    @pytest.mark.parametrize(
        ("change", "message"), [({"seed": 1}, "seed = 0, this run has 1"), ({"frames": 20}, "frames")]
    )
    def test_other_settings_are_refused(self, tmp_path, change, message):
        plan = Plan(10, names=("contour",), methods=("som",), tracings=())
        Parts(tmp_path, plan.settings()).write("contour/som/0000", [])
        with pytest.raises(ValueError, match=f"holds results with {message}.*choose another folder"):
            run(replace(plan, **change), tmp_path, tick=nothing)

    @pytest.mark.long
    def test_several_processes_measure_the_same(self, tmp_path):
        plan = Plan(10, names=("contour",), methods=("som",), tracings=())
        one, two = (run(plan, tmp_path / str(jobs), jobs=jobs, tick=nothing) for jobs in (1, 2))
        assert without_times(one["contour", "som"]) == without_times(two["contour", "som"])


class TestCommand:
    def test_it_writes_all_it_promises(self, outlines):
        folder, printed = outlines
        assert {path.name for path in folder.iterdir() if path.is_file()} == {
            "table.md", "table.json", "frames.csv", "side_by_side.jpg", "bars.png",
        }  # fmt: skip
        assert (folder / "table.md").read_text(encoding="utf-8") == printed.removesuffix("\n")
        with (folder / "frames.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        assert len(rows) == 5 * 10
        assert {row["method"] for row in rows} == set(METHODS)
        for name in ("side_by_side.jpg", "bars.png"):
            width, height = Image.open(folder / name).size
            assert width > 1000
            assert height > 300
            assert (folder / name).stat().st_size < 200_000

    def test_the_page_says_what_was_done(self, outlines):
        _, printed = outlines
        assert "10 frames of each configuration, seed 0. SC, the silhouette: of all pixels. CH" in printed
        assert "of 2000 pixels drawn at random" in markdown(Plan(60), {}, [], [], [])
        assert "findContours, every pixel" in printed
        assert "| ours | 0." in printed
        assert "ranking" not in printed, "there is none without all configurations"

    def test_values_for_programs(self, outlines, capsys):
        folder, _ = outlines
        code, out, err = command(capsys, "--frames", 10, "--only", "contour", "--out", folder, "--json", "--no-figures")
        values = json.loads(out)
        assert code == 0
        assert "Traceback" not in err
        assert json.loads((folder / "table.json").read_text()) == values
        assert values["paper"]["kohonen"] == {"sc": 0.279, "ch": 42081, "ms": 63}
        assert [result["method"] for result in values["results"]] == list(METHODS)
        ours = values["results"][-1]
        assert ours["cv"] < 0.01
        assert ours["ordered"] == 1
        assert ours["ms_half_interval"] > 0
        assert {trace["tracing"] for trace in values["tracings"]} == {"contours", "corners"}
        assert values["tracings"][0]["points"][0] < values["tracings"][0]["points"][2], "no fixed number"

    def test_the_pages_of_the_docs_are_filled(self, outlines, tmp_path):
        import runpy

        docs = Path(__file__).parents[2] / "docs"
        script = runpy.run_path(str(docs / "pictures" / "table.py"))
        names = {"table": "table-1.md", "details": "table-1-configurations.md"}
        before = {block: (docs / "benchmarks" / name).read_text(encoding="utf-8") for block, name in names.items()}
        pages = {block: tmp_path / name for block, name in names.items()}
        for block, page in pages.items():
            page.write_text(before[block], encoding="utf-8")
        script["main"].__globals__.update(PAGES=pages, IMAGES=tmp_path)
        for _ in range(2):
            script["main"](outlines[0])
        after = {block: page.read_text(encoding="utf-8") for block, page in pages.items()}
        assert after["table"].count("10 frames of each configuration, seed 0.") == 1
        assert after["details"].count("\n## Contour, N = 32") == 1
        for block, text in after.items():
            assert text.endswith(before[block].split("<!-- end -->")[1])
        assert (tmp_path / "table_bars.png").stat().st_size == (outlines[0] / "bars.png").stat().st_size

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (["--frames", 9], "--frames: expected at least 10, got 9."),
            (["--jobs", 0], "--jobs: expected at least 1, got 0."),
            (["--seed", -1], "--seed: expected at least 0, got -1."),
        ],
    )
    def test_bad_arguments_get_one_clear_line(self, capsys, tmp_path, arguments, message):
        code, out, err = command(capsys, "--out", tmp_path, *arguments)
        assert (code, out) == (2, "")
        assert err.strip() == f"shape-obs bench table: {message}"

    def test_without_matplotlib_it_says_so_before_it_begins(self, capsys, tmp_path, monkeypatch):
        import sys

        monkeypatch.setitem(sys.modules, "matplotlib", None)
        code, _, err = command(capsys, "--out", tmp_path / "o", "--frames", 10)
        assert code == 1
        assert 'pip install ".[viz]", or leave them out (see --help).' in err
        assert not (tmp_path / "o").exists()


def test_the_ranking_counts_pairs_on_equal_frames():
    """Return artificial rows: each chunk has its own level, and methods differ by much less."""
    plan = Plan(100, tracings=())
    done: Done = {}
    quality = {"gmm": 4.0, "kohonen": 3.0, "fcm": 2.0, "kmeans": 2.0, "som": 5.0}
    rng = np.random.default_rng(0)
    for name in CONFIGURATIONS:
        for frames in plan.chunks:
            level, noise = rng.normal(0, 50), rng.normal(0, 0.1, (len(METHODS), len(frames)))
            for method, own in zip(METHODS, noise, strict=True):
                same = {"pixels": 100, "ok": True, "cv": 0.0, "ordered": True, "own_order": True, "settled": True}
                values = (quality[method] + level + own).tolist()
                done.setdefault((name, method), []).append([Row(same, sc=v, ch=v, ms=-v) for v in values])
    found = rankings(done, plan)
    assert [(r.measure, r.here[:2], r.against) for r in found[:2]] == [
        ("sc", ("gmm", "kohonen"), 0),
        ("ch", ("gmm", "kohonen"), 0),
    ]
    assert found[0].pairs == 5, "FCM and KMA are equal, so nothing is said of them"
    assert not found[2].holds, "by time GMM would be the fastest"
    summary = results(done, plan)
    assert [r.method for r in summary if r.configuration == "all"] == list(METHODS)
    assert summary[0].sc_half_interval > 10 * 0.1, "an episode counts as one"
    page = markdown(plan, {"cores": "2"}, summary, found, [])
    assert "| silhouette | yes | GMM > SOM (paper's) > FCM > KMA | GMM > SOM (paper's) > " in page
    assert "| KMA | 0.254, " in page


def test_thinning_gives_another_number_of_points_in_every_frame(tmp_path):
    pytest.importorskip("skimage")
    pytest.importorskip("mujoco")
    from tests.benchmarks.table.frames import traced

    found = list(traced("thinning", enumerate(scenes("centerline", 0, 4, 0, "auto"))))
    assert OF["thinning"] == "centerline"
    assert len({row.points for row in found}) > 1
    assert not any(row.ordered for row in found)
    assert all(row.tips >= 2 for row in found)
    assert isinstance(tmp_path, Path)
