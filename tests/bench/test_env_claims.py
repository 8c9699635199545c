"""`shape-obs bench claims --only envs` compares the simulated environments with their own truth."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mujoco")

from shape_obs.cli import main
from shape_obs.geometry.topology import Chain, Grid, Ring
from tests.benchmarks import ENVS, claims, env_claims, env_physics
from tests.benchmarks.env_claims import Setting, claim_table, episodes, physics_table
from tests.benchmarks.env_physics import held_actions, is_finite, make_env, strain, warnings
from tests.benchmarks.scores import simulator_score
from tests.benchmarks.tables import Row


class Line:
    """Truth of a rope along x, one metre long."""

    def truth(self, n):
        return np.column_stack([np.linspace(0, 1, n), np.zeros((n, 2))])


class Circle:
    """Truth of a band of radius one, from (1, 0, 0)."""

    def truth(self, n):
        angle = 2 * np.pi * np.arange(n) / n
        return np.column_stack([np.cos(angle), np.sin(angle), np.zeros(n)])


class Sheet:
    """Truth of a flat sheet, one metre by two."""

    def truth(self, rows, cols):
        down, across = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 2, cols), indexing="ij")
        return np.column_stack([across.ravel(), -down.ravel(), np.zeros(down.size)])


ALL = np.ones(32, bool)


@pytest.mark.parametrize(
    ("layout", "simulator", "truth"),
    [
        (Chain(11), Line(), Line().truth(11)),
        (Ring(32), Circle(), Circle().truth(32)),
        (Grid(4, 8), Sheet(), Sheet().truth(4, 8)),
    ],
    ids=["chain", "ring", "grid"],
)
def test_points_where_they_belong_have_no_error(layout, simulator, truth):
    found = simulator_score(truth, ALL[: len(truth)], layout, simulator)
    assert found.mm == pytest.approx(0, abs=1e-9)
    assert found.slip == pytest.approx(0, abs=1e-6)
    assert not found.flipped
    assert simulator_score(truth + (0, 0, 0.002), ALL[: len(truth)], layout, simulator).mm == pytest.approx(2)


def test_a_slip_is_measured_along_the_material_and_counts_only_for_valid_points():
    points = Line().truth(11)
    points[3, 0] += 0.06  # six tenths of a gap along the rope
    points[5, 1] += 0.06  # and six tenths away from it, which is no slip
    valid = np.ones(11, bool)
    assert simulator_score(points, valid, Chain(11), Line()).slip == pytest.approx(0.6, abs=0.02)
    valid[3] = False
    assert simulator_score(points, valid, Chain(11), Line()).slip == pytest.approx(0, abs=0.02)
    beyond = Line().truth(11)
    beyond[0, 0] = -0.07
    assert simulator_score(beyond, np.ones(11, bool), Chain(11), Line()).slip == pytest.approx(0.7, abs=0.02)


def test_a_ring_that_begins_elsewhere_slips_and_a_sheet_does_in_both_directions():
    shifted = np.roll(Circle().truth(32), 1, axis=0)
    assert simulator_score(shifted, ALL, Ring(32), Circle()).slip == pytest.approx(1, abs=0.02)
    for axis, gap in ((0, 2 / 7), (1, 1 / 3)):
        points = Sheet().truth(4, 8)
        points[:, axis] += 0.7 * gap
        assert simulator_score(points, ALL, Grid(4, 8), Sheet()).slip == pytest.approx(0.7)


@pytest.mark.parametrize(
    ("points", "layout", "simulator"),
    [
        (Line().truth(11)[::-1], Chain(11), Line()),
        (np.roll(Circle().truth(32)[::-1], 1, axis=0), Ring(32), Circle()),
        (Sheet().truth(4, 8)[::-1], Grid(4, 8), Sheet()),
        (Sheet().truth(4, 8).reshape(4, 8, 3)[:, ::-1].reshape(32, 3), Grid(4, 8), Sheet()),
    ],
    ids=["chain", "ring", "turned sheet", "mirrored sheet"],
)
def test_points_that_are_numbered_otherwise_are_flipped(points, layout, simulator):
    assert simulator_score(points, ALL[: len(points)], layout, simulator).flipped


@pytest.mark.parametrize("name", ENVS)
def test_the_physics_is_sound_at_the_start(name):
    env = make_env(name, {"render_observation": False})
    simulator: Any = env.unwrapped
    env.reset(seed=0, options={"goal": simulator.truth()})
    assert is_finite(simulator)
    assert warnings(simulator) == 0
    whole, local = strain(simulator)
    assert -0.05 < whole <= local < 0.15
    env.close()


def test_actions_are_held():
    actions = held_actions(np.random.default_rng(0), (6,), 20, 8)
    assert actions.shape == (20, 6)
    assert np.array_equal(actions[:8], np.tile(actions[0], (8, 1)))
    assert not np.array_equal(actions[7], actions[8])


@pytest.fixture(scope="module")
def clean():
    """Return two short episodes of each environment."""
    every = [Setting(env, "d455", "clean", "auto") for env in ENVS]
    return env_claims.all_episodes(every, (0, 1), steps=6)


def test_every_frame_is_accounted_for(clean):
    assert [(each.env, each.frames) for each in clean] == [(env, 7) for env in ENVS for _ in range(2)]
    for each in clean:
        # A frame may be both: folded frames are never judged.
        assert each.frames - each.not_ok - each.folded <= len(each.mm) <= each.frames - each.folded
        assert {*each.held_mm} <= {*each.mm}
        assert (each.broken, each.warnings) == (0, 0)


def test_the_claims_hold_on_ropes_and_bands(clean):
    for row in claim_table(clean):
        if row.env != "Cloth":
            assert row["mean_mm"] <= 3
            assert (row["slips"], row["flips"], row["not_ok"]) == (0, 0, 0)


@pytest.mark.parametrize("condition", ["noise", "randomised", "randomised, no hand"])
def test_noise_and_randomised_scenes_are_looked_at_too(condition):
    setting = Setting("Cable", "rl", condition, "rays")
    (found,) = episodes(setting, [0], steps=3)
    assert found.frames == 4
    assert claim_table([found])[0]["condition"] == condition
    assert found.mm
    assert max(found.mm) < 20


def test_goals_are_as_far_as_they_are_said_to_be_and_are_reached():
    for difficulty, farthest in (("near", 50), ("middle", 100)):
        found = env_physics.goals("Cable", difficulty, (0, 1))
        assert found.episodes == 2
        assert 0 < found.start_mm <= found.farthest_mm <= farthest
        assert found.played_mm <= found.worst_played_mm < 5


def test_the_command_reports_points_physics_goals_and_targets(capsys, monkeypatch):
    monkeypatch.setattr(claims, "ENVS", ("Cable",))
    monkeypatch.setattr(
        env_claims, "settings", lambda renderer: [Setting("Cable", "d455", how, renderer) for how in ("clean", "noise")]
    )
    monkeypatch.setattr(env_physics, "DIFFICULTIES", ("near",))
    monkeypatch.setattr(env_claims.episodes, "__defaults__", (4,))
    monkeypatch.setattr(env_claims.all_episodes, "__defaults__", (1, 4, lambda text: None))
    with pytest.raises(SystemExit) as stop:
        main(["bench", "claims", "--only", "envs", "--share", "0.01", "--json"])
    captured = capsys.readouterr()
    assert stop.value.code == 0
    points, physics, goals, asked = json.loads(captured.out).values()
    assert [(row["condition"], row["episodes"], row["frames"]) for row in points] == [
        ("clean", 2, 10),
        ("noise", 2, 10),
    ]
    assert [(row["env"], row["episodes"], row["states"]) for row in physics] == [("Cable", 4, 20)]
    assert [(row["difficulty"], row["episodes"]) for row in goals] == [("near", 1)]
    assert len(asked) == 2 * 2 + 2 + 2
    assert {row["reached"] for row in asked} <= {"yes", "no"}
    assert all(math.isfinite(row["seen"]) for row in asked)


def test_shares_are_of_all_frames_and_all_episodes():
    (one,) = episodes(Setting("Cable", "rl", "clean", "rays"), [0], steps=1)
    two = Row(one, mm=[], held_mm=[], slips=1, not_ok=1, folded=1, worst_slip=0.7)
    (row,) = claim_table([one, two])
    assert (row["episodes_with_slips_percent"], row["not_ok_percent"], row["folded_percent"]) == (50, 25, 25)
    assert row["worst_slip"] == 0.7
    assert row["mean_mm"] == row["found_mean_mm"] == pytest.approx(np.mean(one.mm))
    assert claim_table([two])[0]["mean_mm"] is None
    assert physics_table([one, two])[0]["states"] == 4


def test_the_number_of_jobs_is_checked(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["bench", "claims", "--only", "envs", "--jobs", "0"])
    assert stop.value.code == 2
    assert "--jobs: expected at least 1, got 0" in capsys.readouterr().err
