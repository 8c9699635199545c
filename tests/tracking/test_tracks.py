"""The state of a track and its prediction, the numbers of tracks, and what is searched in which window."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from shape_obs import Centerline, Contour, HSVRange, ShapeDetector, ShapeLostError, Surface
from shape_obs import detector as detector_module
from shape_obs.bench.photos import photographed
from shape_obs.bench.scenes import moving_rope, moving_sheet
from shape_obs.configurations import centerline
from shape_obs.frame import Frame
from shape_obs.image.find_region import find_region
from shape_obs.image.roi import Window
from shape_obs.tracking import search_window
from shape_obs.tracking.clock import Clock
from shape_obs.tracking.predict import Prediction, Track
from shape_obs.tracking.scene import Scene
from tests.golden.streams import load_stream, play
from tests.scenes.beams import swinging_beam, tracked_beam

ROPE = Centerline(n=9)


def ribbon(row: int = 56, width: float = 8.0) -> np.ndarray:
    """Return the mask of a straight rope of 240 px; a fraction of a pixel more is a row more for that share of it."""
    mask = np.zeros((120, 400), np.uint8)
    mask[row - 4 : row - 4 + int(width), 40:280] = 1
    mask[row - 4 + int(width), 40 : 40 + round(240 * (width % 1))] = 1
    return mask


def tracked(*frames: tuple[np.ndarray, float]) -> Track:
    """Return the track of a rope after masks with their times, seconds."""
    track, clock, whole = None, Clock(), Window(0, 0, 400, 120)
    for mask, now in frames:
        clock.now = now
        scene = Scene.in_image(Frame(), clock, mask.shape, whole)
        before = None if track is None else Prediction(track, now, ROPE.model)
        track = ROPE.fit(find_region(mask, whole, 1, 0.0), before, None, scene).track
    assert track is not None
    return track


class TestPrediction:
    def test_most_of_the_last_step_is_made_again(self):
        """With frames 0.1 s apart and 10 px per frame, 8 px are predicted for the next."""
        track = tracked((ribbon(40), 1.0), (ribbon(50), 1.1))
        for seconds, ahead in ((0.1, 8), (0.05, 4)):
            found = Prediction(track, 1.1 + seconds, ROPE.model).nodes
            np.testing.assert_allclose(found[:, 1], track.nodes[:, 1] + ahead, atol=0.05)

    def test_nothing_is_extrapolated_beyond_the_last_interval(self):
        track = tracked((ribbon(40), 1.0), (ribbon(50), 1.1))
        found = Prediction(track, 60.0, ROPE.model).nodes
        np.testing.assert_allclose(found[:, 1], track.nodes[:, 1] + 8, atol=0.05)

    @pytest.mark.parametrize("now", [1.0, 0.5, 1.0 + 1e-9])
    def test_a_time_that_stands_still_gives_no_velocity(self, now: float):
        track = tracked((ribbon(40), 1.0), (ribbon(50), now))
        assert not track.velocity.any()
        assert track.interval == pytest.approx(0.0, abs=1e-6)


class TestWidth:
    @pytest.mark.parametrize(
        ("seen", "kept"), [(8.2, 8.0), (7.8, 8.0), (9.0, 8.16), (4.0, 7.84), (8.4, 8.16), (30.0, 8.16)]
    )
    def test_noise_is_not_followed_and_a_change_is_followed_slowly(self, seen: float, kept: float):
        assert tracked((ribbon(), 1.0), (ribbon(width=seen), 1 + 1 / 30)).width == pytest.approx(kept, abs=0.06)


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
    def test_it_changes_after_a_loss_that_is_too_long_to_remember_the_order(self, wave, policy):
        detector, empty = ShapeDetector(max_age=0.5, on_missing=policy), np.zeros_like(wave.mask)
        frames = [(empty, 0.0), (wave.mask, 0.1), (wave.mask, 0.2), (empty, 0.3), (wave.mask, 0.6), (empty, 1.2),
                  (empty, 1.3), (wave.mask, 1.4), (empty, 2.0), (wave.mask, 600.0), (wave.mask, 600.1)]  # fmt: skip
        found = [(0, False), (1, True), *[(1, False)] * 7, (2, True), (2, False)]
        assert self.follow(detector, *frames) == found
        detector.reset()
        assert self.follow(detector, *frames) == found

    def test_a_loss_that_raised_ends_the_track_too(self, wave):
        detector, empty = ShapeDetector(max_age=0.5, on_missing="raise"), np.zeros_like(wave.mask)
        assert self.follow(detector, (wave.mask, 0.0)) == [(1, True)]
        for stamp in (0.3, 0.8):
            with pytest.raises(ShapeLostError):
                detector.detect_mask(empty, stamp=stamp)
        assert self.follow(detector, (wave.mask, 600.0)) == [(2, True)]

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


BLUE = HSVRange(low=(100, 80, 25), high=(130, 255, 255), open=3, close=3)
FRAMES = 25


@pytest.fixture
def everywhere(monkeypatch):
    """Return a function that makes the detector search every frame as a whole."""
    return lambda: monkeypatch.setattr(detector_module, "_SEARCH_ALL", 1)


def shifted(mask: np.ndarray, u: int, v: int) -> np.ndarray:
    moved = cv2.warpAffine(mask, np.array([[1.0, 0, u], [0, 1.0, v]]), (mask.shape[1], mask.shape[0]))
    return np.asarray(moved, dtype=np.uint8)


def rope(start: tuple[int, int] = (80, 100), length: int = 220) -> np.ndarray:
    mask = np.zeros((480, 640), np.uint8)
    cv2.line(mask, start, (start[0] + length, start[1] + 40), (255.0,), 12)
    return mask


@pytest.fixture
def looked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """Return the list of all searches for a region, which grows with each one."""
    looks: list[tuple[Any, ...]] = []
    original = search_window.find_region

    def look(*given: Any) -> Any:
        looks.append(given)
        return original(*given)

    monkeypatch.setattr(search_window, "find_region", look)
    return looks


@pytest.mark.parametrize("speed", [4, 30])
def test_ropes_are_found_as_in_the_whole_image(everywhere, speed):
    masks = [frame.mask for frame in moving_rope(np.random.default_rng(1), speed, FRAMES)]
    detector = ShapeDetector()
    found = [detector.detect_mask(mask) for mask in masks]
    everywhere()
    detector.reset()
    for mask, detection in zip(masks, found, strict=True):
        again = detector.detect_mask(mask)
        assert again.ok
        assert detection.ok
        np.testing.assert_allclose(detection.shapes[0].points2d, again.shapes[0].points2d, atol=1e-3)


def test_images_give_the_same_points_as_their_whole(everywhere):
    rng = np.random.default_rng(2)
    frames = [photographed(rng, sheet.mask, 1.5, 4.0) for sheet in moving_sheet(rng, 8, 6)]
    detector = ShapeDetector([Contour(), Surface()], BLUE)
    found = [detector.detect(frame) for frame in frames]
    everywhere()
    detector.reset()
    for frame, detection in zip(frames, found, strict=True):
        for shape, again in zip(detection, detector.detect(frame), strict=True):
            assert shape.ok
            np.testing.assert_allclose(shape.points2d, again.points2d, atol=0.3)


def test_a_rope_that_jumps_away_from_a_speck_is_found_in_the_same_frame():
    """The window is not empty: a speck of the rope's colour is left there."""
    detector, mask = ShapeDetector(max_speed=None), rope()
    before = [detector.detect_mask(mask).shapes[0].points2d for _ in range(3)][-1]
    moved = shifted(mask, 210, 190)
    u, v = before[10].round().astype(int).tolist()
    cv2.circle(moved, (u, v), 6, (255.0,), -1)
    after = detector.detect_mask(moved).shapes[0]
    assert after.reason == ""
    np.testing.assert_allclose(after.points2d, before + (210, 190), atol=0.5)


