"""Which piece of a known rope a visible curve is: what is missing by noise, what is hidden, and what may have slid."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from shape_obs.geometry.curve import FittedCurve, Length, TrackHints
from shape_obs.geometry.polyline import arc_length
from shape_obs.geometry.topology import Chain
from shape_obs.tracking.occluders import FREE, HIDDEN, UNKNOWN, Tips
from shape_obs.tracking.occlusion import is_whole, match_chain
from shape_obs.tracking.placement import place
from shape_obs.tracking.predicted_rope import PredictedRope
from shape_obs.tracking.prediction import Prediction

NODES = 16


def known(spread: float, *, stale: bool = False, **hints: object) -> Prediction:
    """Return a rope of about 320 pixels, bent at one end, whose length varies by a share from frame to frame."""
    at = (np.arange(NODES) + 0.5) / NODES - 0.5
    nodes = 320 * np.stack([at, 0.3 * np.clip(at - 0.2, 0, None)], axis=1) + (320, 240)
    rope = Prediction(nodes, 320.0, Chain(NODES), TrackHints(), 1.0, 8.0, True, stale=stale)
    length = Length(pixels=float(arc_length(PredictedRope(rope).points)[-1]), frames=10.0, spread=spread)
    return rope._replace(hints=TrackHints(length=length)._replace(**hints))


def matched(rope: Prediction, piece: tuple[float, float], ends: tuple[int, int], gap=(1.0, 1.0)) -> TrackHints:
    """Return what is known after a frame that shows a piece of the rope where it is predicted, with a gap in it."""
    at = np.linspace(*piece, 64)
    curve = FittedCurve.through(PredictedRope(rope).at(at), (at > gap[0]) & (at < gap[1]))
    return match_chain(curve, rope, Tips(ends, None, 8.0)).hints


def test_an_end_that_was_a_little_hidden_stays_so_and_the_rope_becomes_no_shorter():
    rope = known(0.003, hidden=(0.0, 0.015))
    found = matched(rope, (0.0, 0.985), (UNKNOWN, UNKNOWN))
    assert found.hidden == (0.0, pytest.approx(0.015, abs=0.005))
    assert found.length.pixels == rope.hints.length.pixels


@pytest.mark.parametrize(("cut", "learnt"), [(0.5, False), (-3.0, True)])
def test_a_rope_that_is_too_short_by_two_deviations_is_learnt_only_if_no_tip_looks_cut(cut, learnt):
    rope = known(0.01, cut=(-3.0, cut))
    found = matched(rope, (0.0, 0.98), (FREE, FREE))
    assert found.hidden == (0.0, 0.0)
    assert (found.length.pixels < rope.hints.length.pixels) == learnt


def test_a_rope_that_may_have_slid_is_put_right_by_its_own_tip_though_the_predicted_form_lies_elsewhere():
    """It is a hook, and has slid by 15 % of its length: what is seen looks like another piece of the prediction."""
    corners = np.array([[0.0, 0], [100, 0], [100, 90], [320, 90]])
    arc = arc_length(corners)
    at = (np.arange(32) + 0.5) / 32 * arc[-1]
    nodes = np.stack([np.interp(at, arc, corners[:, k]) for k in range(2)], axis=1) + 150
    rope = Prediction(nodes, 410.0, Chain(32), TrackHints(), 1.0, 8.0, True)
    length = Length(pixels=float(arc_length(PredictedRope(rope).points)[-1]), frames=10.0)
    hints = TrackHints(length=length, hidden=(0.15, 0.15), cut=(-10.0, 4.0), adrift=0.15)
    found = matched(rope._replace(hints=hints), (0.15, 0.85), (UNKNOWN, UNKNOWN))
    assert found.hidden == (0.0, pytest.approx(0.3, abs=0.03))
    assert found.adrift == 0.0


@pytest.mark.parametrize(("spread", "hidden"), [(0.05, 0.0), (0.02, 0.1)])
def test_next_to_a_hand_a_length_that_is_short_beyond_noise_is_hidden_under_it(spread, hidden):
    """Last frame's rope was seen at the same angle, 10 % too short, which is 2 deviations of its length, or 5."""
    nodes = np.stack([100 + 288 * (np.arange(NODES) + 0.5) / NODES, np.full(NODES, 240.0)], axis=1)
    hints = TrackHints(length=Length(pixels=320.0, frames=10.0, spread=spread))
    rope = Prediction(nodes, 320.0, Chain(NODES), hints, 1.0, 8.0, True)
    assert matched(rope, (0.0, 1.0), (HIDDEN, FREE)).hidden == (pytest.approx(hidden, abs=1e-6), 0.0)


