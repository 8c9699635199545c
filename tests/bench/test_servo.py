"""`shape-obs bench servo`: equal episodes, when a goal is reached, disturbances. No test depends on times."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("mujoco")

from PIL import Image

from shape_obs.cli import main
from shape_obs.features import read_features
from shape_obs.geometry.topology import Chain
from shape_obs.shape import Shape
from tests.benchmarks import ENVS, SERVO_ENVS
from tests.benchmarks.interleaved_timing import Timing
from tests.benchmarks.servo import study
from tests.benchmarks.servo.episode import settled
from tests.benchmarks.servo.settings import FEATURES, LAYOUTS, Disturbance, Setting, combinations
from tests.benchmarks.servo.study import paired_rows, summary_rows
from tests.benchmarks.servo.times import closed_forms, feature_times
from tests.benchmarks.servo.worlds import World, without
from tests.benchmarks.tables import Row

SETTING = Setting("Cable", "near", "camera", "160x120", "points3d", "rls")
TRUTH = SETTING._replace(source="truth")


def command(capsys, *arguments):
    """Return (exit code, stdout, stderr) of the command."""
    with pytest.raises(SystemExit) as stop:
        main(["bench", "servo", *map(str, arguments)])
    captured = capsys.readouterr()
    return stop.value.code, captured.out, captured.err


def episode(seed, final, best=None, steps=None):
    """Return an episode with a given final error."""
    line = [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]]
    best = final if best is None else best
    unknown = ("prediction", "seen_mm", "detector_ms", "feature_ms", "blackout_action", "blackout_mm")
    return Row(
        [(name, None) for name in unknown],
        seed=seed, start_mm=50.0, final_mm=final, best_mm=best, success=final < 10, steps=steps, held=0,
        errors_mm=[50.0, final], start=line, goal=line, final=line, failure="",
    )  # fmt: skip


def found(setting, finals):
    """Return episodes of the seeds from 0 on; None stands for one that broke off."""
    return {setting: [Row(seed=i, failure="lost") if mm is None else episode(i, mm) for i, mm in enumerate(finals)]}


class TestSettings:
    def test_every_set_can_be_had_of_its_environment(self):
        for env in SERVO_ENVS:
            made = World(TRUTH._replace(env=env))
            assert made.spec.layout == LAYOUTS[env]
            for specs in FEATURES[env].values():
                for feature in read_features(specs):
                    low, high = feature.bounds(made.spec.layout, made.view)
                    assert np.all(low < high)

    def test_what_an_environment_does_not_have_is_left_out_and_names_distinguish_settings(self):
        settings = list(
            combinations(ENVS, ["bezier", "bspline"], ["rls", "mfac"], disturbance=Disturbance(0.2, (5, 2)))
        )
        assert len(settings) == 7 * 2 * 3 * 2
        assert len({setting.name for setting in settings}) == len(settings)
        assert all(setting.disturbance == Disturbance() for setting in settings if setting.source == "truth")

    def test_principal_components_need_their_file(self):
        with pytest.raises(ValueError, match=r"give --pca FILE"):
            list(combinations(["Cable"], ["pca"], ["rls"]))


class TestWorlds:
    def test_the_camera_and_the_truth_live_through_the_same_episode(self):
        camera, truth = (World(setting._replace(features="bspline")) for setting in (SETTING, TRUTH))
        (seen, info), (known, true_info) = (each.env.reset(seed=3) for each in (camera, truth))
        action = np.full(6, 0.3, np.float32)
        for _ in range(3):
            for name in ("truth/mean_error", "truth/points"):
                np.testing.assert_array_equal(info[name], true_info[name])
            np.testing.assert_allclose(seen["desired_goal"], known["desired_goal"], atol=1e-6)
            off = np.abs(seen["achieved_goal"] - known["achieved_goal"])
            assert 0 < off.mean() < 0.005, "noise there, none here"
            assert truth.env.observation_space.contains(known)
            seen, _, _, _, info = camera.env.step(action)
            known, _, _, _, true_info = truth.env.step(action)
        assert camera.milliseconds is not None
        assert truth.milliseconds is None

    def test_frames_are_black_and_points_lost_when_they_should_be(self):
        disturbed = World(SETTING._replace(disturbance=Disturbance(0.3, (2, 2))))
        still = np.zeros(6, np.float32)
        dark: list[bool] = []
        lost: list[np.ndarray] = []
        for _ in range(2):
            disturbed.env.reset(seed=0)
            dark, lost = [disturbed.dark], [~disturbed.seen.valid]
            for _ in range(5):
                disturbed.env.step(still)
                dark.append(disturbed.dark)
                assert bool(disturbed.seen.reason) == disturbed.dark
                lost.append(~disturbed.seen.valid)
            assert dark == [False, False, True, True, False, False]
            share = np.mean([each for each, black in zip(lost, dark, strict=True) if not black])
            assert 0.1 < share < 0.5
        again = World(SETTING._replace(disturbance=Disturbance(0.3)))
        again.env.reset(seed=0)
        np.testing.assert_array_equal(~again.seen.valid, lost[0])

    @pytest.mark.parametrize(
        "wrong", [Disturbance(1.0), Disturbance(-0.1), Disturbance(0, (0, 3)), Disturbance(0, (3, 0))]
    )
    def test_a_disturbance_that_is_none_is_refused(self, wrong):
        with pytest.raises(ValueError, match=r"expected"):
            World(SETTING._replace(disturbance=wrong))


@given(lost=st.lists(st.booleans(), min_size=6, max_size=6), held=st.booleans())
def test_lost_points_are_filled_in_from_the_others(lost, held):
    at = np.arange(6.0)[:, None]
    everyone = np.ones(6, bool)
    shape = Shape("rope", (at * [8, 1]).astype("f4"), (at * [1, 2, 3]).astype("f4"), everyone, everyone, Chain(6))
    shape = replace(shape, reason="hidden" if held else "")
    gone = np.array(lost)
    out = without(shape, gone)
    if held or gone.all():
        assert out is shape
        return
    np.testing.assert_array_equal(out.valid, ~gone)
    np.testing.assert_array_equal(out.visible, ~gone)
    kept = np.flatnonzero(~gone)
    expected = np.clip(np.arange(6), kept[0], kept[-1])[:, None] * [1, 2, 3]  # a straight line, its ends repeated
    assert out.points3d is not None
    np.testing.assert_allclose(out.points3d, expected, atol=1e-5)
    assert np.all(np.isfinite(out.pixels))


@given(st.lists(st.floats(0, 30), min_size=1, max_size=30))
def test_settled_is_the_first_step_of_a_tail_below_10_mm(errors):
    step = settled(errors)
    tails = [first for first in range(len(errors)) if max(errors[first:]) < 10]
    assert step == (tails[0] if tails else None)


class TestSummary:
    def test_shares_and_medians_are_over_what_did_not_break_off(self):
        some = [episode(0, 2, steps=30), episode(1, 4, steps=50), episode(2, 20, best=9), None]
        (row,) = summary_rows({SETTING: [each or Row(seed=3, failure="lost") for each in some]})
        assert (row["n"], row["failed"], row["steps"], row["median_mm"]) == (3, 1, 40, 4)
        assert row["success"] == pytest.approx(100 * 2 / 3)
        assert row["ever"] == 100
        z, n, p = 1.959964, 3, 2 / 3  # Wilson's formula
        half = z * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2)) / (1 + z**2 / n)
        assert (row["high"] - row["low"]) / 200 == pytest.approx(half, rel=1e-5)

    def test_pairs_share_goals_and_all_difficulties_are_one_row_more(self):
        finals = 20 * [1, 20] + [None]
        far = (SETTING._replace(difficulty="far"), TRUTH._replace(difficulty="far"))
        results = found(SETTING, finals) | found(TRUTH, 41 * [1]) | found(far[0], 41 * [1]) | found(far[1], 41 * [1])
        near, away, both = paired_rows(results)
        assert (near["n"], near["ratio"], away["ratio"]) == (40, 0.5, 1)
        assert near["low"] < 0.5 < near["high"]
        assert near["high"] - near["low"] < 0.4
        assert (away["low"], away["high"]) == (1, 1)
        assert (both["difficulty"], both["n"]) == ("all", 81)
        assert both["ratio"] == pytest.approx(61 / 81)

    def test_no_ratio_to_nothing(self):
        (row,) = paired_rows(found(SETTING, [1, 20]) | found(TRUTH, [20, 20]))
        assert row["ratio"] is row["low"] is row["high"] is None


class TestStudy:
    @pytest.fixture
    def played(self, monkeypatch):
        """Return the seeds that are played, without a simulation: seed 1 breaks off the first time."""
        seeds = []

        def episodes(setting, some, steps):
            for seed in some:
                yield Row(seed=1, failure="lost") if seed == 1 and 1 not in seeds else episode(seed, 1.0)
                seeds.append(seed)

        monkeypatch.setattr(study, "episodes", episodes)
        return seeds

    def test_it_goes_on_where_it_stopped_and_tries_again_what_broke_off(self, played, tmp_path):
        study.run([SETTING], range(3), folder=tmp_path)
        reported = []
        results = study.run(
            [SETTING], range(4), folder=tmp_path, resume=True, tick=lambda setting, each: reported.append(each.seed)
        )
        assert played == [0, 1, 2, 1, 3]
        assert sorted(reported) == [0, 1, 2, 3]
        assert [each.seed for each in results[SETTING]] == [0, 1, 2, 3]
        assert results[SETTING][0] == episode(0, 1.0)

    def test_without_resume_all_is_played_again(self, played, tmp_path):
        study.run([SETTING], range(2), folder=tmp_path)
        study.run([SETTING], range(2), folder=tmp_path)
        assert played == [0, 1, 0, 1]

    def test_episodes_of_another_length_are_refused(self, played, tmp_path):
        study.run([SETTING], range(1), folder=tmp_path)
        with pytest.raises(ValueError, match=r"steps = 200, this run has 100"):
            study.run([SETTING], range(1), folder=tmp_path, resume=True, steps=100)

    def test_the_command_reports_what_broke_off(self, played, tmp_path, capsys):
        arguments = ("--goals", 2, "--sources", "truth", "--laws", "rls", "--difficulties", "near", "--no-figures")
        code, _, err = command(capsys, *arguments, "--features", "points3d", "--out", tmp_path)
        assert code == 1
        assert "broke off: Cable-near-truth-160x120-points3d-rls, seed 1: lost" in err
        rows = list(csv.DictReader((tmp_path / "episodes.csv").open(encoding="utf-8")))
        assert [row["failure"] for row in rows] == ["", "lost"]


class TestCommand:
    def test_it_plays_and_writes_tables_and_pictures(self, tmp_path, capsys):
        code, out, _ = command(
            capsys, "--goals", 2, "--steps", 60, "--laws", "rls", "--difficulties", "near", "--features", "bspline",
            "--blackout", 40, 5, "--paired", "--json", "--out", tmp_path,
        )  # fmt: skip
        assert code == 0
        document = json.loads(out)
        camera, truth = document["summary"]
        assert camera["blackout_action"] == 0, "nothing moves in the dark"
        assert 0 <= camera["blackout_mm"] < 10
        assert truth["blackout_action"] is None
        assert camera["start_mm"] == truth["start_mm"]
        assert 0.1 < camera["seen_mm"] < 5
        assert truth["seen_mm"] < 1e-3
        assert camera["median_mm"] < camera["start_mm"] / 2
        (pair,) = document["paired"]
        assert pair["n"] == 2
        rows = list(csv.DictReader((tmp_path / "episodes.csv").open(encoding="utf-8")))
        assert [(row["source"], row["seed"]) for row in rows] == [(s, n) for s in ("camera", "truth") for n in "01"]
        assert "| Cable | near | camera | 160x120 | bspline | rls |" in (tmp_path / "table.md").read_text(
            encoding="utf-8"
        )
        for name in ("curves.png", "overlays.png"):
            picture = np.asarray(Image.open(tmp_path / name).convert("L"))
            assert np.ptp(picture) > 150
        assert not list(tmp_path.rglob(".*")), "no temporary file is left"

    def test_the_hanging_rope_is_seen_from_where_the_view_says(self, tmp_path, capsys):
        found = {}
        for view in ("side", "above"):
            code, out, _ = command(
                capsys, "--envs", "Hanging", "--view", view, "--goals", 1, "--steps", 2, "--laws", "rls", "--sources",
                "camera", "--difficulties", "near", "--features", "points2d", "--no-figures", "--json",
                "--out", tmp_path / view,
            )  # fmt: skip
            assert code == 0
            (found[view],) = json.loads(out)["summary"]
            assert found[view]["view"] == view
        assert found["side"]["seen_mm"] != found["above"]["seen_mm"]

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (("--laws", "rsl"), "unknown law 'rsl'; did you mean 'rls'"),
            (("--goals", "0"), "--goals: expected at least 1, got 0"),
            (("--sizes", "wide"), "expected WIDTHxHEIGHT"),
            (("--features", "pca"), "give --pca FILE"),
            (("--paired", "--sources", "truth"), "needs --sources camera truth"),
            (("--invalid", "1"), "expected a share of the points"),
            (("--envs", "Ring", "--features", "bezier"), "there are no bezier of Ring"),
            (("--blackout", "199", "9"), "end after --steps"),
            (("--view", "above"), "only Hanging has views"),
            (("--rope", "1"), "only Cables has ropes"),
        ],
    )
    def test_mistakes_are_reported_before_anything_runs(self, arguments, message, tmp_path, capsys):
        code, _, err = command(capsys, *arguments, "--out", tmp_path / "none")
        assert code == 2
        assert message in err
        assert not (tmp_path / "none").exists()


def test_every_closed_form_is_timed_along_with_the_detector():
    rows = feature_times("Cable", (160, 120), 2, Timing())
    kinds = {row["feature"].split()[0] for row in rows}
    assert kinds == {feature.kind for feature in closed_forms("Cable")}
    assert {"points3d", "fourier", "bspline", "length", "contour_moments"} <= kinds
    assert all(row["us"] > 0 and row["detector_ms"] > 0 for row in rows)
