"""``shape-obs bench speed`` reports each stage at each size, as a table and as JSON."""

from __future__ import annotations

import importlib.util
import json

import pytest

from shape_obs.bench.report import as_csv, machine, markdown_table
from shape_obs.cli import main

IMAGE_STAGES = ["mask to points", "image to points", "image and depth to 3D points"]


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[object, str, str]:
    with pytest.raises(SystemExit) as end:
        main(["bench", *arguments])
    out, err = capsys.readouterr()
    return end.value.code, out, err


def test_every_stage_is_timed_at_every_size(capsys: pytest.CaptureFixture[str]):
    sizes = ["84x84", "160x120"]
    code, out, _ = run(capsys, "speed", "--frames", "4", "--sizes", *sizes, "--json")
    document = json.loads(out)
    stages = document["stages"]
    assert code == 0
    env_stages = ["step of Cable", "step of Cable with ShapeObservation"]
    images = ["84 x 84", "160 x 120"]
    expected = [(what, image) for image in images for what in IMAGE_STAGES]
    expected += [(what, image) for image in images for what in env_stages]
    assert [(row["what"], row["image"]) for row in stages] == expected
    assert all(0 < row["median_ms"] <= row["p99_ms"] for row in stages)
    assert all(row["refused"] == 0 for row in stages)
    assert (document["frames"], document["clock"], document["missing"]) == (4, "wall", "")
    assert document["machine"] == machine()


def test_without_the_simulator_it_says_what_to_install(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    found = importlib.util.find_spec
    monkeypatch.setattr("shape_obs.cli.bench.speed.find_spec", lambda name: None if name == "mujoco" else found(name))
    code, out, _ = run(capsys, "speed", "--frames", "2", "--sizes", "160x120")
    lines = out.splitlines()
    assert code == 0
    assert [line.split(" | ")[0].strip("| ") for line in lines if line.startswith("|")][2:] == IMAGE_STAGES
    assert lines[-1].startswith("simulated steps were not timed, since MuJoCo is not installed: ")
    assert '".[sim]"' in lines[-1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["speed", "--frames", "0"], "--frames: expected at least 1, got 0"),
        (["speed", "--sizes", "5x5"], "invalid choice"),
        (["speed", "--envs", "Sea"], "invalid choice"),
        (["table", "--frames", "9"], "--frames: expected at least 10, got 9"),
        (["table", "--only", "nonsense"], "invalid choice"),
        (["table", "--clock", "sun"], "invalid choice"),
        (["tabel"], "unknown measurement 'tabel'; did you mean 'table'?"),
    ],
)
def test_wrong_options_are_wrong_usage(capsys: pytest.CaptureFixture[str], arguments: list[str], message: str):
    code, out, err = run(capsys, *arguments)
    assert (code, out) == (2, "")
    assert message in " ".join(err.split())


def test_tables_are_aligned_and_csv_keeps_every_digit():
    rows = [{"name": "a", "ms": 1.23456, "n": 3}, {"name": "longer", "ms": 12.0, "n": 12345}]
    assert markdown_table(rows).splitlines() == [
        "| name   | ms   | n     |",
        "| ------ | ---- | ----- |",
        "| a      | 1.23 | 3     |",
        "| longer | 12   | 12345 |",
    ]
    assert as_csv(rows) == "name,ms,n\na,1.23456,3\nlonger,12.0,12345\n"