@pytest.mark.parametrize("short", [0.03, 0.05, 0.08])
def test_what_a_bridged_gap_is_too_straight_by_is_not_hidden_at_an_end(short):
    """The rope is bent where something lies over it; predictions are too poor to show where its ends are."""
    rope = known(0.003, residuals=(300.0, 300.0))
    points = PredictedRope(rope).at(np.linspace(0, 1, 101))
    first, last = 40, 60
    shift = short * rope.hints.length.pixels * np.array([1.0, 0.0])
    points[last:] -= shift
    points[first : last + 1] = np.linspace(points[first], points[last], last - first + 1)
    curve = FittedCurve.through(points, (np.arange(101) > first) & (np.arange(101) < last))
    assert match_chain(curve, rope, Tips((UNKNOWN, UNKNOWN), None, 8.0)).hints.hidden == (0.0, 0.0)


@pytest.mark.parametrize(("head", "tail"), [(0.13, 0.3), (0.33, 0.22), (0.24, 0.24)])
def test_both_ends_are_hidden_by_what_the_prediction_says_within_a_hundredth(head, tail):
    rope = PredictedRope(known(0.003))
    points = np.ascontiguousarray(rope.at(np.linspace(head, 1 - tail, 64)))
    whole, arc = float(arc_length(rope.points)[-1]), arc_length(points)
    found = place(
        rope.points, rope.share, points, arc, (HIDDEN, HIDDEN), (0.0, 0.0), (head, tail), (0.05, 0.05),
        whole - arc[-1], 1.0, 1.0, 1.0, (0, 0),
    )  # fmt: skip
    assert (found.head / whole, found.tail / whole) == pytest.approx((head, tail), abs=0.01)


def test_a_bridged_gap_is_bent_as_predicted():
    """The rope's bend lies in the gap, and the straight way misses it by 4 px."""
    rope = known(0.003)
    true = PredictedRope(rope).at(np.linspace(0, 1, 101))
    seen, first, last = true.copy(), 60, 80
    seen[first : last + 1] = np.linspace(true[first], true[last], last - first + 1)
    curve = FittedCurve.through(seen, (np.arange(101) > first) & (np.arange(101) < last))
    found = match_chain(curve, rope, Tips((FREE, FREE), None, 8.0)).points
    fine = np.concatenate([np.linspace(*pair, 20) for pair in pairwise(found)])
    away = np.linalg.norm(true[:, None] - fine, axis=2).min(axis=1)
    assert np.linalg.norm(seen - true, axis=1).max() > 3
    assert away.max() < 0.5


def test_a_hidden_end_has_the_scale_of_what_is_next_to_it():
    """A rope of 0.5 m is steep in its first third, 400 px to a metre, and flat in the rest, 1000 px to a metre."""
    metres = np.linspace(0, 0.5, 321)
    column = 100 + np.interp(metres, [0, 0.175, 0.5], [0, 70, 395])
    row = np.full(321, 240.0)
    nodes = np.stack([np.interp((np.arange(NODES) + 0.5) / NODES / 2, metres, column), row[:NODES]], axis=1)
    length = Length(pixels=395.0, metres=0.5, frames=10.0)
    rope = Prediction(nodes, 395.0, Chain(NODES), TrackHints(hidden=(0.0, 0.3), length=length), 1.0, 8.0, True)
    seen = np.stack([column[:225], row[:225]], axis=1)
    curve = FittedCurve(seen, np.zeros(225, bool), arc_length(seen), False, metres[:225], None, None, 8.0)
    found = match_chain(curve, rope, Tips((FREE, HIDDEN), None, 8.0))
    assert found.hints.hidden == (0.0, pytest.approx(0.3, abs=0.005))
    assert found.points[-1] == pytest.approx((495.0, 240.0), abs=3)


def flat_rope(hidden: float, metres: float = 0.0, relief: np.ndarray | None = None) -> Prediction:
    """Return a straight rope of 400 pixels of which the end was hidden."""
    nodes = np.stack([100 + 400 * (np.arange(NODES) + 0.5) / NODES, np.full(NODES, 240.0)], axis=1)
    hints = TrackHints(hidden=(0.0, hidden), length=Length(pixels=400.0, metres=metres, frames=10.0))
    return Prediction(nodes, 400.0, Chain(NODES), hints, 1.0, 8.0, True, relief=relief)


