"""Contour registration: an outline that has turned is numbered from the place where it began before."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shape_obs import Contour, Intrinsics, ShapeDetector
from shape_obs.bench.scenes import draw_blob
from shape_obs.compiled import compiled
from shape_obs.geometry.curve import FittedCurve, TrackHints
from shape_obs.geometry.topology import Ring
from shape_obs.tracking.prediction import Prediction
from shape_obs.tracking.registration import blend, index_shift, match_outline, renumber_outline
from shape_obs.tracking.registration_in_space import blend_space, index_shift_space
from tests.benchmarks.scenes.blobs import random_blob


def one(mask: np.ndarray, detector: ShapeDetector | None = None) -> Any:
    return (detector or ShapeDetector([Contour()])).detect_mask(mask).shapes[0]


@compiled("(f8[:,::1], f8[:,::1], f8[:,::1])")
def shift_of(reference, predicted, found):
    """Call a function that is compiled for compiled callers only."""
    return index_shift(reference, predicted, found)[0]


@compiled("(f8[:,::1], f8[:,::1])")
def blended(reference, found):
    """Call a function that is compiled for compiled callers only."""
    return blend(reference, found)


class TestRegistration:
    @settings(max_examples=25)
    @given(
        seed=st.integers(0, 2**32 - 1),
        turn=st.floats(-0.6, 0.6),
        share=st.floats(0, 1),
        dimension=st.sampled_from([2, 3]),
    )
    def test_a_turned_outline_is_found_again(self, seed, turn, share, dimension):
        rng = np.random.default_rng(seed)
        angle = np.linspace(0, 2 * np.pi, 800, endpoint=False)
        radius = np.ones(800)
        for k in (1, 2, 3):
            radius += rng.uniform(0.05, 0.1) * np.cos(k * angle + rng.uniform(0, 6))
        points = np.zeros((800, dimension))
        points[:, :2] = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        if dimension == 3:
            points[:, 2] = 0.3 * np.cos(2 * angle + rng.uniform(0, 6)) + 0.2 * np.sin(3 * angle)
        points *= 100
        rotation = np.eye(dimension)
        rotation[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        moved = points @ rotation.T + rng.uniform(-300, 300, dimension)
        before, after = (FittedCurve.through(p, np.zeros(800, bool), closed=True) for p in (points, moved))
        at = np.arange(64) / 64
        nodes, found = before.at(at * before.size), after.starting_at(-share * after.size)
        if dimension == 2:
            behind = shift_of(nodes, nodes, found.at(at * after.size))
            assert abs((behind - 64 * share + 32) % 64 - 32) < 0.05
            renumbered = renumber_outline(found.points, nodes, nodes)[2]
        else:
            prediction = Prediction(nodes, before.size, Ring(64), TrackHints(), 1.0, 0.0, True)
            renumbered = match_outline(found, prediction)[1]
        away = np.linalg.norm(renumbered - after.at(at * after.size), axis=1)
        assert away.max() < 0.05 * after.size / 64

    def test_a_marked_shape_is_found_again_after_any_turn(self):
        """A weakly marked one may pass for one that deformed: the marks must outweigh the cost of the turn."""
        blob = random_blob(np.random.default_rng(4), "c", size=(480, 480))
        start = one(blob.mask).points2d[0]
        for angle in np.linspace(-3, 3, 7):
            detector = ShapeDetector([Contour()])
            one(blob.mask, detector)
            turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
            turned = draw_blob((blob.outline - 239.5) @ turn + 239.5, size=(480, 480))
            np.testing.assert_allclose(one(turned.mask, detector).points2d[0], (start - 239.5) @ turn + 239.5, atol=1.5)

    def test_a_circle_stays_where_it_is_expected(self):
        angle = 2 * np.pi * np.arange(64) / 64
        circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        for slipped in (0.0, 3.25, 60.0):
            turned = np.stack([np.cos(angle - slipped * np.pi / 32), np.sin(angle - slipped * np.pi / 32)], axis=1)
            assert abs((shift_of(circle, circle, turned) - slipped + 32) % 64 - 32) < 1e-3

    @pytest.mark.parametrize("spacing", ["px", "m"])
    def test_a_small_circle_does_not_turn_by_the_noise_of_its_pixels(self, spacing):
        camera = Intrinsics(160, 120, 110.0, 110.0, 80.0, 60.0)
        angle, ends = 2 * np.pi * np.arange(400) / 400, []
        for seed in range(4):
            rng, detector = np.random.default_rng(seed), ShapeDetector([Contour(spacing=spacing)])
            middle, radius, moved, start = rng.uniform(60, 80, 2), rng.uniform(20, 28), rng.uniform(-0.2, 0.2, 2), None
            for frame in range(90):
                circle = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1) + middle + frame * moved
                mask = cv2.fillPoly(np.zeros((120, 160), np.uint8), [np.rint(16 * circle).astype(int)], 255, shift=4)
                depth = np.where(mask > 0, np.uint16(600), np.uint16(650))
                seen: dict[str, Any] = {"depth": depth, "camera": camera} if spacing == "m" else {}
                shape = detector.detect_mask(mask, **seen).shapes[0]
                away = (shape.pixels - middle - frame * moved) @ (1, 1j)
                start = away if start is None else start
                ends.append(np.angle(np.vdot(start, away)) * 32 / 2 / np.pi)
        assert np.abs(ends).max() < 0.8

    def test_a_blend_lies_over_what_was_found(self):
        rng = np.random.default_rng(0)
        for dimension, laid_over in ((2, blended), (3, blend_space)):
            reference = rng.normal(size=(40, dimension))
            rotation = np.linalg.qr(rng.normal(size=(dimension, dimension)))[0]
            rotation[0] *= np.linalg.det(rotation)
            found = reference @ rotation.T + np.arange(1, dimension + 1)
            np.testing.assert_allclose(laid_over(reference, found), found, atol=1e-9)


def outline(*waves: tuple[int, float, float], radius: float = 100.0) -> np.ndarray:
    """Return an outline in the plane z = 0, (1600, 3), whose radius has waves of (number, amplitude, phase)."""
    angle = 2 * np.pi * np.arange(1600) / 1600
    away = radius + sum(amplitude * np.cos(k * angle + phase) for k, amplitude, phase in waves)
    return np.stack([away * np.cos(angle), away * np.sin(angle), 0 * angle], axis=1)


def even(points: np.ndarray, start: float = 0.0) -> np.ndarray:
    """Return 64 equidistant nodes from a share of the outline on."""
    curve = FittedCurve.through(np.ascontiguousarray(points), np.zeros(len(points), bool), closed=True)
    return curve.starting_at(start * curve.size).even(64)


def turned(points: np.ndarray, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


def astray(reference: np.ndarray, found: np.ndarray, in_space: bool, start: float = 0.1) -> float:
    """Return by how many of 64 places the numbering is off; ``found`` begins at a share of its outline."""
    known, now = even(reference), even(found, start)
    if in_space:
        shift = index_shift_space(known, known, now, now, 1.0)[0]
    else:
        known, now = (np.ascontiguousarray(points[:, :2]) for points in (known, now))
        shift = shift_of(known, known, now)
    return float((shift + 64 * start + 32) % 64 - 32)


class TestFarTurns:
    """What fits almost as well after less of a turn is preferred, and what fits far better is found anywhere."""

    @pytest.mark.parametrize("in_space", [False, True])
    def test_an_outline_with_weak_marks_turns_as_little_as_it_can(self, in_space):
        """It is almost the same after half a turn, and 54 degrees back are likelier than 126 ahead."""
        shape = outline((2, 20, 0.4), (3, 9, 0), (5, 4, 2))
        assert abs(astray(shape, turned(shape, 2.2), in_space)) == pytest.approx(32, abs=0.3)

    @pytest.mark.parametrize("angle", [1.2, 2.2, 2.8])
    def test_an_outline_with_strong_marks_in_space_is_found_after_any_turn(self, angle):
        shape = outline((2, 10, 0.4), (3, 10, 0), (1, 20, 1))
        around = 2 * np.pi * np.arange(1600) / 1600
        shape[:, 2] = 60 * np.cos(2 * around) + 40 * np.sin(3 * around)
        assert astray(shape, turned(shape, angle), True) == pytest.approx(0, abs=0.1)

    def test_a_part_that_is_folded_up_by_75_degrees_leaves_the_numbering_of_the_rest(self):
        """A fifth of it bends out of the plane, by which the best rigid motion of the whole is off by a gap."""
        flat = outline((2, 20, 0.4), (3, 9, 0), (5, 4, 2))
        folded, over = flat.copy(), flat[:, 0] > 50
        folded[over, 0] = 50 + (flat[over, 0] - 50) * np.cos(np.radians(75))
        folded[over, 2] = (flat[over, 0] - 50) * np.sin(np.radians(75))
        assert astray(flat, folded, True, 0.3 / 64) == pytest.approx(0, abs=0.25)


class TestLearning:
    """A dent over 5 of 64 nodes of an outline 100 px in radius."""

    @staticmethod
    def followed(depth: float, frames: int, in_space: bool) -> float:
        """Return by which share of a dent the known outline has followed it after some frames."""
        true = even(outline((2, 20, 0.4), (3, 9, 0)))
        if not in_space:
            true = np.ascontiguousarray(true[:, :2])
        now, known = true.copy(), true
        now[10:15] *= 1 - depth / 100
        for _ in range(frames):
            known = (blend_space if in_space else blended)(known, now)
        return float(np.linalg.norm(known[12] - true[12]) / np.linalg.norm(now[12] - true[12]))

    @pytest.mark.parametrize("in_space", [False, True])
    def test_a_small_change_of_form_is_followed_in_two_seconds_and_not_at_once(self, in_space):
        assert self.followed(3.0, 1, in_space) < 0.3
        assert self.followed(3.0, 60, in_space) > 0.8

    def test_what_a_hand_hides_is_not_forgotten_in_half_a_second(self):
        """Without depth nothing but the known outline shows that it is a hand, and no change of form."""
        assert self.followed(60.0, 15, False) < 0.4
