"""``shape-obs bench speed`` reports each stage at each size, as a table and as JSON."""

from __future__ import annotations

import importlib.util
import json

import pytest

from shape_obs.bench.report import machine
from shape_obs.cli import main

IMAGE_STAGES = ["mask to points", "image to points", "image and depth to 3D points"]
ENV_STAGES = ["step of Cable", "step of Cable with ShapeObservation"]


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[object, str, str]:
    with pytest.raises(SystemExit) as end:
        main(["bench", *arguments])
    out, err = capsys.readouterr()
    return end.value.code, out, err


def test_every_stage_is_timed_at_every_size(capsys: pytest.CaptureFixture[str]):
    code, out, _ = run(capsys, "speed", "--frames", "4", "--sizes", "84x84", "160x120", "--json")
    document = json.loads(out)
    stages, images = document["stages"], ["84 x 84", "160 x 120"]
    expected = [(what, image) for some in (IMAGE_STAGES, ENV_STAGES) for image in images for what in some]
    assert code == 0
    assert [(row["what"], row["image"]) for row in stages] == expected
    assert all(0 < row["median_ms"] <= row["p99_ms"] and row["refused"] == 0 for row in stages)
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
        (["table", "--frames", "9"], "--frames: expected at least 10, got 9"),
        (["tabel"], "unknown measurement 'tabel'; did you mean 'table'?"),
    ],
)
def test_wrong_options_are_wrong_usage(capsys: pytest.CaptureFixture[str], arguments: list[str], message: str):
    code, out, err = run(capsys, *arguments)
    assert (code, out) == (2, "")
    assert message in " ".join(err.split())
