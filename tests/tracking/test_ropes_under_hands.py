"""Ropes of which something hides a part: visible points keep their index, hidden ones are flagged."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import pytest

from shape_obs import Centerline, Intrinsics, ShapeDetector
from shape_obs.bench.scenes import draw_rope
from shape_obs.frame import Frame
from shape_obs.geometry.polyline import arc_length, resample
from shape_obs.geometry.topology import Chain
from shape_obs.image.find_region import find_region
from shape_obs.image.roi import Window
from shape_obs.tracking.clock import Clock
from shape_obs.tracking.judge_chain import reason_of
from shape_obs.tracking.model import ChainModel
from shape_obs.tracking.predict import Prediction, Track
from shape_obs.tracking.scene import Scene
from shape_obs.tracking.state import new_rope
from shape_obs.tracking.step import NO_CLOUD, step_chain
from tests.benchmarks.hidden import covered_rope, track
from tests.benchmarks.record import new_detector
from tests.benchmarks.scenes.recorded_ropes import Setting, record
from tests.benchmarks.scores import visible_row
from tests.scenes.hidden_ropes import hidden_rope, hidden_ropes

CAMERA = Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5)
TABLE, ROPE, HAND = 0.6, 0.585, 0.5


def nightly(*values: object) -> object:
    return pytest.param(*values, marks=pytest.mark.nightly)


def wavy_rope(length: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return mask, depth and curve of a wavy rope that begins at u = 40."""
    u = np.linspace(40, 40 + length, 400)
    drawn = draw_rope(np.stack([u, 120 + 25 * np.sin((u - 40) / 40)], axis=1), 10.0, size=(240, 320))
    return drawn.mask, np.where(drawn.mask > 0, ROPE, TABLE), drawn.curve


