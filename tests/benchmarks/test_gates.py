"""Two libraries compared track by track: what is worse, better or equal, and what cannot be compared."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.benchmarks.claim import Claim, Effort, Limit
from tests.benchmarks.gates import compare, gate, gates_of
from tests.benchmarks.tables import Row, percent, total

SLIPS = percent("slips", "ok")


def tracks(slips: float, seed: int, count: int = 60) -> list[list[Row]]:
    """Return the rows of tracks of 100 frames that slip with a probability."""
    rng = np.random.default_rng(seed)
    return [[Row(slips=int(rng.binomial(100, slips)), ok=100)] for _ in range(count)]


def test_the_same_tracks_are_equal():
    assert gate(tracks(0.02, 1), tracks(0.02, 1), SLIPS, False) == (*[pytest.approx(2.0, abs=0.4)] * 2, 0, 0, "equal")


@pytest.mark.parametrize(("larger_is_better", "verdict"), [(False, "worse"), (True, "better")])
def test_a_difference_beyond_chance_is_found(larger_is_better, verdict):
    found = gate(tracks(0.02, 1), tracks(0.04, 2), SLIPS, larger_is_better)
    assert found.verdict == verdict
    assert found.low is not None
    assert found.high is not None
    assert 0 < found.low < 2 < found.high


def test_chance_is_no_difference():
    """Of 20 pairs of tracks that slip equally often, about one is taken for different."""
    verdicts = [gate(tracks(0.02, k), tracks(0.02, 100 + k), SLIPS, False).verdict for k in range(20)]
    assert verdicts.count("equal") >= 17


def test_one_track_that_differs_is_not_enough():
    before, now = tracks(0.0, 1), tracks(0.0, 1)
    now[0][0]["slips"] = 50
    assert gate(before, now, SLIPS, False).verdict == "equal"


def test_a_value_that_is_lost_is_worse():
    none = [[Row(slips=0, ok=0)] for _ in range(3)]
    mean = lambda rows: None if not sum(row.ok for row in rows) else 0.0  # noqa: E731
    assert gate(tracks(0.0, 1, 3), none, mean, False).verdict == "worse"
    assert gate(none, tracks(0.0, 1, 3), mean, False).verdict == "better"
    assert gate(none, none, mean, False).verdict == "-"


def claim() -> Claim:
    columns = {"frames": total("frames"), "slips [%]": SLIPS}
    return Claim("a.b", "", lambda _: (), Row, ("cover",), columns, limits=(Limit("slips [%]", at_most=1),))


def test_each_group_has_its_tracks_and_frames():
    rows = [[Row(cover=cover, slips=1, ok=50, frames=80)] for cover in ("hand", "bar", "hand")]
    found = list(gates_of(claim(), rows, rows))
    assert [(row.scenes, row.tracks, row.frames, row.column) for row in found] == [
        ("cover hand", 2, 160, "slips [%]"),
        ("cover bar", 1, 80, "slips [%]"),
    ]


def test_other_scenes_are_not_compared():
    rows = [[Row(cover=cover, slips=1, ok=50)] for cover in ("hand", "bar")]
    with pytest.raises(ValueError, match="scenes differ"):
        list(gates_of(claim(), rows, rows[:1]))


def test_a_work_tree_without_an_environment_is_an_error(tmp_path):
    with pytest.raises(ValueError, match=r"expected a work tree with an environment of its own, \.venv"):
        compare(tmp_path, ["record.rates"], Effort(0.01))


@pytest.mark.nightly
def test_the_library_is_equal_to_itself():
    rows = compare(Path(__file__).parents[2], ["record.rates"], Effort(0.02, 1))
    assert {row.verdict for row in rows} <= {"equal", "-"}
    assert all(row.before == row.now for row in rows)