@pytest.mark.parametrize("hidden", [0.1, 0.2, 0.3])
def test_next_to_what_lies_behind_the_rope_a_twentieth_of_it_is_not_visible_either(hidden):
    """Where it turns round or towards the camera a part of the turn is not seen; next to a hand there is no turn."""
    rope = flat_rope(hidden, metres=0.5)
    points = PredictedRope(rope).at(np.linspace(0, 1 - hidden, 225))
    metres = np.linspace(0, 0.5 * (1 - hidden), 225)
    curve = FittedCurve(points, np.zeros(225, bool), arc_length(points), False, metres, None, None, 8.0)
    for end, more in ((UNKNOWN, 0.05), (HIDDEN, 0.0)):
        found = match_chain(curve, rope, Tips((FREE, end), None, 8.0))
        share = found.stations / found.stations[-1]
        assert 1 - share[found.interpolated].min() == pytest.approx(hidden + more, abs=0.03)


def test_a_hidden_end_comes_to_lie_as_deep_as_what_is_seen_next_to_it():
    """It was 40 px deeper; after a frame most of that is kept, and after 40 frames a twentieth at most."""
    hidden, at, depths = 0.3, (np.arange(NODES) + 0.5) / NODES, []
    relief = 40 * np.maximum(at - (1 - hidden), 0) / hidden
    points = PredictedRope(flat_rope(hidden)).at(np.linspace(0, 1 - hidden, 225))
    curve = FittedCurve(points, np.zeros(225, bool), arc_length(points), False, None, None, np.zeros(225), 8.0)
    for _ in range(40):
        found = match_chain(curve, flat_rope(hidden, relief=relief), Tips((FREE, HIDDEN), None, 8.0))
        assert found.relief is not None
        relief = np.interp(at, found.stations / found.stations[-1], found.relief)
        depths.append(float(relief[-1]))
    assert depths[0] > 20
    assert depths[-1] < 2


@pytest.mark.parametrize(
    ("stretch", "hidden", "whole"), [(1.01, 0.0, True), (0.99, 0.0, True), (1.1, 0.0, False), (1.01, 0.1, False)]
)
def test_a_rope_is_whole_if_it_is_as_long_in_space_as_it_is_known_to_be(stretch, hidden, whole):
    """Lengths in space are off by some 1 % (``Length.spread_metres`` is at most 1.2 %)."""
    points = np.stack([np.linspace(0, 300, 64), np.zeros(64)], axis=1)
    form = replace(FittedCurve.through(points, np.zeros(64, bool)), hints=TrackHints((0.0, hidden), stretch=stretch))
    assert is_whole(replace(form, metres=np.linspace(0, 0.5, 64))) == whole
    assert not is_whole(form)


class TestOutOfSightForLong:
    """A rope that comes back without an end in sight may be any piece."""

    @pytest.mark.parametrize(("lapse", "slid"), [(2.0, 0.0), (10.0, 0.3)])
    def test_it_may_be_any_piece_after_ten_intervals_and_is_the_same_after_two(self, lapse, slid):
        rope = known(0.003, hidden=(0.0, 0.3))._replace(lapse=lapse)
        assert matched(rope, (0.0, 0.7), (UNKNOWN, UNKNOWN)).adrift == pytest.approx(slid, abs=0.02)

    @pytest.mark.parametrize("visible", [0.7, 0.5])
    def test_it_may_have_slid_by_all_that_is_hidden_but_for_noise(self, visible):
        rope = known(0.05, stale=True, hidden=(0.0, 1 - visible))
        found = matched(rope, (0.0, visible), (UNKNOWN, UNKNOWN))
        assert found.hidden == (0.0, pytest.approx(1 - visible, abs=0.03))
        assert found.adrift == pytest.approx(1 - visible - 0.05, abs=0.03)  # less a deviation of its length

    def test_it_has_not_slid_if_what_is_missing_may_be_noise(self):
        found = matched(known(0.05, stale=True, hidden=(0.0, 0.05)), (0.0, 0.95), (UNKNOWN, UNKNOWN))
        assert found.hidden[1] > 0.03
        assert found.adrift == 0.0

    def test_only_a_small_part_of_a_gap_lets_it_slide(self):
        """The rest of a bridged gap holds the piece that was there before."""
        rope = known(0.003, stale=True, hidden=(0.2, 0.0))
        found = matched(rope, (0.2, 1.0), (HIDDEN, FREE), gap=(0.5, 0.7))
        assert found.hidden[0] + 0.005 < found.adrift < found.hidden[0] + 0.1
