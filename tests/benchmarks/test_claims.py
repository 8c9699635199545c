"""Claims at a tiny share, against their limits; and the runner: limits, exit codes, the file of results, pages."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from tests.benchmarks import runner
from tests.benchmarks.__main__ import main
from tests.benchmarks.claim import Claim, Effort, Limit
from tests.benchmarks.runner import all_claims, misses, run
from tests.benchmarks.scenes.moving_ropes import Motion, moving_ropes
from tests.benchmarks.tables import Row, total

CLAIMS = all_claims()


def missed(claim: Claim, effort: Effort) -> list[Row]:
    """Return the limits that a sample does not keep, except those of times: the machine is busy with other tests."""
    outcome = run(claim, effort)
    assert outcome.missing or outcome.rows
    return [limit for limit in misses(outcome) if limit.ok == "no" and not limit.asked.endswith((" ms", " x"))]


@pytest.mark.parametrize(
    ("name", "share", "seed"),
    [
        ("ropes.cold", 0.03, 3),
        ("ropes.tangled", 0.01, 12),
        ("ropes.noise", 0.02, 3),
        ("outlines.cold", 0.2, 5),
        ("sheets.cold", 0.25, 3),
        ("clouds.cold", 0.06, 0),
        ("clouds.tilted", 0.1, 0),
        ("several.above", 0.01, 0),
        ("calibration.touches", 0.1, 0),
    ],
)
def test_a_sample_keeps_the_limits(name, share, seed):
    assert missed(CLAIMS[name], Effort(share, seed)) == []


def test_points_keep_their_identity_under_a_hand_and_at_a_border():
    common = {"approach": 8.0, "speed": 3.0, "seed": 1}
    scenes = [{"cover": cover, "depth": depth, **common} for cover, depth in (("hand", False), ("border", True))]
    assert missed(replace(CLAIMS["hidden.covered"], scenes=lambda effort: scenes), Effort()) == []


def test_ropes_that_cross_and_touch_keep_their_slots():
    chosen: tuple[tuple[Motion, int, int], ...] = (("crossing", 15, 100), ("touching", 26, 60))
    scenes = [(kind, moving_ropes(np.random.default_rng([seed, 3]), 3, n, kind=kind)) for kind, seed, n in chosen]
    outcome = run(replace(CLAIMS["several.moving"], scenes=lambda effort: scenes), Effort())
    whole = outcome.rows[-1]
    assert (whole["kind"], whole["swaps"], whole["flips"]) == ("all", 0, 0)
    assert whole["slips [%]"] <= 2


@pytest.mark.parametrize(
    ("name", "which"),
    [("outlines.turning", 2), ("sheets.hands.mask", 5), ("outlines.space.noisy", 5)],
)
def test_one_track_keeps_its_points(name, which):
    claim = CLAIMS[name]
    one = replace(claim, scenes=lambda effort: islice(claim.scenes(effort), which, which + 1))
    assert missed(one, Effort(0.01)) == []


def test_every_claim_has_a_limit_except_the_times_of_registration():
    assert [name for name, claim in CLAIMS.items() if not claim.limits] == ["calibration.time"]


class TestRunner:
    """The runner, with claims about numbers."""

    @pytest.fixture
    def made(self, monkeypatch, tmp_path):
        """Return a function that runs the command on claims with some limits, and the file of results."""
        path = tmp_path / "results.json"

        def command(*argv: str, **limits: Limit) -> int:
            def claim(name: str, limit: Limit) -> Claim:
                return Claim(
                    f"numbers.{name}",
                    "Numbers.",
                    lambda effort: range(effort.count(10)),
                    lambda n: Row(kind=n % 2, off=n),
                    ("kind",),
                    {"off": total("off"), "none": lambda rows: None},
                    total=True,
                    limits=(limit,),
                )

            claims = {f"numbers.{name}": claim(name, limit) for name, limit in limits.items()}
            monkeypatch.setattr("tests.benchmarks.__main__.all_claims", lambda: claims)
            return main([*argv, "--out", str(path)])

        return command, path

    @pytest.mark.parametrize(
        ("limit", "code"),
        [
            (Limit("off", at_most=45), 0),
            (Limit("off", at_most=44), 1),
            (Limit("off", at_least=21), 1),
            (Limit("off", at_most=25, where={"kind": (0, 1)}), 0),
            (Limit("off", at_most=44, known="numbers grow"), 0),
            (Limit("off", at_most=45, known="numbers grow"), 0),
            (Limit("none", at_most=0), 1),
        ],
    )
    def test_a_missed_limit_fails_the_run_unless_it_is_known(self, made, capsys, limit, code):
        command, _ = made
        assert command(limited=limit) == code
        out = capsys.readouterr().out
        assert ("missed:" in out) == bool(code)
        assert ("known, but met now" in out) == (limit.at_most == 45 and bool(limit.known))

    def test_a_limit_may_have_another_bound_at_a_reduced_share(self, made):
        command, _ = made
        assert command("--share", "0.5", limited=Limit("off", at_most=1, sampled=10)) == 0
        assert command("--share", "0.5", limited=Limit("off", at_most=1, sampled=9)) == 1
        assert command(limited=Limit("off", at_most=1, sampled=1000)) == 1

    def test_a_partial_run_changes_only_its_claims(self, made):
        command, path = made
        limits = {"one": Limit("off", at_most=45), "two": Limit("off", at_most=45)}
        command("--share", "0.5", **limits)
        command("numbers.two", "--seed", "4", **limits)
        found = json.loads(path.read_text())["claims"]
        assert [(name, each["share"], each["seed"]) for name, each in found.items()] == [
            ("numbers.one", 0.5, 0),
            ("numbers.two", 1.0, 4),
        ]
        assert found["numbers.two"]["rows"][-1] == {"kind": "all", "off": 45, "none": None}
        assert {"python", "numpy", "processor"} <= set(json.loads(path.read_text())["machine"])

    def test_a_wrong_name_is_an_error(self, made, capsys):
        command, _ = made
        with pytest.raises(SystemExit) as stop:
            command("letters", one=Limit("off", at_most=45))
        assert stop.value.code == 2
        assert "no claim or group 'letters'; the groups are numbers" in capsys.readouterr().err

    def test_pages_are_filled_between_their_marks(self, made, tmp_path):
        command, path = made
        command(one=Limit("off", at_most=45))
        page = tmp_path / "page.md"
        marks = "<!-- table: numbers.one -->\nold\n<!-- end -->\n<!-- table: numbers.two -->\n<!-- end -->\n"
        page.write_text(f"Before\n{marks}")
        assert runner.write_page(page, json.loads(path.read_text())) == ["numbers.one"]
        text = page.read_text()
        assert "| all | 45 |" in text
        assert "old" not in text
        assert text.startswith("Before\n")
        new = tmp_path / "new.md"
        assert runner.write_page(new, json.loads(path.read_text())) == ["numbers.one"]
        assert "## numbers.one" in new.read_text()

    def test_json_and_list(self, made, capsys):
        command, _ = made
        command("--json", one=Limit("off", at_most=45))
        assert json.loads(capsys.readouterr().out)["numbers.one"]["rows"][0]["off"] == 20
        command("--list", one=Limit("off", at_most=45))
        assert capsys.readouterr().out.split()[:2] == ["numbers.one", "Numbers."]

    def test_claims_run_in_several_processes(self):
        some = [CLAIMS["outlines.garments"], CLAIMS["outlines.cold"]]
        found = {claim.name: outcome for claim, outcome in runner.run_all(some, Effort(0.01), jobs=2)}
        assert found["outlines.garments"].rows == []
        assert found["outlines.cold"].rows == run(CLAIMS["outlines.cold"], Effort(0.01)).rows
