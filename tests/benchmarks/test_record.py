"""Recorded ropes: their truth, their files, and the strict score of the points that a tracker found."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from tests.benchmarks import record_files
from tests.benchmarks.claim import Effort
from tests.benchmarks.record import CLAIMS, SPACING, Claimed, strict_score
from tests.benchmarks.runner import commit_seed, run
from tests.benchmarks.scenes.recorded_ropes import SIZE, Setting, record
from tests.benchmarks.scenes.rope_motion import LENGTH, MOTIONS, NODES, moving_rope
from tests.scenes.hidden_ropes import camera_of

SETTING = Setting("both", "hand", 0.0, 15, 0.5, 2.4, 3)  # 36 frames


class Files(NamedTuple):
    """An exported recording and the points of this library and of the truth."""

    folder: Path
    ours: dict[str, Any]
    truth: dict[str, Any]


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Files:
    folder = tmp_path_factory.mktemp("record")
    short = replace(CLAIMS[0], scenes=lambda effort: [SETTING])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(record_files, "CLAIMS", (short,))
        assert record_files.main(["export", str(folder / "out")]) == 0
    assert record_files.main(["track", str(folder / "out"), str(folder / "ours.json")]) == 0
    ours = json.loads((folder / "ours.json").read_text())
    about = json.loads(next(folder.glob("out/*/recording.json")).read_text())
    nodes = [frame["nodes"] for frame in about["frames"]]
    return Files(folder / "out", ours, {next(iter(ours)): {"exact": nodes, "d455": nodes}})


@pytest.fixture
def scored(files, tmp_path, capsys) -> Callable[[Any], list[dict[str, Any]]]:
    """Return a function that scores points and returns the rows."""

    def scored(points: Any) -> list[dict[str, Any]]:
        (tmp_path / "points.json").write_text(json.dumps(points))
        assert record_files.main(["score", str(files.folder), str(tmp_path / "points.json"), "--json"]) == 0
        return json.loads(capsys.readouterr().out)

    return scored


def changed(points: dict[str, Any], change: Callable[[list[Any]], list[Any]]) -> dict[str, Any]:
    """Return points whose frames are changed."""
    return {name: {depth: change(frames) for depth, frames in kinds.items()} for name, kinds in points.items()}


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_moving_rope_keeps_its_length_and_has_the_speed(motion):
    rope = moving_rope(np.random.default_rng(5), motion, 0.8, 3.0, camera_of(SIZE))
    axis = rope.axis(np.linspace(0, 3, 20))
    np.testing.assert_allclose(np.linalg.norm(np.diff(axis, axis=1), axis=2).sum(axis=1), LENGTH, rtol=1e-9)
    assert rope.peak_speed(3.0) == pytest.approx(0.0 if motion == "static" else 0.8, rel=0.05)


@pytest.mark.parametrize("hider", ["board", "border", "at once"])
def test_a_rope_is_gone_for_the_time(hider):
    frames = list(record(Setting("both", hider, 1.0, 15, 1.0, 3.5, 2)).frames)
    assert frames[0].visible.all()
    assert frames[-1].visible.all()
    assert sum(not frame.visible.any() for frame in frames) / 15 == pytest.approx(1.0, abs=0.25)


def test_nodes_in_sight_lie_on_the_mask_at_their_depth():
    recording = record(SETTING)
    for frame in recording.frames:
        u, v = np.rint(recording.camera.project(frame.nodes[frame.visible])).astype(int).T
        inner = slice(1, -1) if frame.visible.all() else slice(None)  # the tips end on the border of the mask
        on = frame.mask[v, u] > 0
        assert on[inner].mean() > 0.8
        assert np.abs(frame.depth[v, u] - frame.nodes[frame.visible, 2])[on].max() < 2.5 * recording.radius


def test_the_truth_scores_zero_and_our_points_a_few_millimetres(files, scored):
    for row in scored(files.truth):
        assert (row["all [mm]"], row["slips [%]"], row["flips [%]"], row["ok [%]"]) == (0, 0, 0, 100)
    exact, noisy = scored(files.ours)
    assert exact["ok [%]"] > 90
    assert 0.2 < exact["visible [mm]"] < 3
    assert exact["visible [mm]"] < noisy["visible [mm]"] < 6
    assert exact["flips [%]"] == noisy["flips [%]"] == 0


def test_wrong_points_are_noticed(files, scored):
    turned = scored(changed(files.truth, lambda frames: [frame[::-1] for frame in frames]))
    slid = scored(changed(files.truth, lambda frames: [[*frame[1:], frame[-1]] for frame in frames]))
    refused = scored(changed(files.truth, lambda frames: [*frames[:18], *[None] * 18]))
    assert {row["flips [%]"] for row in turned} == {100}
    assert {row["slips [%]"] for row in slid} == {100}
    assert {row["flips [%]"] for row in slid} == {0}
    assert {(row["ok [%]"], row["all [mm]"]) for row in refused} == {(50, 0)}


def test_flags_separate_slips_that_are_claimed():
    nodes = np.zeros((1, NODES, 3))
    nodes[0, :, 0] = SPACING * np.arange(NODES)
    points, visible, called = nodes.copy(), np.ones((1, NODES), bool), np.ones((1, NODES), bool)
    points[0, 3, 1], called[0, 3] = 0.6 * SPACING, False
    row = strict_score(Claimed(points, called), nodes, visible)
    assert (row.slips, row.claimed_slips, row.called) == (1, 0, NODES - 1)
    visible[0, 3] = False
    assert strict_score(Claimed(points, called), nodes, visible).slips == 0


def test_an_order_turns_round_within_a_track_alone():
    nodes = np.zeros((4, NODES, 3))
    nodes[:, :, 0] = SPACING * np.arange(NODES)
    points, visible = nodes.copy(), np.ones((4, NODES), bool)
    points[2:] = points[2:, ::-1]
    for track, turned in ((None, 2), ([1, 1, 1, 1], 2), ([1, 1, 2, 2], 0)):
        row = strict_score(Claimed(points, visible, None if track is None else np.array(track)), nodes, visible)
        assert (row.flips, row.turned) == (2, turned)


NAN = float("nan")
FLAGS = {"points": [[0.0] * 3] * NODES, "visible": [True]}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda frames: frames[:-1], "expected 36 frames, got 35"),
        (lambda frames: [frames[0][:-1], *frames[1:]], "frame 0: expected 14 points [x, y, z], or null"),
        (lambda frames: [*frames[:-1], [[NAN] * 3] * NODES], "frame 35: expected finite coordinates in metres"),
        (lambda frames: [*frames[:-1], "none"], "frame 35: expected 14 points [x, y, z], or null"),
        (lambda frames: [*frames[:-1], FLAGS], "frame 35: expected 14 flags, true or false, in visible"),
        (lambda frames: [*frames[:-1], {"at": []}], "frame 35: expected the names points and visible, got at"),
        (lambda frames: 3, "expected 36 frames, got int"),
    ],
)
def test_wrong_frames_are_an_error_of_one_line(files, tmp_path, capsys, change, message):
    (tmp_path / "points.json").write_text(json.dumps(changed(files.truth, change)))
    assert fails(capsys, "score", files.folder, tmp_path / "points.json").count(message) == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not valid JSON"),
        ("[]", "expected {RECORDING: {"),
        ('{"other": {"exact": []}}', "no recording 'other'; there are motion_both_hand_15hz_3"),
        ('{"motion_both_hand_15hz_3": {"stereo": []}}', "no depth 'stereo'; there are exact and d455"),
    ],
)
def test_a_wrong_file_is_an_error_of_one_line(files, tmp_path, capsys, text, message):
    (tmp_path / "points.json").write_text(text)
    assert message in fails(capsys, "score", files.folder, tmp_path / "points.json")


def test_missing_files_and_full_folders_are_errors_of_one_line(files, tmp_path, capsys):
    assert "no such points file" in fails(capsys, "score", files.folder, tmp_path / "none.json")
    assert "no recordings" in fails(capsys, "track", tmp_path, tmp_path / "points.json")
    assert "expected a new or empty folder" in fails(capsys, "export", files.folder)
    assert "no claim or group 'record.flying'" in fails(capsys, "export", tmp_path / "new", "record.flying")
    (tmp_path / "one").mkdir()
    (tmp_path / "one" / "recording.json").write_text("{}")
    assert "not a recording of `record export`" in fails(capsys, "score", tmp_path, tmp_path / "points.json")


def fails(capsys, *argv: object) -> str:
    """Run a command that fails and return its message, one line."""
    assert record_files.main([str(each) for each in argv]) == 2
    line = capsys.readouterr().err
    assert line.startswith("python -m tests.benchmarks record ")
    assert line.count("\n") == 1
    return line


def test_scenes_are_those_of_the_commit_unless_a_seed_is_given():
    claim = replace(CLAIMS[0], scenes=lambda effort: [], limits=())
    assert run(claim, Effort(by_commit=True)).seed == commit_seed()
    assert run(claim, Effort(seed=4)).seed == 4
    assert run(replace(claim, held_out=False), Effort(by_commit=True)).seed == 0
