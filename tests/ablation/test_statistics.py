"""Figures of few runs: interquartile means, intervals and tables against values known by hand."""

from __future__ import annotations

import numpy as np
import pytest

from shape_obs.ablation import Study
from shape_obs.ablation.report import markdown
from shape_obs.ablation.results import FinishedRun
from shape_obs.ablation.scores import Row, Score
from shape_obs.ablation.statistics import difference, improvement, interval, iqm, summarize
from shape_obs.spec import SpecError


def test_a_quarter_is_left_out_at_either_end():
    assert iqm(np.array([-100.0, 2, 3, 4, 5, 6, 7, 1000])) == 4.5
    assert iqm(np.array([90.0, 80, 100, 0, 70])) == 80.0  # of five runs the middle three
    assert iqm(np.array([1.0, 2, 6])) == 3.0  # of three none is left out


def test_the_interval_is_that_of_the_binomial_distribution():
    # One of three is 1, so means of draws are binomial (3, 1/3) thirds: P(0) = 30 %, P(1) = 4 %, both above 2.5 %.
    assert interval([[0.0, 0.0, 1.0]]) == (pytest.approx(1 / 3), 0.0, 1.0)
    # Of forty, one half: k successes of 40 with 2.5 % on either side lie in 14 ... 26.
    found = interval([[0.0, 1.0] * 20], lambda *strata, axis: np.mean(strata[0], axis=axis))
    assert found.low == pytest.approx(14 / 40, abs=1 / 40)
    assert found.high == pytest.approx(26 / 40, abs=1 / 40)


def test_strata_are_drawn_each_by_itself():
    # Drawn together, the share of tens among the values would vary.
    assert interval([[10.0] * 4, [0.0] * 4], lambda *s, axis: np.mean(np.concatenate(s, axis=axis), axis=axis)) == (
        5.0, 5.0, 5.0,
    )  # fmt: skip


def test_one_run_has_no_interval_and_none_is_refused():
    found = interval([[3.0]])
    assert found.value == 3.0
    assert np.isnan([found.low, found.high]).all()
    with pytest.raises(ValueError, match="at least one value in each stratum"):
        interval([[1.0], []])


def test_two_arms():
    assert improvement(np.array([3.0, 4.0]), np.array([1.0, 4.0])) == pytest.approx((1 + 0 + 1 + 0.5) / 4)
    assert interval([[2.0, 3.0], [0.0, 1.0]], improvement) == (1.0, 1.0, 1.0)
    assert interval([[8.0, 8.0], [5.0, 5.0]], difference) == (3.0, 3.0, 3.0)


@pytest.fixture
def study():
    return Study.from_dict(
        {
            "arms": {"points3d": {}, "truth": {"observation": "truth"}},
            "steps": 300,
            "reference": "truth",
            "evaluation": {"every": 100, "difficulties": ["near", "far"], "disturbances": {"hand": {}}},
        }
    )


def finished(
    arm: str, seed: int, shares: dict[int, tuple[int, int]], hand: tuple[int, int] | None = None
) -> FinishedRun:
    """Return a run that reached so many of ten near and of ten far goals after so many steps."""
    counts = [(steps, "", reached) for steps, reached in shares.items()]
    if hand is not None:
        counts.append((max(shares), "hand", hand))
    rows = [
        Row(steps, disturbance, Score(difficulty, goal, 50.0, 5.0 if goal < count else 20.0, goal < count, 8.0))
        for steps, disturbance, reached in counts
        for difficulty, count in zip(("near", "far"), reached, strict=True)
        for goal in range(10)
    ]
    return FinishedRun(arm, seed, rows, {"ms_per_step": 17.0})


def test_the_figures_of_an_arm(study):
    ours = [finished("points3d", seed, {100: (2, 0), 200: (8, 4), 300: (10, 6)}, hand=(7, 5)) for seed in range(3)]
    theirs = [finished("truth", seed, {100: (5, 5), 200: (10, 9), 300: (10, 10)}) for seed in range(3)]
    summary = summarize(study, [*ours, *theirs])
    ours, theirs = summary["points3d"], summary["truth"]
    assert {name: found.value for name, found in ours.success.items()} == {"near": 100.0, "far": 60.0, "all": 80.0}
    assert ours.final_mm["far"].value == pytest.approx(0.6 * 5 + 0.4 * 20)
    assert ours.steps_to == {"near": (200, 200, 300), "far": (300, None, None), "all": (200, 300, None)}
    assert ours.area["near"].value == pytest.approx((20 / 2 + 80 + 100 / 2) / 2)
    assert ours.lost["hand"].value == pytest.approx((30 + 10) / 2)
    assert not theirs.lost  # it sees no images
    assert ours.difference == (-20.0, -20.0, -20.0)
    assert ours.improvement == (0.25, 0.25, 0.25)  # as good near, worse far
    assert theirs.difference is None


def test_the_tables_say_what_is_not_there(study):
    text = markdown(study, summarize(study, [finished("points3d", 0, {300: (5, 5)})]))
    assert "| points3d | 1 | 50.0 | 50.0 | 50.0 |" in text  # one run has no interval
    assert "| points3d | 300 / – / – |" in text
    assert "truth |" not in text


def test_a_study_that_cannot_be_meant_is_refused():
    for wrong, message in (
        ({"arms": {}}, "arms: expected at least one"),
        ({"arms": {"a/b": {}}}, "a name is also the name of a folder"),
        ({"arms": {"a": {}}, "reference": "b"}, "no arm 'b'"),
        ({"arms": {"a": {"observation": "truth", "noise": {}}}}, "the simulator's points have no noise"),
        ({"arms": {"a": {}}, "her": {}, "algorithm": "PPO"}, "hindsight replay needs one of SAC"),
    ):
        with pytest.raises(SpecError, match=message):
            Study.from_dict(wrong)