def seen(covered: bool, with_depth: bool, frames: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Return visibility and pixels after the rope's last fifth has vanished, with or without a hand."""
    detector = ShapeDetector([Centerline(n=20, ends="tips", anchor=(40.0, 120.0))])
    mask, depth, _ = wavy_rope(220)
    for _ in range(5):
        detector.detect_mask(mask, depth if with_depth else None, CAMERA)
    if covered:
        mask, depth = mask.copy(), depth.copy()
        mask[:, 220:], depth[:, 220:] = 0, HAND
    else:
        mask, depth, _ = wavy_rope(180)
    for _ in range(frames):
        detector.detect_mask(mask, depth if with_depth else None, CAMERA)
    shape = detector.detect_mask(mask, depth if with_depth else None, CAMERA).shapes[0]
    assert shape.ok
    return shape.visible, shape.pixels


@pytest.mark.parametrize("with_depth", [False, True])
def test_an_end_under_a_hand_is_hidden(with_depth):
    visible, pixels = seen(True, with_depth)
    assert 2 <= (~visible).sum() <= 6
    assert pixels[-1, 0] > 245


@pytest.mark.parametrize(("seed", "approach", "speed"), [(0, 4.0, 3.0), (0, 16.0, 0.0), (1, 16.0, 3.0)])
def test_a_shadow_is_noticed_where_depth_is_noisy(seed, approach, speed):
    """1.6 m away, a D455's depth varies by 3.6 mm; with a limit of 4 mm, 6 to 10 frames are off by 10 mm and more."""
    frames = covered_rope(seed, "shadow", approach, speed, depth=True, noise=True, size=(240, 320), away=1.6)
    row = visible_row(frames)
    assert row.far <= 3
    assert row.slips + row.refused <= 1


def test_a_rope_whose_tips_are_free_is_as_long_as_it_is_seen_after_a_while():
    """At first its end may be folded back on the rope: for a second it is not visible, and no point is put beyond."""
    visible, pixels = seen(False, True)
    assert not visible[-2:].any()
    assert pixels[:, 0].max() < 224
    visible, pixels = seen(False, True, frames=40)
    assert visible.all()
    assert pixels[-1, 0] == pytest.approx(220, abs=2)


def test_an_end_stays_under_a_hand_whose_depth_fails_for_a_few_frames():
    """Its points lie where they did, and the next frames that show the hand find them there."""
    detector = ShapeDetector([Centerline(n=20, ends="tips", anchor=(40.0, 120.0))])
    mask, depth, curve = wavy_rope(220)
    for _ in range(5):
        detector.detect_mask(mask, depth, CAMERA)
    mask, hand = mask.copy(), depth.copy()
    mask[:, 220:], depth[:, 220:], hand[:, 220:] = 0, TABLE, HAND
    for over in [hand] * 3 + [depth] * 2 + [hand] * 2:
        shape = detector.detect_mask(mask, over, CAMERA).shapes[0]
        assert shape.ok
        assert 2 <= (~shape.visible).sum() <= 6
        assert shape.pixels[-1] == pytest.approx(curve[-1], abs=8)


@pytest.mark.parametrize(("last", "reason"), [(230, "in sight (at least 45%)"), (150, "")])
def test_a_rope_of_which_two_short_pieces_are_in_sight_is_refused(last, reason):
    detector = ShapeDetector([Centerline(n=20, ends="tips", anchor=(40.0, 120.0))])
    found = ""
    for hand in range(100, last + 1, 5):
        mask, depth, _ = wavy_rope(220)
        mask, depth = mask.copy(), depth.copy()
        mask[:, 100:hand], depth[:, 100:hand] = 0, HAND
        found = detector.detect_mask(mask, depth, CAMERA).shapes[0].reason
    assert found.endswith(reason)
    assert bool(found) == bool(reason)


def test_a_rope_does_not_become_longer_from_one_frame_to_the_next():
    detector = ShapeDetector([Centerline(n=20, ends="tips", anchor=(40.0, 120.0))])
    reasons = [detector.detect_mask(*wavy_rope(length)[:2], CAMERA).shapes[0].reason for length in (200, 200, 200, 210)]
    assert reasons[:3] == [""] * 3
    assert "longer than the rope" in reasons[3]


def test_what_has_no_depth_may_hide_an_end():
    detector = ShapeDetector([Centerline(n=20, ends="tips", anchor=(40.0, 120.0))])
    mask, depth, _ = wavy_rope(220)
    for _ in range(5):
        detector.detect_mask(mask, depth, CAMERA)
    mask, depth = mask.copy(), depth.copy()
    mask[:, 220:], depth[:, 220:] = 0, 0.0
    assert not detector.detect_mask(mask, depth, CAMERA).shapes[0].visible[-2:].any()


@pytest.mark.parametrize(
    ("shown", "found"),
    [("a hand", True), ("the rope, in a shadow", True), ("the table", False)],
)
def test_pieces_are_not_connected_over_a_gap_in_which_the_table_is_seen(shown, found):
    detector = ShapeDetector([Centerline(n=20, ends="tips", anchor=(40.0, 120.0))])
    mask, depth, _ = wavy_rope(220)
    for _ in range(5):
        detector.detect_mask(mask, depth, CAMERA)
    mask, depth = mask.copy(), depth.copy()
    mask[:, 120:180] = 0
    if shown != "the rope, in a shadow":
        depth[:, 120:180] = HAND if shown == "a hand" else TABLE
    reason = detector.detect_mask(mask, depth, CAMERA).shapes[0].reason
    assert ("connects pieces" in reason) != found
    assert bool(reason) != found


@pytest.mark.parametrize(("hider", "seed"), [("hand", 7101), ("arm", 7105)])
def test_a_rope_that_crosses_itself_under_a_hand_keeps_its_order(hider, seed):
    """The pieces around a hidden crossing look as if the loop ran the other way; of 61 frames 20 and 14 did that."""
    recording = record(Setting("crossing", hider, 0.0, 30, 1.0, 6.0, seed))
    detector, wrong, unsure = None, 0, 0
    for frame in itertools.takewhile(lambda frame: frame.stamp <= 2.0, recording.frames):
        detector = detector or new_detector(recording.camera, frame.nodes, 30)
        shape = detector.detect_mask(frame.mask, frame.depth, recording.camera, stamp=frame.stamp).shapes[0]
        unsure += bool(shape.reason)
        if shape.track_id == 1 and not shape.reason:
            assert shape.points3d is not None
            wrong += np.linalg.norm(shape.points3d - frame.nodes, axis=1)[shape.visible].mean() > 0.03
    assert wrong <= 6
    assert unsure <= 20


def under_hand(first: int, last: int, smear: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return mask and depth with a hand over columns `first` to `last` whose depth reaches `smear` further."""
    mask, depth, _ = wavy_rope(220)
    mask, depth = mask.copy(), depth.copy()
    mask[:, first:last] = 0
    depth[:, first - smear : last + smear] = HAND
    return mask, depth


def metric_detector() -> ShapeDetector:
    detector = ShapeDetector(
        [Centerline(n=20, ends="tips", anchor=(40.0, 120.0), spacing="m")], on_invalid="interpolate"
    )
    mask, depth, _ = wavy_rope(220)
    for _ in range(5):
        detector.detect_mask(mask, depth, CAMERA)
    return detector


@pytest.mark.parametrize("first", [110, 130, 150])
def test_a_long_end_that_a_hand_takes_at_once_stays_hidden(first):
    detector = metric_detector()
    whole = detector.detect_mask(*wavy_rope(220)[:2], CAMERA).shapes[0].pixels
    for _ in range(3):
        shape = detector.detect_mask(*under_hand(first, first + 25), CAMERA).shapes[0]
        assert shape.ok
    # Only the hand's near side is under it; where the rest should be the camera sees the table, and no rope.
    mask, depth = under_hand(first, first + 25)
    mask[:, first:] = 0
    for _ in range(5):
        shape = detector.detect_mask(mask, depth, CAMERA).shapes[0]
        assert shape.ok
        seen = shape.visible
        assert not seen[-3:].any()
        assert np.linalg.norm(shape.pixels[seen] - whole[seen], axis=1).max() < 6


@pytest.mark.parametrize("smear", [0, 6, 14])
def test_the_depth_of_a_hand_next_to_it_is_not_the_ropes(smear):
    detector = metric_detector()
    whole = detector.detect_mask(*wavy_rope(220)[:2], CAMERA).shapes[0]
    hidden = under_hand(120, 150, smear)
    for _ in range(2):
        detector.detect_mask(*hidden, CAMERA)
    shape = detector.detect_mask(*hidden, CAMERA).shapes[0]
    assert shape.ok
    assert whole.points3d is not None
    assert shape.points3d is not None
    valid = shape.valid
    assert 8 <= valid.sum() < 20
    gap = np.linalg.norm(np.diff(whole.points3d, axis=0), axis=1).mean()
    away = np.linalg.norm(shape.points3d - whole.points3d, axis=1)
    assert away[valid].max() < 0.3 * gap
    assert np.abs(shape.points3d[valid, 2] - ROPE).max() < 0.005


@pytest.mark.parametrize("slowly", [False, True])
@pytest.mark.parametrize(
    ("where", "share", "seed", "speed"),
    [("start", 0.1, 50, 10), ("start", 0.25, 50, 10), ("end", 0.25, 50, 10), ("middle", 0.25, 1, 4)],
)
def test_a_hand_moves_no_visible_point_and_hidden_points_are_flagged(where, share, seed, speed, slowly):
    detector, wrong, frames = None, np.zeros(2), 0
    for frame in hidden_rope(np.random.default_rng(seed), speed, share, where, creep=12 if slowly else 0):
        anchor = tuple(frame.rope.curve[0])
        detector = detector or ShapeDetector([Centerline(n=20, ends="tips", anchor=anchor)])
        shape = detector.detect_mask(frame.mask).shapes[0]
        assert not shape.reason
        truth = resample(np.ascontiguousarray(frame.rope.curve), 20)
        column, row = np.rint(truth).astype(int).T
        seen = frame.mask[row, column] > 0
        gaps = np.linalg.norm(shape.pixels - truth, axis=1) / (arc_length(truth)[-1] / 19)
        assert gaps[seen & shape.visible].max() < 0.5
        near_seen = seen | np.roll(seen, 1) | np.roll(seen, -1)
        wrong += [np.sum(seen & ~shape.visible), np.sum(~near_seen & shape.visible)]
        frames += 1
    assert frames == 180
    if where != "middle":
        assert wrong[0] <= 0.005 * 20 * frames
        assert wrong[1] == 0


def test_the_hidden_end_is_not_stretched_over_the_rest():
    detector = None
    for frame in hidden_rope(np.random.default_rng(4), 4.0, 0.25, "end", frames=60):
        curve = frame.rope.curve
        if detector is None:
            detector = ShapeDetector([Centerline(n=20, ends="tips", anchor=tuple(curve[0]))])
        shape = detector.detect_mask(frame.mask).shapes[0]
        gaps = np.linalg.norm(np.diff(shape.points2d, axis=0), axis=1)
        assert gaps.sum() == pytest.approx(frame.rope.length, rel=0.03)
        if frame.share:
            assert 3 <= (~shape.visible).sum() <= 6
            assert not shape.visible[-3:].any()
            assert shape.visible[:14].all()
            assert shape.ok
            assert 0.6 < shape.quality < 0.85


@pytest.mark.parametrize(
    ("seed", "cover", "approach", "speed", "depth", "slips", "share"),
    [
        # A bar comes over the second end: both tips look cut then, and little is missing of the second one yet.
        (104, "bar", 4.0, 0.0, False, 0, 0.8),
        nightly(106, "bar", 4.0, 3.0, False, 0, 0.8),
        # Under a bar for long: were it deeper than what is seen, the visible points would lie too close together.
        nightly(521, "bar", 1.0, 3.0, True, 2, 0.0),
        # Back in part after a long loss: its nodes are out of date, and nothing shows which end a hand still covers.
        nightly(20, "hand", 1.0, 3.0, False, 2, 0.0),
        # An end leaves while a bar lies over the middle.
        nightly(104, "bar", 1.0, 0.0, False, 2, 0.0),
        # Both tips are free for hundreds of frames, and the way under a slow bar is bridged straight.
        nightly(200, "bar", 0.5, 0.0, True, 0, 0.0),
        # Nothing of it was in sight for a while: what came back first had no end, or its own tip.
        nightly(6, "bar", 1.0, 0.0, False, 0, 0.95),
        nightly(102, "bar", 1.0, 0.0, False, 0, 1.0),
    ],
)
def test_what_passes_over_a_rope_moves_no_visible_point(seed, cover, approach, speed, depth, slips, share):
    rng = np.random.default_rng([seed, round(2 * approach), round(speed)])
    row = track(hidden_ropes(rng, cover, approach, speed, share=float(rng.uniform(0.15, 0.45))), depth=depth)
    assert row.slips <= slips, row
    assert row.refused <= (1 - share) * row.due, row
    assert row.frames > 100


def test_a_rope_that_comes_back_across_its_place_may_run_either_way():
    detector = ShapeDetector([Centerline(n=12, ends="tips", anchor=(150, 240))])
    level, upright, gone = np.zeros((3, 480, 640), np.uint8)
    cv2.line(level, (170, 240), (470, 240), (255.0,), 8)
    cv2.line(upright, (320, 90), (320, 390), (255.0,), 8)
    shape = [detector.detect_mask(mask).shapes[0] for mask in (*[level] * 5, *[gone] * 3, upright)][-1]
    assert shape.reason
    assert not shape.visible.any()


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


@pytest.mark.parametrize(("first", "in_doubt"), [(0.0, True), (0.3, False)])
def test_it_is_in_doubt_which_end_is_missing_where_a_free_end_may_be_folded_back(first, in_doubt):
    """Something hides the first end, but the prediction says that the last is missing: a hairpin may have closed."""
    at = (np.arange(16) + 0.5) / 16 - 0.5
    nodes = 300 * np.stack([at, 0.3 * np.clip(at - 0.2, 0, None)], axis=1) + (320, 240)
    rope = new_rope(ChainModel())
    rope["pixels"], rope["frames"] = 300.0, 10.0
    curve = np.column_stack([np.interp(np.linspace(first, first + 0.7, 64) - 0.5, at, row) for row in nodes.T])
    mask, cut = np.zeros((480, 640), np.uint8), round(curve[0, 0])
    cv2.polylines(mask, [np.rint(16 * curve).astype(np.int32)], False, 1, 8, cv2.LINE_8, 4)
    mask[:, :cut] = 0
    region = find_region(mask, Window(0, 0, 640, 480), 1, 0.0)
    track = Track(rope, nodes, np.zeros_like(nodes), Chain(16))
    before = Prediction(track, 1 / 30, ChainModel()).before
    scene = Scene(Frame(), Clock(), edge=Window(cut, 0, 640 - cut, 480))
    image = scene.in_mask(region)
    model = ChainModel().record
    state, *_ = step_chain(image, NO_CLOUD, region.area, resample(curve, 16), 8.0, 0.75, False, before, model)
    assert state["hidden"][0] == pytest.approx((0.3, 0.0), abs=0.08)
    assert ("in doubt which end" in reason_of(state, "mask")) == in_doubt


def test_a_rope_that_moves_between_two_hands_is_refused_after_a_while():
    """It is straight, and both of its ends are hidden: nothing shows how it moves along itself."""
    detector, reasons = ShapeDetector([Centerline(n=12, ends="tips", anchor=(150, 240))]), []
    for frame in range(60):
        mask = np.zeros((480, 640), np.uint8)
        depth = np.full(mask.shape, 0.8, np.float32)
        cv2.line(mask, (170, 240 + 2 * frame), (470, 240 + 2 * frame), (255.0,), 8)
        depth[mask > 0] = 0.79
        if frame >= 10:
            mask[:, :200] = mask[:, 440:] = 0
            depth[:, :200] = depth[:, 440:] = 0.7
        shape = detector.detect_mask(mask, depth, Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)).shapes[0]
        reasons.append(shape.reason)
    assert reasons[:20] == [""] * 20
    assert all("may have slid" in reason for reason in reasons[26:])
