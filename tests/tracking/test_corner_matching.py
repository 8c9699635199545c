"""A hand over a corner of a tracked cloth: reported while it is there, and the numbering is kept."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from shape_obs import ShapeDetector, Surface
from shape_obs.bench.scenes import moving_sheet
from shape_obs.compiled import compiled
from shape_obs.geometry.coons import SIDE, side_lengths
from shape_obs.tracking.corner_matching import (
    FITS,
    LONGER,
    MOVED,
    SHORTER,
    STRAYED,
    assign_corners,
    compare_sheet,
    known_slack,
    match_corners,
)
from shape_obs.tracking.validation import validate_sheet
from tests.benchmarks.scenes.sheets import true_lattice


@pytest.mark.parametrize("radius", [12, 30])
@pytest.mark.parametrize("corner", [(0, 0), (-1, -1)])
def test_a_covered_corner_is_put_back_and_is_not_visible(radius, corner):
    detector = ShapeDetector([Surface(rows=4, cols=8, ends="tips")], max_age=1.0)
    first = None
    for index, sheet in enumerate(moving_sheet(np.random.default_rng(3), 4, 40)):
        true = true_lattice(sheet.points, 4, 8, "tips")
        covered = 15 <= index < 30
        mask = sheet.mask.copy()
        if covered:
            cv2.circle(mask, np.rint(true[corner]).astype(int).tolist(), radius, 0, -1)
        shape = detector.detect_mask(mask).shapes[0]
        assert not shape.reason, index
        places = [true_lattice(np.rot90(sheet.points, k), 4, 8, "tips") for k in range(4)]
        found = shape.pixels.reshape(4, 8, 2)
        if first is None:  # whichever corner the image calls the first, it stays the first
            first = int(np.argmin([np.abs(place - found).max() for place in places]))
        assert np.linalg.norm(places[first] - found, axis=-1).max() < 12
        at = np.argmin(np.linalg.norm(places[first].reshape(-1, 2) - true[corner], axis=1))
        assert shape.visible[at] != covered


QUAD = np.array([[0.0, 0], [200, 10], [190, 120], [-10, 110]])


def strayed(expected: np.ndarray, found: np.ndarray, freedom: float = STRAYED) -> str:
    _, corner, share = match_corners(expected, np.ascontiguousarray(found))
    return validate_sheet(0.0, (90.0, 0.0, 0.0, 0.0), "mask", 0.0, (corner, share), freedom).reason


def test_three_corners_that_move_together_give_the_place_of_the_fourth():
    rng = np.random.default_rng(0)
    turn = np.array([[0.9, -0.3], [0.3, 0.9]])
    moved = QUAD @ turn.T + (40, -25) + rng.normal(0, 1, (4, 2))
    assert strayed(QUAD, moved) == ""
    moved[2] += (-20, -12)
    assert strayed(QUAD, moved).startswith("corner 2 strays by ")
    assert strayed(QUAD, moved, freedom=0.3) == ""
    space = np.concatenate([QUAD, np.full((4, 1), 5.0)], axis=1)
    middle = space.mean(axis=0)
    assert strayed(space, Rotation.from_rotvec([0.7, -0.5, 0.3]).apply(space - middle) + middle) == ""


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), quarters=st.integers(0, 3), corner=st.integers(0, 3))
def test_the_corner_that_strays_is_that_of_least_squares(seed, quarters, corner):
    """Each corner is compared with the similarity transform of the other three, in the image and in space."""
    rng = np.random.default_rng(seed)
    found = QUAD + rng.uniform(-15, 15, (4, 2))
    found[corner] += rng.uniform(-25, 25, 2)
    away = []
    for k in range(4):
        rest = np.delete(np.arange(4), k)
        (x, y), ones = QUAD.T, np.ones(4)
        rows = np.stack([np.stack([x, -y, ones, 0 * ones], 1), np.stack([y, x, 0 * ones, ones], 1)], axis=1)
        solved = np.linalg.lstsq(rows[rest].reshape(6, 4), found[rest].reshape(6), rcond=None)[0]
        away.append(np.linalg.norm(rows[k] @ solved - found[k]))
    share = max(away) / np.linalg.norm(found - found.mean(axis=0), axis=1).max()
    expected = quarters, int(np.argmax(away)), pytest.approx(share)
    assert match_corners(QUAD, np.roll(found, quarters, axis=0)) == expected
    flat = (np.pad(points, ((0, 0), (0, 1))) for points in (QUAD, np.roll(found, quarters, axis=0)))
    assert match_corners(*flat) == expected


class TestAssignment:
    """Which of the places where an outline turns are the corners of ``QUAD``, whose half diagonal is 109 px."""

    SIDES = np.linalg.norm(np.roll(QUAD, -1, axis=0) - QUAD, axis=1)
    ALONG = np.concatenate([[0.0], np.cumsum(SIDES)])

    def assigned(self, places: np.ndarray, along: np.ndarray | None = None) -> list[int]:
        """Return the chosen places; ``along`` is their arc length and the whole one, if not straight."""
        if along is None:
            around = np.concatenate([places, places[:1]])
            along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(around, axis=0), axis=1))])
        slack, places = known_slack(self.SIDES, False, 1.0), np.ascontiguousarray(places)
        found, _ = assign_corners(QUAD, places, along[:-1].copy(), float(along[-1]), self.SIDES, slack, 0.035)
        return found.tolist()

    def test_a_sheet_that_moves_by_a_third_of_itself_keeps_its_corners(self):
        assert self.assigned(QUAD + (30.0, 20.0)) == [0, 1, 2, 3]

    def test_corners_that_are_found_two_pixels_off_are_no_hand(self):
        assert self.assigned(QUAD + 2 * np.array([[1, 0], [0, 1], [1, 0], [0, -1]])) == [0, 1, 2, 3]

    @pytest.mark.parametrize("cut", [10.0, 15.0, 25.0])
    def test_a_hand_over_a_corner_makes_two_that_are_not_the_sheets(self, cut):
        places = np.concatenate([QUAD[:2], QUAD[2] - [(0, cut), (cut, 0)], QUAD[3:]])
        assert self.assigned(places) == [0, 1, -1, 4]

    def test_a_side_with_something_over_its_middle_is_longer_and_has_its_corners(self):
        assert self.assigned(QUAD, self.ALONG + 40 * (np.arange(5) > 0)) == [0, 1, 2, 3]

    def test_wrinkles_that_lie_nearer_to_where_corners_were_are_not_the_corners(self):
        """Each corner has moved by (20, 12), and two more places follow it on the next side."""
        on = (np.roll(QUAD, -1, axis=0) - QUAD) / self.SIDES[:, None]
        places = (QUAD + (20, 12))[:, None] + np.array([0.0, 8.0, 16.0])[:, None] * on[:, None]
        assert self.assigned(places.reshape(-1, 2)) == [0, 3, 6, 9]

    @pytest.mark.parametrize(("shift", "turn", "scale"), [(55.0, 0.0, 1.0), (0.0, 0.5, 1.0), (0.0, 0.0, 1.25)])
    def test_corners_in_their_place_are_the_sheets_though_others_elsewhere_have_its_exact_form(
        self, shift, turn, scale
    ):
        """The right ones are 2 px off each: that is likelier than to move, turn or grow so much in a frame."""
        right = QUAD + 1.5 * np.array([[1, -1], [1, 1], [-1, -1], [1, 1]])
        rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        other = scale * (QUAD - QUAD.mean(axis=0)) @ rotation + QUAD.mean(axis=0) + (shift, 0.0)
        places = np.stack([right, other], axis=1).reshape(-1, 2)
        along = (self.ALONG[:, None] + [0.0, 20.0]).ravel()[:-1]
        assert self.assigned(places, along) == [0, 2, 4, 6]


@compiled("(f8[:,::1], f8[:,::1], f8[::1], f8[::1], b1, b1)")
def compared(border, known, sides, slack, metric, buckled):
    """Call a function that is compiled for compiled callers only."""
    return compare_sheet(border, known, sides, slack, metric, buckled)


class TestComparison:
    """A sheet of 200 x 100 pixels, or millimetres, whose whole border is compared with what is known of it."""

    @staticmethod
    def border() -> np.ndarray:
        corners = np.array([[0.0, 0], [200, 0], [200, 100], [0, 100]])
        share = np.arange(SIDE)[:, None] / SIDE
        return np.concatenate([corners[k] + share * (corners[(k + 1) % 4] - corners[k]) for k in range(4)])

    def verdict(self, border: np.ndarray, *, metric: bool = False, buckled: bool = False) -> int:
        known = self.border()
        if metric:
            known, border = (np.pad(points / 1000, ((0, 0), (0, 1))) for points in (known, border))
        sides = side_lengths(known)
        slack = known_slack(sides, metric, 0.001 if metric else 1.0)
        return compared(np.ascontiguousarray(border), known, sides, slack, metric, buckled)[0]

    def test_a_sheet_that_bends_or_is_sheared_has_no_part_hidden(self):
        bent, sheared = self.border(), self.border()
        bent[:, 1] += 20 * np.sin(bent[:, 0] / 200 * np.pi)
        sheared[:, 0] += 0.2 * sheared[:, 1]
        assert [self.verdict(border) for border in (self.border(), bent, sheared)] == [FITS] * 3

    @pytest.mark.parametrize("cut", [20.0, 30.0, 45.0])
    def test_a_hand_over_a_corner_makes_a_side_shorter(self, cut):
        border = self.border()
        over = np.maximum(cut - (300 - border.sum(axis=1)), 0) / 2
        assert self.verdict(border - over[:, None]) == SHORTER

    @pytest.mark.parametrize("depth", [8.0, 10.0, 14.0])
    def test_a_dent_in_a_side_is_no_border_of_the_sheet(self, depth):
        """It makes the side hardly longer."""
        border = self.border()
        upper = border[:, 1] == 0
        border[upper, 1] += np.maximum(depth - np.abs(border[upper, 0] - 100) / 2.6, 0)
        assert self.verdict(border) == MOVED

    @pytest.mark.parametrize(
        ("share", "buckled", "verdict"), [(0.9, True, FITS), (0.9, False, SHORTER), (0.5, True, SHORTER)]
    )
    def test_a_side_in_space_may_be_a_little_shorter_only_if_it_may_have_buckled(self, share, buckled, verdict):
        assert self.verdict(self.border() * (share, 1.0), metric=True, buckled=buckled) == verdict

    def test_a_side_in_space_may_not_be_longer(self):
        assert self.verdict(self.border() * (1.1, 1.0), metric=True, buckled=True) == LONGER
