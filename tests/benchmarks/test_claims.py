"""Claims at a tiny share, against their limits; and the runner: limits, exit codes, the file of results, pages."""

from __future__ import annotations

import json
import re

import pytest

from tests.benchmarks import runner
from tests.benchmarks.claim import Claim, Effort, Limit
from tests.benchmarks.runner import all_claims, main, misses, run
from tests.benchmarks.tables import Row, total

CLAIMS = all_claims()


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
def test_a_sample_keeps_the_limits_except_those_of_times(name, share, seed):
    outcome = run(CLAIMS[name], Effort(share, seed))
    assert outcome.missing or outcome.rows
    assert [each for each in misses(outcome) if each.met == "no" and not each.required.endswith((" ms", " x"))] == []


def test_every_claim_has_a_limit():
    assert [name for name, claim in CLAIMS.items() if not claim.limits] == []


class TestRunner:
    """The runner, with claims about numbers."""

    @pytest.fixture
    def command(self, monkeypatch, tmp_path):
        """Return a function that runs the command on claims with some limits, and keeps the results in a file."""

        def command(*argv: str, **limits: Limit) -> int:
            claims = {
                f"numbers.{name}": Claim(
                    f"numbers.{name}",
                    "Numbers.",
                    lambda effort: range(effort.count(10)),
                    lambda n: Row(kind=n % 2, off=n),
                    ("kind",),
                    {"off": total("off"), "none": lambda rows: None},
                    total=True,
                    limits=(limit,),
                )
                for name, limit in limits.items()
            }
            monkeypatch.setattr("tests.benchmarks.runner.all_claims", lambda: claims)
            return main([*argv, "--out", str(tmp_path / "results.json")])

        return command

    @pytest.mark.parametrize(
        ("limit", "share", "code"),
        [
            (Limit("off", at_most=45), "1", 0),
            (Limit("off", at_most=44), "1", 1),
            (Limit("off", at_least=21), "1", 1),
            (Limit("off", at_most=25, where={"kind": (0, 1)}), "1", 0),
            (Limit("off", at_most=44, known="numbers grow"), "1", 0),
            (Limit("none", at_most=0), "1", 1),
            (Limit("off", at_most=1, sampled=10), ".5", 0),
            (Limit("off", at_most=1, sampled=9), ".5", 1),
            (Limit("off", at_most=1, sampled=1000), "1", 1),
        ],
    )
    def test_a_missed_limit_fails_the_run_unless_it_is_known(self, command, capsys, limit, share, code):
        assert command("--share", share, limited=limit) == code
        out = capsys.readouterr().out
        assert ("missed:" in out) == bool(code)
        assert limit.known in out

    def test_a_partial_run_changes_only_its_claims_and_a_page_shows_all(self, command, tmp_path):
        limits = {"one": Limit("off", at_most=45), "two": Limit("off", at_most=45)}
        command("--share", "0.5", **limits)
        command("numbers.two", "--seed", "4", **limits)
        results = json.loads((tmp_path / "results.json").read_text())
        one, two = results["claims"].values()
        assert (one["share"], one["seed"], two["share"], two["seed"]) == (0.5, 0, 1.0, 4)
        assert two["rows"][-1] == {"kind": "all", "off": 45, "none": None}
        assert {"python", "numpy", "processor"} <= set(results["machine"])
        page = tmp_path / "page.md"
        command("--page", str(page))
        command("numbers.one", "--share", "0.2", **limits)
        page.write_text(f"Words before.\n{page.read_text()}Words after.\n")
        command("--page", str(page))
        found = re.findall(r"\| all +\| \d+|Share [\d.]+|Words \w+", page.read_text())
        assert found == ["Words before", "| all  | 1", "Share 0.2", "| all  | 45", "Share 1", "Words after"]

    def test_a_wrong_name_is_an_error(self, command, capsys):
        with pytest.raises(SystemExit) as stop:
            command("letters", one=Limit("off", at_most=45))
        assert stop.value.code == 2
        assert "no claim or group 'letters'; the groups are numbers" in capsys.readouterr().err

    def test_json_and_list(self, command, capsys):
        command("--json", one=Limit("off", at_most=45))
        assert json.loads(capsys.readouterr().out)["numbers.one"]["rows"][0]["off"] == 20
        command("--list", one=Limit("off", at_most=45))
        assert capsys.readouterr().out.split()[:2] == ["numbers.one", "Numbers."]

    def test_claims_run_in_several_processes(self):
        some = [CLAIMS["outlines.garments"], CLAIMS["outlines.cold"]]
        found = dict(runner.run_all(some, Effort(0.01), jobs=2))
        assert found["outlines.garments"].rows == []
        assert found["outlines.cold"].rows == run(CLAIMS["outlines.cold"], Effort(0.01)).rows
