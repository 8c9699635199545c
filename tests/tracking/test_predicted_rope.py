"""A predicted rope: which way a curve runs, and how sure that is."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from shape_obs import Centerline, Intrinsics, Shape, ShapeDetector
from shape_obs.bench.scenes import draw_rope
from shape_obs.geometry.curve import FittedCurve, Length, TrackHints
from shape_obs.geometry.polyline import resample
from shape_obs.geometry.topology import Chain
from shape_obs.tracking.occluders import FREE, HIDDEN, UNKNOWN, Tips
from shape_obs.tracking.occlusion import match_chain
from shape_obs.tracking.placement import beyond_rest, place, settled, slid
from shape_obs.tracking.predicted_rope import PredictedRope, oriented
from shape_obs.tracking.prediction import Prediction

NODES = 16


def axis(turn: float = 0.0, count: int = 64, shift: float = 0.0) -> np.ndarray:
    """Return a rope of 300 pixels that is bent at one end, turned about its middle by an angle in degrees."""
    at = np.linspace(-0.5, 0.5, count)
    points = 300 * np.stack([at, 0.3 * np.clip(at - 0.2, 0, None)], axis=1)
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    return points @ np.array([[c, s], [-s, c]]) + (320 + shift, 240)


def predicted(lapse: float = 1.0, **hints: object) -> Prediction:
    known = TrackHints(length=Length(pixels=300.0, frames=10.0))._replace(**hints)
    return Prediction(axis(count=NODES), 300.0, Chain(NODES), known, 1.0, 8.0, True, lapse=lapse)


def curve(turn: float = 0.0, shift: float = 0.0) -> FittedCurve:
    points = axis(turn, shift=shift)
    return FittedCurve.through(points, np.zeros(len(points), bool))


def track(masks: list[np.ndarray]) -> Shape:
    detector = ShapeDetector([Centerline(n=12, ends="tips", anchor=(150, 240))])
    return [detector.detect_mask(mask).shapes[0] for mask in masks][-1]


def drawn(turn: float) -> np.ndarray:
    mask = np.zeros((480, 640), np.uint8)
    c, s = 150 * np.cos(np.radians(turn)), 150 * np.sin(np.radians(turn))
    cv2.line(mask, (round(320 - c), round(240 - s)), (round(320 + c), round(240 + s)), (255.0,), 8)
    return mask


@pytest.mark.parametrize("turn", [0.0, 20.0, -35.0])
@pytest.mark.parametrize("shift", [0.0, 150.0])
def test_a_curve_is_turned_the_way_of_the_rope(turn, shift):
    for form, back in ((curve(turn, shift), False), (curve(turn, shift).reversed(), True)):
        found, turned = oriented(form, PredictedRope(predicted(), form), predicted().hints.length)
        assert turned == back
        assert not found.ambiguity
        np.testing.assert_allclose(found.points[0], curve(turn, shift).points[0])


def test_a_rope_that_comes_back_across_its_place_may_run_either_way():
    gone = np.zeros((480, 640), np.uint8)
    shape = track([drawn(0.0)] * 5 + [gone] * 3 + [drawn(90.0)])
    assert shape.reason
    assert not shape.visible.any()


def test_a_direction_is_less_sure_the_longer_a_rope_was_gone():
    found = curve(40.0)
    doubts = [PredictedRope(predicted(lapse)).doubt(found, 1.0) for lapse in (1.0, 4.0, 16.0, 64.0)]
    assert doubts == sorted(doubts, reverse=True)
    assert doubts[0] > doubts[-1] + 10


def test_a_direction_is_surer_where_predictions_have_held():
    found = curve(15.0)
    held, failed = (PredictedRope(predicted(residuals=(known, known))) for known in (0.05, 50.0))
    assert held.doubt(found, 1.0) > failed.doubt(found, 1.0) + 5


def straight(**hints: object) -> Prediction:
    """Return a straight rope of 320 pixels in row 240."""
    nodes = np.stack([100 + 320 * (np.arange(NODES) + 0.5) / NODES, np.full(NODES, 240.0)], axis=1)
    length = Length(pixels=320.0, frames=10.0)
    return Prediction(nodes, 320.0, Chain(NODES), TrackHints(length=length)._replace(**hints), 1.0, 8.0, True)


def test_a_tenth_of_a_pixel_is_noise_and_three_are_not_though_predictions_have_always_held():
    rope = PredictedRope(straight(residuals=(0.0, 0.0)))
    doubts = []
    for shift in (0.1, 3.0):
        points = rope.at(np.linspace(0, 1, 64)) + (0.0, shift)
        doubts.append(rope.doubt(FittedCurve.through(points, np.zeros(64, bool)), 1.0))
    assert doubts[0] < 1  # a standard deviation
    assert doubts[1] > 9


@pytest.mark.parametrize("turn", [20.0, 40.0, 60.0])
def test_what_turns_with_the_cut_next_to_a_hand_is_put_straight(turn):
    """The hand cuts a rope of 8 px askew, and the curve's last 4 px follow the longer side; 30 % are under the hand."""
    rope = straight(hidden=(0.0, 0.3))
    points = PredictedRope(rope).at(np.linspace(0, 0.7, 113))
    points[-3:, 1] += np.tan(np.radians(turn)) * (points[-3:, 0] - points[-3, 0])
    form = FittedCurve.through(points, np.zeros(113, bool))
    found = match_chain(form, rope, Tips((FREE, HIDDEN), None, 8.0))
    assert np.abs(found.points[:, 1] - 240).max() < 0.25