def test_a_hidden_end_that_comes_back_is_seen_at_once(looked):
    """A hand comes over it step by step and leaves at once: while it is there, all of the image is searched, once."""
    detector, mask = ShapeDetector(Centerline(n=20, ends="tips")), rope()
    hands = [700] * 5 + list(range(300, 215, -5))
    for hand in hands:
        covered = mask.copy()
        covered[:, hand:] = 0
        assert detector.detect_mask(covered).ok
    after = detector.detect_mask(mask).shapes[0]
    assert after.visible.all()
    np.testing.assert_allclose(after.points2d[[0, -1]], [(80, 100), (300, 140)], atol=6)
    assert len(looked) == len(hands) + 1


def test_what_turns_up_elsewhere_does_not_disturb():
    detector, mask = ShapeDetector(), rope()
    before = [detector.detect_mask(mask).shapes[0].points2d for _ in range(3)][-1]
    other = mask.copy()
    cv2.circle(other, (500, 400), 20, (255.0,), -1)  # half as large as the rope
    after = detector.detect_mask(other).shapes[0]
    assert after.ok
    assert after.visible.all()
    np.testing.assert_allclose(after.points2d, before, atol=0.1)


def test_what_was_hidden_at_first_is_seen_before_long():
    """The hidden half of a rope is not tracked, and lies outside the search window."""
    whole = np.zeros((480, 640), np.uint8)
    cv2.line(whole, (40, 240), (600, 240), (255.0,), 12)
    half = whole.copy()
    half[:, 300:] = 0
    back = whole.copy()
    back[:, 300:340] = 0
    detector = ShapeDetector(Centerline(ends="tips"))
    for _ in range(3):
        assert detector.detect_mask(half).shapes[0].points2d[-1, 0] < 302
    ends = [detector.detect_mask(back).shapes[0].points2d[-1, 0] for _ in range(30)]
    assert max(ends) > 590
    assert detector.detect_mask(back).shapes[0].points2d[-1, 0] > 590


