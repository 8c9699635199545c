"""The stored state of a tracked shape, and its predicted position."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from shape_obs import Centerline, GrayRange, ShapeDetector, ShapeLostError
from shape_obs.configurations import centerline
from shape_obs.configurations.base import Scene
from shape_obs.frame import depth_images
from shape_obs.geometry.curve import FittedCurve, TrackHints
from shape_obs.geometry.topology import Chain
from shape_obs.image.find_region import find_region
from shape_obs.image.roi import Window
from shape_obs.tracking.prediction import Fit, Prediction, Track, advance, predict, typical_motion
from shape_obs.tracking.search_window import predict_search_window

NODES = np.stack([np.linspace(10, 90, 9), np.full(9, 50.0)], axis=1)


def curve(length: float = 100.0, hidden: bool = False) -> FittedCurve:
    points = np.stack([np.linspace(0, length, 101), np.full(101, 50.0)], axis=1)
    return FittedCurve.through(points, np.arange(101) < (30 if hidden else 0))


def observation(box: Window | None = None, area: int = 800, resolution: float = 1.0) -> Any:
    """Return the part of an ``Observed`` that tracks read."""
    return SimpleNamespace(box=box, area=area, resolution=resolution)


def found(form: FittedCurve, nodes: np.ndarray = NODES, width: float = 8.0) -> Fit:
    return Fit(form, 1.0, nodes=nodes, topology=Chain(9), size=form.size, width=width)


def first(stamp: float = 0.0, **change) -> Track:
    return advance(None, found(curve()), observation(Window(0, 46, 100, 8)), stamp)._replace(**change)


def after(track: Track, shift: float, stamp: float, width: float = 8.0, box: Window | None = None, **form) -> Track:
    return advance(track, found(curve(**form), NODES + (0, shift), width), observation(box), stamp)


def predicted(track: Track, stamp: float, **seen: Any) -> Prediction:
    prediction = predict(track, observation(**seen), stamp)
    assert prediction is not None
    return prediction


class TestPrediction:
    def test_the_first_frame_has_no_velocity(self):
        np.testing.assert_array_equal(predicted(first(), 5.0).nodes, NODES)

    def test_a_prediction_knows_how_long_ago_the_shape_was_seen(self):
        track = after(first(), 5.0, 0.1)
        assert predicted(track, 0.2).lapse == pytest.approx(1.0)
        assert predicted(track, 0.9).lapse == pytest.approx(8.0)
        assert predicted(track, 0.05).lapse == 1.0

    def test_most_of_the_last_step_is_made_again(self):
        """With frames 0.1 s apart and 10 px per frame, 8 px are predicted for the next."""
        track = after(first(), 10.0, 0.1)
        np.testing.assert_allclose(predicted(track, 0.2).nodes, NODES + (0, 18))
        np.testing.assert_allclose(predicted(track, 0.15).nodes, NODES + (0, 14))

    def test_nothing_is_extrapolated_beyond_the_last_interval(self):
        track = after(first(), 10.0, 0.1)
        np.testing.assert_allclose(predicted(track, 60.0).nodes, NODES + (0, 18))

    def test_nothing_is_extrapolated_backwards(self):
        track = after(first(), 10.0, 0.1)
        np.testing.assert_allclose(predicted(track, -60.0).nodes, NODES + (0, 10))

    def test_a_stamp_that_stands_still_gives_no_velocity(self):
        track = after(first(1.0), 10.0, 1.0)
        np.testing.assert_array_equal(track.velocity, np.zeros((9, 2)))
        assert after(first(1.0), 10.0, 0.5).interval == 0
        assert not after(first(0.0), 10.0, 1e-300).velocity.any()

    def test_what_is_known_is_passed_on(self):
        track = first(hints=TrackHints(hidden=(3.0, 0.0)))
        prediction = predicted(track, 0.1, resolution=0.7)
        assert (prediction.size, prediction.width, prediction.resolution) == (100.0, 8.0, 0.7)
        assert prediction.hints.hidden == (3.0, 0.0)


class TestMotion:
    @pytest.mark.parametrize("aside", [0.0, 5.0, 40.0])
    def test_the_motion_of_a_rope_is_how_far_it_lies_from_its_track_to_half_a_gap(self, aside):
        """A rope of 300 px, in depth of 0.7 m, whose track has other nodes, from the other end: gaps of 6 and 5 px."""
        nodes, before = (
            np.stack([np.linspace(10, 310, count), np.full(count, row)], axis=1)
            for count, row in ((50, 60.0), (61, 60.0 + aside))
        )
        before = np.ascontiguousarray(before[::-1])
        moved, away = typical_motion(nodes, before, depth_images(np.full((120, 320), 0.7, np.float32)))
        assert moved == pytest.approx(aside, abs=3)
        assert away == pytest.approx(0.7)


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
    @pytest.mark.parametrize(("longer", "jumps"), [(0, False), (14, False), (24, True), (-24, True)])
    def test_a_length_may_change_by_six_percent(self, longer, jumps, monkeypatch):
        """A rope of 280 px that grows or shrinks by more between frames is fitted from an initial axis."""
        calls, initial = [], centerline.medial_axis
        monkeypatch.setattr(centerline, "medial_axis", lambda observed: calls.append(1) or initial(observed))
        detector = ShapeDetector(Centerline(ends="tips"))
        for last in (300, 300, 300 + longer):
            mask = np.zeros((120, 400), np.uint8)
            mask[56:64, 20:last] = 1
            detector.detect_mask(mask)
        assert len(calls) == 1 + jumps

    def test_the_size_is_that_of_the_fit(self):
        form = curve(80.0)
        assert advance(first(), found(form)._replace(size=100.0), observation(), 0.1).size == 100.0
        assert after(first(), 0.0, 0.1, length=104.0).size == 104.0

    def test_a_rope_that_is_seen_a_little_shorter_keeps_its_length(self):
        """Three of 280 px may be noise: the known length hardly changes, or a slow hand would shrink the rope."""
        seen = []
        for last in (300, 297):
            mask = np.zeros((120, 400), np.uint8)
            mask[56:64, 20:last] = 1
            seen.append(find_region(mask, Window(0, 0, 400, 120), 1, 0.0))
        spec = Centerline(n=9)
        whole = spec.fit(seen[0], None, None, Scene())
        prediction = predict(advance(None, whole, seen[0], 0.0), seen[1], 0.1)
        shorter = spec.fit(seen[1], prediction, None, Scene())
        before, after = (found.form.hints.length.pixels for found in (whole, shorter))
        assert shorter.form.hints.hidden[1] < shorter.form.hints.slack
        assert after == pytest.approx(before, rel=5e-4)

    def test_the_area_of_an_object_that_was_hidden_in_part_is_not_remembered(self):
        assert after(first(), 0.0, 0.1).area == 800
        assert after(first(), 0.0, 0.1, hidden=True).area == 0

    @pytest.mark.parametrize(("area", "steady"), [(800, True), (802, True), (798, True), (803, False), (797, False)])
    def test_an_area_that_changes_by_three_thousandths_is_another_one(self, area, steady):
        assert predicted(first(), 0.1, area=area).steady is steady


class TestSearchWindow:
    def test_the_box_with_room_for_motion(self):
        track = after(first(), 0.0, 0.1, box=Window(3, 41, 100, 10))
        assert track.drift == 5
        expected = predict_search_window([track])
        assert expected is not None
        assert expected.window == Window(3 - 13, 41 - 13, 126, 36)
        assert expected.width == 8.0

    @pytest.mark.parametrize("edge", range(4))
    def test_each_edge_counts(self, edge):
        """The edges are left, top, right, bottom."""
        sides = [0, 46, 100, 54]
        sides[edge] += 7
        left, top, right, bottom = sides
        assert after(first(), 0.0, 0.1, box=Window(left, top, right - left, bottom - top)).drift == 7

    def test_what_a_hand_hides_may_come_back_anywhere(self):
        assert predict_search_window([first(hints=TrackHints(hidden=(0.0, 5.0)))]) is None
        assert predict_search_window([first(box=None)]) is None
        assert predict_search_window([None]) is None
        assert predict_search_window([first(), None]) is None

    def test_two_shapes_of_one_colour_are_expected_in_both_boxes(self):
        other = first(box=Window(200, 0, 10, 10), width=3.0)
        assert predict_search_window([first(), other]) == ((-8, -8, 226, 70), 3.0)
        assert predict_search_window([other, first()]) == ((-8, -8, 226, 70), 3.0)


@pytest.mark.parametrize(("grown", "starts"), [(4, 0), (40, 1)])
def test_a_rope_that_jumps_in_length_is_found_from_a_fresh_start(monkeypatch, grown, starts):
    """The rope has 280 px: 1 % more is tracked, 14 % more is not."""
    fresh = []
    medial_axis = centerline.medial_axis
    monkeypatch.setattr(centerline, "medial_axis", lambda observed: fresh.append(observed) or medial_axis(observed))
    detector, mask = ShapeDetector(Centerline(n=9)), np.zeros((120, 400), np.uint8)
    mask[56:64, 20:300] = 1
    for _ in range(3):
        assert detector.detect_mask(mask).ok
    fresh.clear()
    mask[56:64, 300 : 300 + grown] = 1
    assert detector.detect_mask(mask).shapes[0].reason == ""
    assert len(fresh) == starts


class TestTrackIds:
    """The number that changes when continuity was lost."""

    @staticmethod
    def follow(detector: ShapeDetector, *frames: tuple[np.ndarray, float]) -> list[tuple[int, bool]]:
        shapes = [detector.detect_mask(mask, stamp=stamp).shapes[0] for mask, stamp in frames]
        return [(shape.track_id, shape.new) for shape in shapes]

    @pytest.mark.parametrize("policy", ["hold", "truncate", "nan"])
    def test_a_short_loss_keeps_it_and_a_long_one_does_not(self, wave, policy):
        detector, empty = ShapeDetector(max_age=0.5, on_missing=policy), np.zeros_like(wave.mask)
        frames = [(empty, 0.0), (wave.mask, 0.1), (wave.mask, 0.2), (empty, 0.3), (wave.mask, 0.6), (empty, 1.2),
                  (empty, 1.3), (wave.mask, 1.4), (wave.mask, 1.5)]  # fmt: skip
        found = [
            (0, False),
            (1, True),
            (1, False),
            (1, False),
            (1, False),
            (1, False),
            (1, False),
            (2, True),
            (2, False),
        ]
        assert self.follow(detector, *frames) == found
        detector.reset()
        assert self.follow(detector, *frames) == found

    def test_a_loss_that_raised_ends_the_track_too(self, wave):
        detector, empty = ShapeDetector(max_age=0.5, on_missing="raise"), np.zeros_like(wave.mask)
        assert self.follow(detector, (wave.mask, 0.0)) == [(1, True)]
        for stamp in (0.3, 0.8):
            with pytest.raises(ShapeLostError):
                detector.detect_mask(empty, stamp=stamp)
        assert self.follow(detector, (wave.mask, 0.9)) == [(2, True)]

    def test_each_shape_counts_its_own(self, blue, wave):
        detector = ShapeDetector(
            [Centerline(name="a"), Centerline(name="b", segmentation=GrayRange(1, 255, min_area=9999))]
        )
        detection = detector.detect_mask(wave.mask)
        assert [(shape.track_id, shape.ok) for shape in detection] == [(1, True), (0, False)]

    def test_pixels_and_a_cloud_are_two_tracks(self, wave):
        detector = ShapeDetector()
        at = np.linspace(0, 0.4, 3000)
        cloud = np.stack([at, 0.002 * np.sin(900 * at), 0.5 + 0.002 * np.cos(900 * at)], axis=1)
        assert detector.detect_mask(wave.mask).shapes[0].track_id == 1
        shape = detector.detect_cloud(cloud).shapes[0]
        assert (shape.ok, shape.track_id, shape.new) == (True, 2, True)
        assert shape.length == pytest.approx(0.4, rel=0.03)

    def test_a_fit_that_says_so_begins_anew(self, wave):
        """A configuration reports that what it found is another object: its numbering continues nothing."""

        class Swapped(Centerline, kind="swapped_for_a_test"):
            def fit(self, observed, prediction, target, scene):
                return super().fit(observed, prediction, target, scene)._replace(new=observed.area < 2000)

        detector, half = ShapeDetector(Swapped(n=5)), wave.mask.copy()
        half[:, 150:] = 0
        assert np.count_nonzero(half) < 2000 < np.count_nonzero(wave.mask)
        found = [detector.detect_mask(mask).shapes[0] for mask in (wave.mask, wave.mask, half, wave.mask)]
        assert [(shape.track_id, shape.new) for shape in found] == [(1, True), (1, False), (2, True), (2, False)]


def test_a_prediction_moves_in_depth_and_grows_old():
    nodes, relief = np.zeros((8, 2)), np.full(8, 50.0)
    track = Track(nodes, nodes, 0.1, 100.0, 1.0, Chain(8), relief=relief, climb=np.full(8, 20.0))
    next_one, later = (predict(track, observation(), stamp) for stamp in (1.1, 1.4))
    assert next_one is not None
    assert later is not None
    assert next_one.relief is not None
    assert np.all((next_one.relief > 51) & (next_one.relief <= 52))  # most of the 2 units of an interval
    assert next_one.lapse == pytest.approx(1.0)
    assert later.lapse == pytest.approx(4.0)
