"""Several ropes of one mask: found, followed and separated; more with `shape-obs bench claims --only several`."""

import numpy as np
import pytest

from tests.benchmarks.rope_identity_claims import follow, rope_tracks, track_table
from tests.benchmarks.scenes.moving_ropes import Moment
from tests.benchmarks.several_rope_claims import cold_cells, levels, targets
from tests.benchmarks.several_rope_peer import is_installed
from tests.benchmarks.several_rope_speed import warm_costs
from tests.benchmarks.tables import Row


@pytest.fixture(scope="module")
def cold():
    return list(cold_cells(8, counts=[2, 4], sizes=[(480, 640)]))


@pytest.fixture(scope="module")
def tracks():
    return track_table(rope_tracks([2], frames=60))


@pytest.fixture(scope="module")
def above():
    return levels(8)


@pytest.fixture(scope="module")
def warm():
    return warm_costs(40)


def test_nearly_all_ropes_of_drawn_scenes_are_found_cold(cold):
    assert [row.ropes for row in cold] == [2, 4]
    assert min(row.right for row in cold) >= 0.8
    assert np.mean([row.right for row in cold]) >= 0.9
    assert np.mean([row.wrong for row in cold]) <= 0.03


@pytest.mark.skipif(not is_installed(), reason="needs scikit-image and scikit-learn")
def test_more_ropes_are_right_than_with_the_peer(cold):
    assert np.mean([row.right for row in cold]) > np.mean([row.peer_right for row in cold])
    assert np.mean([row.wrong for row in cold]) < np.mean([row.peer_wrong for row in cold])


def test_slots_keep_their_ropes(tracks):
    assert [row.kind for row in tracks] == ["crossing", "touching", "slow hand", "fast hand", "leaving"]
    assert sum(row.swaps for row in tracks) == 0
    assert sum(row.flips for row in tracks) == 0
    for row in tracks:
        assert row["ok_%"] >= (60 if "hand" in row.kind else 95), row
        assert row["slips_%"] <= 3, row


def test_the_upper_strand_is_seen_in_pictures_and_in_noisy_depth(above):
    for row in above:
        assert row.found >= 0.8 * row.drawn
        assert row.wrong <= 0.02
        assert row.right >= 0.9


def test_the_same_ropes_are_followed_apart_and_where_they_meet(warm):
    assert [row.found for row in warm] == [1, 1, 1]
    assert warm[0].to_one == 1
    assert all(row.to_one == row.ms / warm[0].ms > 0 for row in warm)


def test_every_target_is_compared_with_what_was_seen(cold, tracks, above, warm):
    rows = list(targets(cold, tracks, above, warm))
    assert {row.reached for row in rows} <= {"yes", "no", "not measured"}
    assert sum("tracked" in row.what for row in rows) == 3


def moments(curves: list[np.ndarray], frames: int) -> list[Moment]:
    """Return frames in which ropes 8 pixels thick lie at rest."""
    import cv2

    mask = np.zeros((240, 320), np.uint8)
    for curve in curves:
        cv2.polylines(mask, [np.round(curve).astype(np.int32)], False, 255, 9)
    seen = tuple(np.ones(len(curve), bool) for curve in curves)
    one = Moment(tuple(curves), (9.0,) * len(curves), seen, mask, np.zeros(mask.shape, bool), None)
    return [one] * frames


def straight(v: float) -> np.ndarray:
    return np.stack([np.arange(40.0, 281.0), np.full(241, v)], axis=1)


class TestTheMeasurement:
    """What the measurement counts is what happens: the truth is exchanged, turned or moved under the ropes."""

    def total(self, seen: list[Moment]) -> Row:
        row = follow(seen, 2)
        return Row(swaps=row.swaps, flips=row.flips, slips=row.slips)

    def test_ropes_at_rest_have_no_fault(self):
        assert self.total(moments([straight(80), straight(160)], 4)) == Row(swaps=0, flips=0, slips=0)

    def test_exchanged_ropes_are_swaps(self):
        first, second = moments([straight(80), straight(160)], 1), moments([straight(160), straight(80)], 1)
        assert self.total(first + second) == Row(swaps=2, flips=0, slips=0)

    def test_a_turned_rope_is_a_flip(self):
        first, second = moments([straight(80), straight(160)], 1), moments([straight(80)[::-1], straight(160)], 1)
        assert self.total(first + second) == Row(swaps=0, flips=1, slips=0)

    def test_a_rope_that_moved_along_itself_has_slipped(self):
        first = moments([straight(80), straight(160)], 1)
        (second,) = moments([straight(80), straight(160)], 1)
        moved = Moment((straight(80) + (10, 0), straight(160)), *list(vars(second).values())[1:])
        assert self.total([*first, moved]) == Row(swaps=0, flips=0, slips=1)
