"""What is remembered of a shape, and where it is expected next."""

from __future__ import annotations

import numpy as np
import pytest
from shape_obs.geometry.form import Curve, Memory

from shape_obs import Centerline, ShapeDetector
from shape_obs.geometry.topology import Chain
from shape_obs.image.roi import Window
from shape_obs.tracking.prediction import Track, advance, outlook, predict, size_jump

NODES = np.stack([np.linspace(10, 90, 9), np.full(9, 50.0)], axis=1)


def curve(length: float = 100.0, hidden: bool = False) -> Curve:
    points = np.stack([np.linspace(0, length, 101), np.full(101, 50.0)], axis=1)
    return Curve(points, np.arange(101) < (30 if hidden else 0))


def first(stamp: float = 0.0, **change) -> Track:
    track = advance(None, NODES, curve(), stamp, Chain(9), 8.0, Window(0, 46, 100, 8), 800)
    return track._replace(**change)


def after(track: Track, shift: float, stamp: float, width: float = 8.0, box: Window | None = None, **form) -> Track:
    return advance(track, NODES + (0, shift), curve(**form), stamp, Chain(9), width, box, 800)


class TestPrediction:
    def test_the_first_frame_has_no_velocity(self):
        np.testing.assert_array_equal(predict(first(), 5.0, 1.0).nodes, NODES)

    def test_most_of_the_last_step_is_made_again(self):
        """Frames 0.1 s apart, 10 px a frame: 8 px are expected of the next."""
        track = after(first(), 10.0, 0.1)
        np.testing.assert_allclose(predict(track, 0.2, 1.0).nodes, NODES + (0, 18))
        np.testing.assert_allclose(predict(track, 0.15, 1.0).nodes, NODES + (0, 14))

    def test_nothing_is_extrapolated_beyond_the_last_interval(self):
        track = after(first(), 10.0, 0.1)
        np.testing.assert_allclose(predict(track, 60.0, 1.0).nodes, NODES + (0, 18))

    def test_nothing_is_extrapolated_backwards(self):
        track = after(first(), 10.0, 0.1)
        np.testing.assert_allclose(predict(track, -60.0, 1.0).nodes, NODES + (0, 10))

    def test_a_stamp_that_stands_still_gives_no_velocity(self):
        track = after(first(1.0), 10.0, 1.0)
        np.testing.assert_array_equal(track.velocity, np.zeros((9, 2)))
        assert after(first(1.0), 10.0, 0.5).interval == 0

    def test_what_is_known_is_passed_on(self):
        track = first(memory=Memory(hidden=(3.0, 0.0)))
        prediction = predict(track, 0.1, 0.7)
        assert (prediction.size, prediction.width, prediction.amount, prediction.grain) == (100.0, 8.0, 800, 0.7)
        assert prediction.memory.hidden == (3.0, 0.0)


class TestWidth:
    @pytest.mark.parametrize(
        ("seen", "kept"), [(8.2, 8.0), (7.8, 8.0), (9.0, 8.16), (4.0, 7.84), (8.26, 8.16), (80.0, 8.16)]
    )
    def test_noise_is_not_followed_and_a_change_is_followed_slowly(self, seen, kept):
        assert after(first(), 0.0, 0.1, width=seen).width == pytest.approx(kept)

    def test_a_width_that_was_not_known_is_taken_as_it_is(self):
        assert after(first(width=0.0), 0.0, 0.1, width=5.0).width == 5.0
        assert after(first(), 0.0, 0.1, width=0.0).width == 0.0


class TestSize:
    @pytest.mark.parametrize(
        ("size", "jumps"), [(100.0, False), (105.9, False), (94.1, False), (107, True), (93, True)]
    )
    def test_a_length_may_change_by_six_percent(self, size, jumps):
        assert bool(size_jump(100.0, size, "px")) is jumps

    def test_the_message_names_both_in_their_unit(self):
        assert size_jump(100.0, 200.0, "px") == "the length jumped from 100 to 200 px"
        assert size_jump(0.5, 0.25, "m") == "the length jumped from 0.500 to 0.250 m"

    def test_a_remembered_size_wins_over_the_size_found(self):
        form = curve(80.0).remembering(Memory(size=100.0))
        assert advance(first(), NODES, form, 0.1, Chain(9), 8.0, None, 800).size == 100.0
        assert after(first(), 0.0, 0.1, length=104.0).size == 104.0

    def test_the_area_of_a_body_that_was_hidden_in_part_is_not_remembered(self):
        assert after(first(), 0.0, 0.1).amount == 800
        assert after(first(), 0.0, 0.1, hidden=True).amount == 0


class TestOutlook:
    def test_the_box_with_room_for_motion(self):
        track = after(first(), 0.0, 0.1, box=Window(3, 41, 100, 10))
        assert track.drift == 5
        expected = outlook(track)
        assert expected is not None
        assert expected.window == Window(3 - 13, 41 - 13, 126, 36)
        assert expected.width == 8.0

    @pytest.mark.parametrize("edge", range(4))
    def test_each_edge_counts(self, edge):
        """Left, top, right, bottom."""
        sides = [0, 46, 100, 54]
        sides[edge] += 7
        left, top, right, bottom = sides
        assert after(first(), 0.0, 0.1, box=Window(left, top, right - left, bottom - top)).drift == 7

    def test_what_a_hand_hides_may_come_back_anywhere(self):
        assert outlook(first(memory=Memory(hidden=(0.0, 5.0)))) is None
        assert outlook(first(box=None)) is None

    def test_two_shapes_of_one_colour_are_expected_in_both_boxes(self):
        one, other = outlook(first()), outlook(first(box=Window(200, 0, 10, 10), width=3.0))
        assert one is not None
        assert other is not None
        assert one.united(other) == ((-8, -8, 226, 70), 3.0)


@pytest.mark.parametrize(("grown", "starts"), [(4, 0), (40, 1)])
def test_a_rope_that_jumps_in_length_is_found_from_a_fresh_start(monkeypatch, grown, starts):
    """280 px: 1 % more is followed, 14 % more is not."""
    fresh = []
    parameterise = Centerline.parameterise
    monkeypatch.setattr(Centerline, "parameterise", lambda *given: fresh.append(given) or parameterise(*given))
    detector, mask = ShapeDetector(Centerline(n=9)), np.zeros((120, 400), np.uint8)
    mask[56:64, 20:300] = 1
    for _ in range(3):
        assert detector.detect_mask(mask).ok
    fresh.clear()
    mask[56:64, 300 : 300 + grown] = 1
    assert detector.detect_mask(mask).shapes[0].reason == ""
    assert len(fresh) == starts
