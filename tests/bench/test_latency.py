"""`shape-obs bench latency`: stages, growth, memory. No test depends on times."""

import json
import math

import pytest

from shape_obs.cli import main
from tests.benchmarks.interleaved_timing import Timing
from tests.benchmarks.latency import (
    AREAS,
    CLASSIC,
    CLOTH,
    COLD,
    COUNTS,
    NUMBER,
    ONE_PASS,
    POINTS,
    ROPE,
    WARM,
    memory_growth,
    resident,
)


def run(capsys, *arguments):
    """Return (exit code, stdout, stderr) of the command."""
    with pytest.raises(SystemExit) as stop:
        main(["bench", "latency", *map(str, arguments)])
    captured = capsys.readouterr()
    return stop.value.code, captured.out, captured.err


def test_every_stage_is_reported_at_every_size(capsys):
    code, out, _ = run(
        capsys, "--only", "stages", "--frames", 2, "--sizes", "320x240", "640x480", "--memory", 5, "--json"
    )
    document = json.loads(out)
    mine = [WARM, COLD]
    assert code == 0
    assert {(row["image"], row["method"]) for row in document["totals"]} == {
        (image, method) for image in ("320 x 240", "640 x 480") for method in (ONE_PASS, CLASSIC, *mine)
    }
    for row in document["totals"]:
        assert 0 < row["median_ms"] <= row["p95_ms"]
        assert row["refused"] == 0
    assert [row["method"] for row in document["stages"]] == mine * 2
    for row in document["stages"]:
        assert row["total"] > 0
        assert row["fit"] > 0
    asked = {row["what"]: row for row in document["claims"]}
    passes = asked["640 x 480 image to 20 points in 3D, warm: times one pass over the image"]
    (seen,) = (row["passes"] for row in document["totals"] if (row["image"], row["method"]) == ("640 x 480", WARM))
    assert passes["seen"] == pytest.approx(seen)
    assert passes["reached"] == ("yes" if seen <= 6 else "no")
    assert asked["1280 x 800 against 640 x 480, warm"]["reached"] == "not measured"
    assert document["memory"][0]["frames"] == 5


def test_growth_is_reported_for_pixels_points_and_shapes(capsys):
    code, out, _ = run(capsys, "--only", "growth", "--frames", 1, "--json")
    document = json.loads(out)
    rows = document["growth"]
    amounts = {
        grows: [row["amount"] for row in rows if row["grows"] == grows] for grows in (ROPE, CLOTH, POINTS, NUMBER)
    }
    assert code == 0
    assert len(rows) == 2 * len(AREAS) + len(COUNTS) + 3
    assert amounts[POINTS] == [*COUNTS]
    assert amounts[NUMBER] == [1, 2, 3]
    for grows in (ROPE, CLOTH):
        assert amounts[grows][-1] == pytest.approx(10 * amounts[grows][0], rel=0.1)
    assert all(math.isfinite(row["times_smallest"]) for row in document["growth"])
    asked = document["claims"]
    assert [row["asked"] for row in asked] == ["<= 2x", "<= 2x", "<= 1.5x", "<= 2.5x"]
    assert all(row["reached"] in ("yes", "no") for row in asked)


def test_frame_after_frame_the_process_does_not_grow():
    if resident() is None:
        pytest.skip("the system does not report the size of a process")
    grown = memory_growth(2_000, Timing(), warm_up=300)
    assert grown is not None
    assert grown < 5


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--frames", 0], "--frames: expected at least 1, got 0"),
        (["--memory", -1], "--memory: expected at least 0, got -1"),
        (["--sizes", "640"], "--sizes: expected WIDTHxHEIGHT of at least 64 pixels each, such as 640x480, got '640'"),
    ],
)
def test_bad_arguments_get_one_clear_line(capsys, arguments, message):
    code, out, err = run(capsys, *arguments)
    assert (code, out) == (2, "")
    assert message in err
    assert len(err.strip().splitlines()) == 1
