"""What `shape-obs bench claims --only belief` says of errors that are as large as expected, and of others."""

import numpy as np
import pytest

from tests.benchmarks import belief_claims
from tests.benchmarks.belief_claims import PICTURE, draw, reliability, targets
from tests.benchmarks.motion_claims import hidden_rope_tracks, swinging_rope_tracks
from tests.benchmarks.tables import Row


def drawn(times: float, *, space: bool = True, wrong: float = 0.0, frames: int = 300) -> list[Row]:
    """Frames of 20 points whose errors are normal, ``times`` as large as sigma; five of the points are hidden."""
    rng, out = np.random.default_rng(0), []
    for number in range(frames):
        sigma = rng.uniform(0.001, 0.02, 20) * (1 if space else 500)
        errors = np.linalg.norm(rng.normal(size=(20, 3 if space else 2)), axis=1) * sigma * times
        row = Row(errors=errors, sigma=sigma.astype(np.float32), shown=np.arange(20) >= 5, space=space)
        out.append(Row(row, kind="rope, swung", given="depth", wrong=number < wrong * frames))
    return out


@pytest.mark.parametrize("space", [False, True], ids=["image", "space"])
def test_normal_errors_of_the_expected_size_meet_the_targets(space):
    rows = drawn(1.0, space=space)
    (row,) = reliability(rows)
    assert row["seen_%"] == pytest.approx(90, abs=1.5)
    assert row["hidden_%"] == pytest.approx(90, abs=2.5)
    assert row["rms"] == pytest.approx(row["sigma"], rel=0.05)
    assert all(each.reached == "yes" for each in targets(rows))


@pytest.mark.parametrize(("times", "wrong", "missed"), [(2.0, 0.0, [0, 2]), (0.5, 0.0, [1]), (1.0, 0.01, [3])])
def test_other_errors_do_not(times, wrong, missed):
    reached = [each.reached for each in targets(drawn(times, wrong=wrong))]
    assert [at for at, answer in enumerate(reached) if answer == "no"] == missed


def test_the_diagram_is_drawn(tmp_path):
    path = draw([*drawn(1.0), *drawn(1.0, space=False)], tmp_path)
    assert path == tmp_path / PICTURE
    assert path.stat().st_size > 10_000


def test_sigma_of_tracked_ropes_is_about_right():
    hidden = hidden_rope_tracks([1], covers=["hand"], approaches=[8.0], speeds=[3.0], depths=[True], noises=[True])
    swung = swinging_rope_tracks([3], frames=40, rates=[33], walls=[True], noises=[True])
    for tracks in (hidden, swung):
        rows = [Row(each, kind="rope", given="depth") for track in tracks for each in track.beliefs]
        (row,) = reliability(rows)
        assert row["seen_%"] >= 75
        assert 0.5 <= row["sigma"] / row["rms"] <= 2


def test_every_kind_of_scene_is_measured(monkeypatch):
    """With no seeds no scene is drawn; what is drawn for one seed takes minutes."""
    monkeypatch.setattr(belief_claims, "ENVS", ())
    assert list(belief_claims.beliefs([])) == []
    kinds = {kind for kind, _ in belief_claims._flat_objects(belief_claims.View(), 0, True)}
    assert kinds == {"cloth, hand", "cloth, tilted", "cloth, corner up", "cloth, folded"} | {
        f"outline, {name}" for name in ("hand", "tilted", "corner up")
    }
