"""Two libraries compared track by track: what is worse, better or equal, and what cannot be compared."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from tests.benchmarks import gates
from tests.benchmarks.claim import Claim, Effort, Limit
from tests.benchmarks.gates import compare, gate, gates_of, main, measured
from tests.benchmarks.runner import all_claims
from tests.benchmarks.tables import Column, Row, failures, percent, total

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


def test_few_tracks_give_no_verdict():
    found = [gate(tracks(0.0, 1, count), tracks(0.5, 2, count), SLIPS, False).verdict for count in (1, 5, 6)]
    assert found == ["few", "few", "worse"]


def test_a_value_that_is_lost_is_worse():
    none = [[Row(slips=0, ok=0)] for _ in range(3)]
    mean = lambda rows: None if not sum(row.ok for row in rows) else 0.0  # noqa: E731
    assert gate(tracks(0.0, 1, 3), none, mean, False).verdict == "worse"
    assert gate(none, tracks(0.0, 1, 3), mean, False).verdict == "better"
    assert gate(none, none, mean, False).verdict == "-"


def claim(name: str = "a.b", columns: Mapping[str, Column] | None = None) -> Claim:
    """Return a claim about slips in ten tracks, whose table may have further columns."""

    def measure(seed: int) -> Row:
        return Row(cover="hand", slips=seed % 3, ok=50, frames=80)

    every = {"frames": total("frames"), "slips [%]": SLIPS, **(columns or {})}
    limits = (Limit("slips [%]", at_most=1),)
    return Claim(name, "", lambda effort: range(effort.count(10)), measure, ("cover",), every, limits=limits)


def test_each_group_has_its_tracks_and_frames():
    rows = [[Row(cover=cover, slips=1, ok=50, frames=80)] for cover in ("hand", "bar", "hand")]
    found = list(gates_of(claim(), rows, rows))
    assert [(row.scenes, row.tracks, row.frames, row.column) for row in found] == [
        ("cover hand", 2, 160, "slips [%]"),
        ("cover bar", 1, 80, "slips [%]"),
    ]


@pytest.mark.parametrize(
    ("columns", "ok"),
    [
        ({"ok [%]": percent("ok", "frames")}, (90, 80)),
        ({"refused [%]": percent("refused", "frames")}, (90, 80)),
        ({"refused": total("refused")}, (90, 80)),
        ({}, (None, None)),
    ],
)
def test_each_row_says_how_many_frames_are_ok(columns, ok):
    before, now = ([[Row(cover="hand", slips=1, ok=ok, refused=50 - ok, frames=50)]] for ok in (45, 40))
    assert [(row.ok_before, row.ok_now) for row in gates_of(claim(columns=columns), before, now)] == [ok]


def test_frames_without_a_count_are_one_each():
    rows = [[Row(cover="hand", slips=0, ok=ok)] for ok in (True, True, True, False)]
    assert [row.ok_now for row in gates_of(claim(columns={"refused": failures("ok")}), rows, rows)] == [75]


def test_other_scenes_are_not_compared():
    rows = [[Row(cover=cover, slips=1, ok=50)] for cover in ("hand", "bar")]
    with pytest.raises(ValueError, match="scenes differ"):
        list(gates_of(claim(), rows, rows[:1]))


class TestCommand:
    """The command, with claims about numbers that each library measures at once."""

    @pytest.fixture
    def command(self, monkeypatch):
        """Return a function that compares two libraries, of which one may slip more, or fail in a claim."""

        def command(*argv: str, more: int = 0, failing: str = "", error: type[BaseException] = RuntimeError) -> int:
            claims = {name: claim(name) for name in ("a.first", "a.second", "b.third")}

            def compare(pythons: object, claim: Claim, effort: Effort) -> list[Row]:
                if claim.name == failing:
                    raise error("no library")
                before, now = measured(claim, effort), measured(claim, effort)
                for rows in now:
                    rows[0]["slips"] += more
                return list(gates_of(claim, before, now))

            monkeypatch.setattr(gates, "python_of", lambda tree: tree)
            monkeypatch.setattr(gates, "all_claims", lambda: claims)
            monkeypatch.setattr(gates, "compare", compare)
            return main(["../before", *argv])

        return command

    def test_each_claim_has_its_table_with_share_and_seed(self, command, capsys):
        assert command("a", "--share", "0.8", "--seed", "7") == 0
        text = capsys.readouterr().out
        assert [line for line in text.splitlines() if line.startswith("## ")] == ["## a.first", "## a.second"]
        assert text.count("equal") == text.count("Share 0.8, seed 7") == 2

    def test_the_exit_code_says_that_a_row_is_worse(self, command):
        assert [command("--share", "1", "--seed", "1", more=more) for more in (0, 1, -1)] == [0, 1, 0]

    def test_a_claim_that_fails_is_named_and_the_next_ones_are_compared(self, command, capsys):
        assert command(more=1, failing="a.second") == 3
        text = capsys.readouterr().out
        assert "a.second: no library" in text
        assert text.count("worse") == 2
        assert text.splitlines()[-1].endswith(": a.second")

    def test_what_was_compared_before_an_interruption_is_shown(self, command, capsys):
        with pytest.raises(KeyboardInterrupt):
            command(failing="a.second", error=KeyboardInterrupt)
        assert capsys.readouterr().out.count("equal") == 1

    def test_a_work_tree_without_an_environment_is_a_wrong_argument(self, tmp_path, capsys):
        with pytest.raises(SystemExit, match="2"):
            main([str(tmp_path), "record.rates"])
        assert "expected a work tree with an environment of its own, .venv" in capsys.readouterr().err


def test_a_library_that_ends_with_an_error_is_not_compared():
    with pytest.raises(RuntimeError, match="could not be measured"):
        compare([Path(sys.executable)] * 2, claim("none.such"), Effort())


@pytest.mark.nightly
def test_the_library_is_equal_to_itself():
    rows = compare([Path(sys.executable)] * 2, all_claims(["record"])["record.rates"], Effort(0.02, 1))
    assert {row.verdict for row in rows} <= {"equal", "-"}
    assert all(row.before == row.now for row in rows)