@pytest.mark.parametrize(
    ("places", "refused", "track"),
    [
        ([120, 165, 210, 255, 300, 345], 5, 1),  # it moves on nearly as fast as it has come, which is the object
        ([120, 120, 120, 120, 120, 120], 5, 2),  # another object, at rest
        ([120, 121, 122, 123, 0], 4, 1),  # an object like it, while it is hidden
    ],
)
def test_what_lies_out_of_reach_is_believed_after_five_frames(places, refused, track):
    """Within 1/30 s it moves by 107 px at most; while it is refused its points lie off what is seen, and are not ok."""
    detector, mask = ShapeDetector(), rope((80, 40))
    shapes = [detector.detect_mask(shifted(mask, 0, v)).shapes[0] for v in (0, 0, 0, *places)]
    assert [bool(shape.reason) for shape in shapes] == [False] * 3 + [True] * refused + [False]
    assert [shape.ok for shape in shapes] == [not shape.reason for shape in shapes]
    assert shapes[-1].track_id == track
    np.testing.assert_allclose(shapes[-1].pixels, shapes[0].pixels + (0, places[-1]), atol=1.0)


@pytest.mark.parametrize("spec", [Centerline(), Contour(), Surface()])
def test_an_object_of_any_kind_that_jumps_at_240_hertz_is_found_in_ten_frames(spec):
    detector, mask = ShapeDetector(spec, dt=1 / 240), np.zeros((480, 640), np.uint8)
    mask[40 : 64 if spec.kind == "centerline" else 140, 100:280] = 1
    shapes = [detector.detect_mask(np.roll(mask, v, axis=0)).shapes[0] for v in [0] * 3 + [200] * 11]
    assert all(shape.ok == (not shape.reason) for shape in shapes)
    np.testing.assert_allclose(shapes[-1].pixels, shapes[0].pixels + (0, 200), atol=0.5)
    assert (shapes[-1].reason, shapes[-1].track_id) == ("", 2)


@pytest.mark.parametrize(("hertz", "speed", "frames"), [(240, 6, 36), (30, 4, 30), (15, 2, 24)])
def test_a_beam_that_swings_fast_is_not_lost_in_plain_sight(hertz, speed, frames):
    """It hangs from the image's border; frames are dropped, and stamps are irregular. The limit is 5 widths per s."""
    beams = swinging_beam(np.random.default_rng(2), hertz, speed, frames, drop=0.1, jitter=0.2)
    found = tracked_beam(beams, depth=hertz == 15)
    assert found["longest"] <= 5
    assert found["refused"] <= 0.25 * found["frames"]
    assert (found["strayed"], found["turned"], found["tracks"]) == (0, 0, 1)


AT_THE_EDGE = np.zeros((480, 640), np.uint8)
AT_THE_EDGE[200:212, :200] = 255


@pytest.mark.parametrize(
    ("count", "masks"),
    [
        (None, [AT_THE_EDGE] * 4),  # nothing lies beyond the edge
        (None, [rope(), rope(), rope(), shifted(rope(), 5, 0)]),  # it begins to move
        (None, [shifted(rope(), 0, by) for by in (0, 7, 20, 38)]),  # it moves faster and faster
        (2, [rope((400, 60), 180) | rope((40, 380), 180)] * 4),  # one window around both
    ],
)
def test_ropes_are_found_in_their_window_at_the_first_look(looked, count, masks):
    detector = ShapeDetector(Centerline(count=count))
    for mask in masks:
        assert detector.detect_mask(mask).ok
    assert len(looked) == 4


@pytest.mark.parametrize("name", ["rope_both_ends_cut", "rope_end_cut", "rope_hand_on_end", "rope_held"])
def test_a_rope_is_found_in_the_same_places_whichever_end_is_the_first(name):
    """What is remembered of an end stays with that end when the first frame's order is turned round."""
    stream = load_stream(name)
    first, found = play(stream)[0].points2d[0, 0], []
    for end in (0, -1):
        rope = replace(ShapeDetector(**stream.arguments).config.shapes[0], anchor=tuple(map(float, first[end])))
        found.append(play(replace(stream, arguments={**stream.arguments, "shapes": [rope]}))[0])
    one, other = found
    assert np.array_equal(one.reason == "", other.reason == "")
    seen = one.reason[:, 0] == ""
    assert np.abs(one.points2d[seen] - other.points2d[seen][:, :, ::-1]).max() < 0.1  # pixels
