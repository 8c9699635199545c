"""Every stream is detected as before; and the judge notices when one is not."""

from __future__ import annotations

import copy
import json
import pickle
from typing import Any

import numpy as np
import pytest

from shape_obs import Detection, ShapeDetector
from tests.golden import judge, make, streams
from tests.golden.judge import differences, score
from tests.golden.streams import DATA, EXPECTED, Outcome, detect_frame, load_outcome, load_stream, names, play

NAMES = names()


@pytest.mark.parametrize("name", NAMES)
def test_a_stream_is_detected_as_before_and_no_worse_against_the_truth(name: str):
    stream, expected = load_stream(name), load_outcome(name)
    outcome, _ = play(stream)
    assert differences(expected, outcome) == []
    now, before = score(stream, outcome), score(stream, expected)
    assert np.isfinite(now.error)
    assert now.error <= before.error + judge.TOLERANCES["points2d" if now.unit == "px" else "points3d"][0] * 1e3
    assert (now.slips, now.refused, now.ok) == (before.slips, before.refused, before.ok)


def test_streams_and_their_detections_are_complete_and_small():
    assert len(NAMES) >= 154
    assert sorted(path.stem for path in EXPECTED.glob("*.npz")) == NAMES
    assert sum(path.stat().st_size for folder in (DATA, EXPECTED) for path in folder.glob("*.npz")) <= 8_000_000


@pytest.mark.parametrize("name", ["rope_hand_on_end", "ropes_apart", "blob_hand", "sheet_bent", "cloud_rope_gap"])
def test_a_stream_gives_the_same_twice_in_any_order(name: str):
    others = ["rope_lost_long", name, "sheet_corner_cut", name]
    played = [play(load_stream(each))[0] for each in others]
    for first, second in zip(played[1], played[3], strict=True):
        np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("again", [copy.deepcopy, lambda detector: pickle.loads(pickle.dumps(detector))])
@pytest.mark.parametrize("name", ["rope_hand_on_end", "ropes_hand", "blob_hand", "sheet_corner_hidden", "cloud_held"])
def test_a_copied_or_unpickled_detector_goes_on_as_the_one_it_was_made_of(name: str, again: Any):
    stream = load_stream(name)
    detector = ShapeDetector(**stream.arguments)
    for frame in range(half := stream.frames // 2):
        detect_frame(detector, stream, frame)
    other = again(detector)
    for frame in range(half, stream.frames):
        one, two = (detect_frame(each, stream, frame) for each in (detector, other))
        assert isinstance(one, Detection)
        assert isinstance(two, Detection)
        assert [shape.reason for shape in one] == [shape.reason for shape in two]
        for shape, same in zip(one, two, strict=True):
            np.testing.assert_array_equal(shape.sigma, same.sigma)
            for field in ("points2d", "points3d"):
                np.testing.assert_array_equal(getattr(shape, field), getattr(same, field))


@pytest.fixture(scope="module")
def expected() -> Outcome:
    return load_outcome("rope_hand_on_end")


def _changed(outcome: Outcome, field: str, change: Any) -> Outcome:
    values = getattr(outcome, field).copy()
    return outcome._replace(**{field: change(values)})


def _put(at: tuple[int, ...], value: Any) -> Any:
    def change(values: np.ndarray) -> np.ndarray:
        values[at] = value
        return values

    return change


@pytest.mark.parametrize(
    ("field", "change"),
    [
        ("points2d", lambda points: points + np.float32(0.06)),
        ("points3d", _put((5, 0, 3, 2), 0.9)),
        ("points2d", lambda points: points[:, :, ::-1]),
        ("points3d", _put((7, 0, 2), np.nan)),
        ("visible", lambda flags: ~flags),
        ("valid", _put((2, 0, 4), False)),
        ("ok", _put((3, 0), False)),
        ("new", _put((9, 0), True)),
        ("track_id", _put((8, 0), 2)),
        ("sigma", lambda sigma: sigma * 1.2),
        ("reason", _put((4, 0), "something lies over the rope")),
        ("notes", _put((6,), "stamp 0.2 after 0.2")),
    ],
)
def test_the_judge_notices_a_change(expected: Outcome, field: str, change: Any):
    assert differences(expected, expected) == []
    found = differences(expected, _changed(expected, field, change))
    assert [line.split(":")[0] for line in found] == [field]


def test_the_score_notices_a_wrong_end_and_a_shift():
    name = "rope_depth_mm"
    stream, outcome = load_stream(name), load_outcome(name)
    turned, shifted = outcome.points3d.copy(), outcome.points3d + np.float32(0.01)
    turned[10:] = turned[10:, :, ::-1]
    good = score(stream, outcome)
    assert good.slips == 0
    assert score(stream, outcome._replace(points3d=turned)).slips == stream.frames - 10
    assert score(stream, outcome._replace(points3d=shifted)).error > good.error + 5


class _Shifted(ShapeDetector):
    """A detector that is wrong by a fifth of a pixel."""

    def detect_mask(self, mask: Any, *args: Any, **more: Any) -> Detection:
        moved = np.roll(mask, 1, axis=1)
        return super().detect_mask(moved, *args, **more)


def test_the_command_fails_where_the_detector_differs(monkeypatch: pytest.MonkeyPatch, capsys: Any):
    assert judge.main(["rope_two_points", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["name"] for row in rows] == ["rope_two_points"]
    assert rows[0]["differences"] == []
    monkeypatch.setattr(streams, "ShapeDetector", _Shifted)
    assert judge.main(["rope_two_points", "rope_st*"]) == 1
    assert "0 of 3 streams are the same" in capsys.readouterr().out


@pytest.mark.parametrize("main", [judge.main, make.main])
def test_an_unknown_stream_is_an_error_that_lists_the_known_ones(main: Any, capsys: Any):
    assert main(["rope_clam"]) == 2
    message = capsys.readouterr().err
    assert "no stream 'rope_clam'" in message
    assert "rope_calm" in message


def test_missing_detections_are_an_error_that_says_how_to_make_them(monkeypatch: pytest.MonkeyPatch, tmp_path: Any):
    monkeypatch.setattr(streams, "EXPECTED", tmp_path)
    with pytest.raises(LookupError, match=r"python -m tests\.golden\.make rope_calm"):
        load_outcome("rope_calm")


def test_made_detections_are_the_expected_ones(monkeypatch: pytest.MonkeyPatch, tmp_path: Any, capsys: Any):
    monkeypatch.setattr(streams, "EXPECTED", tmp_path)
    assert make.main(["rope_two_points"]) == 0
    assert "new" in capsys.readouterr().out
    assert make.main(["rope_two_points"]) == 0
    assert "1 of 1 streams are the same" in capsys.readouterr().out