def test_a_rope_of_which_little_more_than_a_third_is_in_sight_is_followed():
    """It is bent, 16 widths long, and moves aside while something comes over it from its end."""
    detector = ShapeDetector([Centerline(n=20, ends="tips", anchor=(60.0, 120.0))])
    column, seen = np.linspace(60, 220, 400), 0
    for frame in range(60):
        row = 120 + 10 * np.sin((column - 60) / 25) + 6 * np.sin(frame / 5)
        rope = draw_rope(np.stack([column, row], axis=1), 10.0, size=(240, 320))
        mask = rope.mask.copy()
        mask[:, max(240 - 3 * max(frame - 10, 0), 118) :] = 0
        shape = detector.detect_mask(mask).shapes[0]
        assert not shape.reason, frame
        true = resample(rope.curve, 20)
        away = np.linalg.norm(shape.pixels - true, axis=1)
        assert away[shape.visible].max() < 3  # of gaps of 9 px
        seen = shape.visible.sum()
    assert seen >= 6


def test_what_was_folded_back_is_not_compared():
    """The predicted end lies on the rope; the curve goes straight on."""
    back = predicted()
    back.nodes[NODES // 2 :] = back.nodes[: NODES // 2][::-1]
    compared = PredictedRope(back).doubt(curve(), 1.0)
    folded = back._replace(hints=back.hints._replace(hidden=(0.0, 0.5), folded=(False, True)))
    assert PredictedRope(folded).doubt(curve(), 1.0) < compared - 10


def test_the_distance_from_predictions_is_learnt_and_outliers_hardly():
    residuals = 1.0, 1.0
    for _ in range(100):
        residuals = settled(residuals, 4.0, 0.25)
    assert residuals == pytest.approx((4.0, 0.25), rel=0.01)
    assert settled(residuals, 4000.0, 0.25)[0] < 8


@pytest.mark.parametrize(("first", "in_doubt"), [(0.0, True), (0.3, False)])
def test_it_is_in_doubt_which_end_is_missing_where_a_free_end_may_be_folded_back(first, in_doubt):
    """Something hides the first end, but the prediction says that the last is missing: a hairpin may have closed."""
    rope = PredictedRope(predicted())
    points = rope.at(np.linspace(first, first + 0.7, 64))
    form = FittedCurve.through(points, np.zeros(64, bool))
    found = match_chain(form, predicted(), Tips((HIDDEN, FREE), None, 8.0))
    assert found.hints.hidden == pytest.approx((0.3, 0.0), abs=0.08)
    assert ("in doubt which end" in found.ambiguity) == in_doubt
    # A prediction that may have slid along the rope decides nothing.
    found = match_chain(form, predicted(adrift=0.05), Tips((HIDDEN, FREE), None, 8.0))
    assert not found.ambiguity


class TestSliding:
    """A visible piece between two hidden ends may slide along the rope unseen."""

    @staticmethod
    def adrift(ends: tuple[int, int], apart: float, gap: float = 0.0, *, long_ago: bool = False) -> float:
        hidden, share = (0.2 * (ends[0] != FREE), 0.2 * (ends[1] != FREE)), 0.0
        for _ in range(10):
            share = slid(share, axis(), ends, hidden, gap, beyond_rest(apart, 0.0, 1.0), long_ago)
        return share

    def test_the_unforeseen_motion_adds_up(self):
        assert self.adrift((1, 1), 0.0) == 0
        assert self.adrift((1, 1), 0.1) == 0  # as far off as a rope at rest is
        assert self.adrift((1, 1), 4.0) == pytest.approx(10 * 2 / 300, rel=0.1)

    def test_it_is_bounded_by_what_is_hidden(self):
        assert self.adrift((1, 1), 400.0) == 0.2

    def test_a_free_end_shows_where_the_rope_is(self):
        assert self.adrift((1, 2), 400.0) == 0

    def test_an_end_of_which_a_piece_is_missing_shows_nothing(self):
        assert slid(0.1, axis(), (UNKNOWN, FREE), (0.0, 0.1), 0.0, 0.0, False) == pytest.approx(0.1)

    def test_what_lies_behind_a_gap_may_have_slid_into_it(self):
        assert self.adrift((HIDDEN, FREE), 400.0, 0.05) == pytest.approx(0.25)
        assert self.adrift((UNKNOWN, UNKNOWN), 400.0, 0.05) == pytest.approx(0.2)

    def test_after_long_out_of_sight_it_may_be_any_piece(self):
        assert self.adrift((0, 0), 0.0, long_ago=True) == 0.2

    def test_a_rope_that_moves_between_two_hands_is_refused_after_a_while(self):
        """It is straight, and both of its ends are hidden: nothing shows how it moves along itself."""
        detector, reasons = ShapeDetector([Centerline(n=12, ends="tips", anchor=(150, 240))]), []
        for frame in range(60):
            mask = np.zeros((480, 640), np.uint8)
            depth = np.full(mask.shape, 0.8, np.float32)
            cv2.line(mask, (170, 240 + 2 * frame), (470, 240 + 2 * frame), (255.0,), 8)
            depth[mask > 0] = 0.79
            if frame >= 10:
                over = np.zeros(mask.shape, bool)
                over[:, :200] = over[:, 440:] = True
                mask[over], depth[over] = 0, 0.7
            shape = detector.detect_mask(mask, depth, Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)).shapes[0]
            reasons.append(shape.reason)
        assert reasons[:20] == [""] * 20
        assert all("may have slid" in reason for reason in reasons[26:])


@pytest.mark.parametrize("free", [0, 1])
def test_nothing_is_put_beyond_a_free_tip_where_predictions_are_poor(free):
    """The piece that is seen lies at the other end of the prediction; its free tip is the rope's all the same."""
    first = 96 if free == 0 else 0
    points = np.ascontiguousarray(axis(count=641)[first : first + 545 : 10])
    form, known = FittedCurve.through(points, np.zeros(len(points), bool)), predicted(residuals=(200.0, 200.0))
    ends = (FREE, UNKNOWN) if free == 0 else (UNKNOWN, FREE)
    rope = PredictedRope(known)
    none = 0.0, 0.0
    missing = place(
        rope.points, rope.share, form.points, form.arc, ends, none, none, (200.0, 200.0), 45.0, 1.0, 1.0, 1.0, (0, 0)
    )
    assert missing[free] == 0
    assert missing[1 - free] == pytest.approx(45.0)
