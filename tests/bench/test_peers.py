"""`shape-obs bench peers`: all installed peers take part, and missing ones are reported. No test depends on times."""

import json
import math
import sys
from contextlib import redirect_stdout
from io import StringIO

import cv2
import numpy as np
import pytest

from shape_obs.cli import main
from shape_obs.utils.threads import one_thread
from tests.benchmarks.interleaved_timing import Method, Timing, Turn, interleaved_timing, median_ms
from tests.benchmarks.peers import COLD, PEERS, TARGETS, WARM, spread, times_slower
from tests.benchmarks.scenes.streams import cloths, ropes

pytestmark = pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")


def run(capsys, *arguments):
    """Return what the command prints to stdout if it succeeds."""
    with pytest.raises(SystemExit) as stop:
        main(["bench", "peers", *map(str, arguments)])
    assert stop.value.code == 0
    return capsys.readouterr().out


@pytest.fixture(scope="module")
def document():
    arguments = ["bench", "peers", "--only", "rope", "contour", "--frames", "2", "--slow-frames", "1", "--json"]
    with redirect_stdout(StringIO()) as printed, pytest.raises(SystemExit):
        main(arguments)
    return json.loads(printed.getvalue())


@pytest.mark.parametrize("work", ["rope", "contour"])
def test_everyone_who_is_installed_takes_part_with_finite_figures(document, work):
    rows = {row["method"]: row for row in document["works"][work]["rows"]}
    mine = {WARM, COLD}
    installed = {peer.name for peer in PEERS if work in peer.works and peer.load() is not None}
    assert set(rows) == mine | installed
    assert len(installed) >= 6
    slow = {peer.name for peer in PEERS if peer.slow}
    for name, row in rows.items():
        assert row["frames"] == (1 if name in slow else 2)
        figures = [row[key] for key in ("median_ms", "over_ours", "sc", "ch", "spacing_cv")]
        assert all(math.isfinite(figure) for figure in figures), name
        assert row["median_ms"] > 0
    assert document["works"][work]["refused"] == 0
    assert rows[WARM]["over_ours"] == 1
    assert rows[WARM]["spacing_cv"] < 0.01 < rows["K-means, n_init 1"]["spacing_cv"]


def test_targets_are_compared_with_the_results(document):
    asked = {row["what"]: row for row in document["claims"]}
    for work, start, peer, bound in TARGETS:
        row = asked[f"{work}, {start.removeprefix('shape_obs, ')}: times faster than {peer}"]
        assert row["asked"] == f">= {bound}x"
        if work == "cloth":
            assert (row["seen"], row["reached"]) == (None, "not measured")
        else:
            assert row["reached"] == ("yes" if row["seen"] >= bound else "no")
    assert asked["contour: Calinski-Harabasz relative to K-means, n_init 10"]["seen"] > 0.9


def test_what_is_not_installed_is_left_out_and_reported(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "minisom", None)
    out = run(capsys, "--only", "contour", "--frames", 1, "--slow-frames", 0)
    assert "minisom is not installed and left out: pip install minisom" in out
    table, asked = out.split("asked and seen")
    assert "minisom, 1000 iterations" not in table
    assert "K-means, n_init 1 " in table
    assert "n_init 10" not in table
    assert "rope, warm: times faster than minisom, 1000 iterations" in asked


def test_ratios_are_over_the_frames_of_both():
    often = [Turn(1, "often", 1.0, None), Turn(2, "often", 2.0, None), Turn(3, "often", 30.0, None)]
    assert times_slower([Turn(2, "rare", 8.0, None)], often) == 4
    assert median_ms(often) == 2


def test_frames_of_the_warm_up_run_but_do_not_count():
    ran, done = [], []
    timing = Timing(burst=2, tick=lambda: done.append(1))
    turns = interleaved_timing("xyz", [Method("a", ran.append)], timing, warm_up=1)
    assert [turn.frame for turn in turns] == [1, 2]
    assert (ran, len(done)) == (["x", "y", "z"], 3)


def test_all_run_on_every_frame_and_who_begins_changes():
    methods = [Method(name, lambda frame, name=name: f"{name}{frame}") for name in "abc"]
    assert [turn.result for turn in interleaved_timing("xy", methods, Timing())] == ["ax", "bx", "cx", "by", "cy", "ay"]
    assert [turn.frame for turn in interleaved_timing("x", methods, Timing(clock="thread"))] == [0, 0, 0]
    drawn = [turn.result for turn in interleaved_timing("xy", methods, Timing(seed=1), shuffled=True)]
    assert sorted(drawn) == ["ax", "ay", "bx", "by", "cx", "cy"]
    assert drawn == [turn.result for turn in interleaved_timing("xy", methods, Timing(seed=1), shuffled=True)]


def test_threads_are_given_back():
    before = cv2.getNumThreads()
    with one_thread():
        assert cv2.getNumThreads() == 1
    assert cv2.getNumThreads() == before


def test_objects_have_the_documented_sizes():
    masks = [rope.mask for rope in ropes(3, 0)]
    assert all(7_000 <= np.count_nonzero(mask) <= 9_000 for mask in masks)
    assert not any(mask[[0, -1]].any() or mask[:, [0, -1]].any() for mask in masks)
    assert all(37_000 <= np.count_nonzero(sheet.mask) <= 43_000 for sheet in cloths(3, 0))


def test_points_are_spread_evenly_along_a_path():
    corner = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0]])
    assert np.allclose(spread(corner, 4), [[1, 0], [3, 0], [4, 1], [4, 3]])
    square = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    assert np.allclose(spread(square, 4, closed=True), square)
