"""Hidden ends: with depth the detector sees whether anything lies over them."""

from __future__ import annotations

import numpy as np
import pytest

from shape_obs import Centerline, Intrinsics, ShapeDetector
from shape_obs.bench.scenes import draw_rope
from shape_obs.frame import depth_images
from shape_obs.geometry.polyline import arc_length
from shape_obs.tracking.occluders import FREE, HIDDEN, chain_evidence

CAMERA = Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5)
TABLE, ROPE, HAND = 0.6, 0.585, 0.5


def rope(length: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return mask, depth and curve of a wavy rope that begins at u = 40."""
    u = np.linspace(40, 40 + length, 400)
    drawn = draw_rope(np.stack([u, 120 + 25 * np.sin((u - 40) / 40)], axis=1), 10.0, size=(240, 320))
    return drawn.mask, np.where(drawn.mask > 0, ROPE, TABLE), drawn.curve


def seen(covered: bool, with_depth: bool, frames: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Return visibility and pixels after the rope's last fifth has vanished, with or without a hand."""
    detector = ShapeDetector([Centerline(n=20, ends="tips", anchor=(40.0, 120.0))])
    mask, depth, _ = rope(220)
    for _ in range(5):
        detector.detect_mask(mask, depth if with_depth else None, CAMERA)
    if covered:
        mask, depth = mask.copy(), depth.copy()
        mask[:, 220:], depth[:, 220:] = 0, HAND
    else:
        mask, depth, _ = rope(180)
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
    mask, depth, curve = rope(220)
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
        mask, depth, _ = rope(220)
        mask, depth = mask.copy(), depth.copy()
        mask[:, 100:hand], depth[:, 100:hand] = 0, HAND
        found = detector.detect_mask(mask, depth, CAMERA).shapes[0].reason
    assert found.endswith(reason)
    assert bool(found) == bool(reason)


def test_a_rope_does_not_become_longer_from_one_frame_to_the_next():
    detector = ShapeDetector([Centerline(n=20, ends="tips", anchor=(40.0, 120.0))])
    reasons = [detector.detect_mask(*rope(length)[:2], CAMERA).shapes[0].reason for length in (200, 200, 200, 210)]
    assert reasons[:3] == [""] * 3
    assert "longer than the rope" in reasons[3]


def test_what_has_no_depth_may_hide_an_end():
    detector = ShapeDetector([Centerline(n=20, ends="tips", anchor=(40.0, 120.0))])
    mask, depth, _ = rope(220)
    for _ in range(5):
        detector.detect_mask(mask, depth, CAMERA)
    mask, depth = mask.copy(), depth.copy()
    mask[:, 220:], depth[:, 220:] = 0, 0.0
    assert not detector.detect_mask(mask, depth, CAMERA).shapes[0].visible[-2:].any()


def under_hand(first: int, last: int, smear: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return mask and depth with a hand over columns `first` to `last` whose depth reaches `smear` further."""
    mask, depth, _ = rope(220)
    mask, depth = mask.copy(), depth.copy()
    mask[:, first:last] = 0
    depth[:, first - smear : last + smear] = HAND
    return mask, depth


def metric_detector() -> ShapeDetector:
    detector = ShapeDetector(
        [Centerline(n=20, ends="tips", anchor=(40.0, 120.0), spacing="m")], on_invalid="interpolate"
    )
    mask, depth, _ = rope(220)
    for _ in range(5):
        detector.detect_mask(mask, depth, CAMERA)
    return detector


@pytest.mark.parametrize("first", [110, 130, 150])
def test_a_long_end_that_a_hand_takes_at_once_stays_hidden(first):
    detector = metric_detector()
    whole = detector.detect_mask(*rope(220)[:2], CAMERA).shapes[0].pixels
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
    whole = detector.detect_mask(*rope(220)[:2], CAMERA).shapes[0]
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


class TestEvidence:
    """What a single frame shows at a tip; the rope is 10 px wide, lies 15 mm above the table, and is seen up to 160."""

    LINE = np.stack([np.linspace(60, 240, 361), np.full(361, 120.0)], axis=1)
    VISIBLE = LINE[:201]

    @staticmethod
    def covers(curve: np.ndarray) -> np.ndarray:
        return draw_rope(curve, 10.0, size=(240, 320)).mask > 0

    def scene(self, rope: np.ndarray = VISIBLE) -> tuple[np.ndarray, np.ndarray]:
        """Return the mask of the visible piece, and the depth of a rope on a table."""
        return self.covers(self.VISIBLE), np.where(self.covers(rope), ROPE, TABLE)

    @staticmethod
    def evidence(mask: np.ndarray, depth: np.ndarray, curve: np.ndarray = VISIBLE) -> int:
        """Return what is known of the last point of a curve."""
        curve = np.ascontiguousarray(curve)
        known, _ = chain_evidence(
            curve, arc_length(curve), np.full(len(curve), ROPE), 10.0, depth_images(depth.astype(np.float32)),
            mask.astype(np.uint8), (0, 0), (0, 0, 320, 240),
        )  # fmt: skip
        return known[1]

    def test_what_lies_over_the_way_ahead_hides_the_tip(self):
        """A hand that touches it, a flat one 25 mm above, and a stick that covers a tenth of what is ahead."""
        mask, bare = self.scene()
        assert self.evidence(mask, bare) == FREE
        for first, last, z in ((162, 320, HAND), (162, 320, ROPE - 0.025), (164, 166, HAND)):
            depth = bare.copy()
            depth[:, first:last] = z
            assert self.evidence(mask, depth) == HIDDEN

    def test_what_is_far_ahead_or_hardly_nearer_than_the_rope_hides_nothing(self):
        """A hand 2.5 widths away, and a bump of the table 4 mm above the rope, as errors of depth make it."""
        mask, bare = self.scene()
        for first, z in ((185, HAND), (162, ROPE - 0.004)):
            depth = bare.copy()
            depth[:, first:] = z
            assert self.evidence(mask, depth) == FREE

    def test_a_surface_that_goes_on_under_a_shadow_hides_the_tip(self):
        """Depth is that of the rope within its noise, 1.5 mm, and behind it on both sides."""
        mask, depth = self.scene(self.LINE)
        depth += np.random.default_rng(0).normal(0, 0.0015, depth.shape)
        assert self.evidence(mask, depth) == HIDDEN

    def test_a_tape_that_is_no_higher_than_the_table_ends_where_it_is_seen_to(self):
        mask, _ = self.scene()
        assert self.evidence(mask, np.full(mask.shape, ROPE)) == FREE

    def test_a_shadow_that_falls_askew_turns_the_visible_tip_and_not_the_rope(self):
        """What is fitted follows the longer side of the cut: its last 12 px turn by 40 degrees."""
        mask, depth = self.scene(self.LINE)
        curve = self.VISIBLE.copy()
        curve[-24:, 1] += np.tan(np.radians(40)) * (curve[-24:, 0] - curve[-24, 0])
        assert self.evidence(mask, depth, curve) == HIDDEN

    def test_a_rope_goes_on_under_a_shadow_in_the_direction_that_it_has_next_to_it(self):
        """It turns by 69 degrees 40 px before."""
        angle = np.linspace(0, 1.2, 100)
        bend = np.stack([120 + 20 * np.sin(angle), 140 - 20 * np.cos(angle)], axis=1)
        on = bend[-1] + np.arange(0.5, 70.5, 0.5)[:, None] * [np.cos(1.2), np.sin(1.2)]
        whole = np.concatenate([self.LINE[:120], bend, on])
        seen = whole[:270]
        assert self.evidence(self.covers(seen), np.where(self.covers(whole), ROPE, TABLE), seen) == HIDDEN

    @pytest.mark.parametrize(("first", "known"), [(2.0, HIDDEN), (8.0, FREE)])
    def test_the_border_hides_a_rope_that_reaches_it(self, first, known):
        """The curve ends up to half a width before the mask does."""
        whole = np.stack([np.linspace(160, first if known == FREE else -20, 361), np.full(361, 120.0)], axis=1)
        mask = self.covers(whole)
        seen = whole[whole[:, 0] >= first]
        assert self.evidence(mask, np.where(mask, ROPE, TABLE), seen) == known

    @pytest.mark.parametrize("aside", [3.0, 6.0])
    def test_the_border_hides_no_tip_that_ends_before_it(self, aside):
        """One points at it and ends 3 px before it; the side of another grazes it, 6 px from its axis."""
        if aside == 3:
            curve = np.stack([np.linspace(160, 3, 361), np.full(361, 120.0)], axis=1)
        else:
            curve = np.stack([np.linspace(60, 160, 201), np.full(201, 6.0)], axis=1)
        mask = self.covers(curve)
        assert self.evidence(mask, np.where(mask, ROPE, TABLE), curve) == FREE
