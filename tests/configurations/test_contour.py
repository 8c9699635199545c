"""Contours: numbering, holes, pieces, thin ribbons, rings, equal gaps in space, bad input."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shape_obs import Contour, ShapeDetector, SpecError
from shape_obs.bench.scenes import draw_blob
from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.outline import clockwise
from tests.benchmarks.outlines import seen_outline
from tests.benchmarks.scores import outline_score, tally_visible
from tests.scenes.blobs import KINDS, random_blob
from tests.scenes.flat_objects import View, in_space, noisy_depth, ring


def one(mask: np.ndarray, detector: ShapeDetector | None = None, **kwargs: Any) -> Any:
    return (detector or ShapeDetector([Contour(**kwargs)])).detect_mask(mask).shapes[0]


class TestNumbering:
    def test_without_an_anchor_it_begins_at_the_topmost_left_point(self):
        for kind in KINDS:
            blob = random_blob(np.random.default_rng(2), kind)
            first = one(blob.mask).points2d[0]
            assert first.sum() == pytest.approx(blob.outline.sum(axis=1).min(), abs=0.7)

    @settings(max_examples=20)
    @given(seed=st.integers(0, 2**32 - 1), where=st.floats(0, 1))
    def test_it_begins_at_the_anchor(self, seed, where):
        blob = random_blob(np.random.default_rng(seed))
        anchor = blob.outline[int(where * (len(blob.outline) - 1))]
        first = one(blob.mask, anchor=(float(anchor[0]), float(anchor[1]))).points2d[0]
        np.testing.assert_allclose(first, anchor, atol=0.8)


class TestHoles:
    @pytest.fixture
    def ring(self):
        angle = np.linspace(0, 2 * np.pi, 720, endpoint=False)
        circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        blob = draw_blob((160, 120) + 100 * circle, (130, 120) + 40 * circle, size=(240, 320))
        cv2.circle(blob.mask, (220, 120), 15, (0,), -1)
        blob.mask[60:62, 160:162] = 0
        return blob

    def test_the_largest_comes_first(self, ring):
        for hole, (middle, radius) in enumerate([((130, 120), 40), ((220, 120), 15)]):
            points = one(ring.mask, hole=hole, n=24).points2d
            assert clockwise(points)
            away = np.linalg.norm(points - middle, axis=1)
            assert away.mean() == pytest.approx(radius, abs=0.15 if hole == 0 else 0.6)
        assert np.linalg.norm(one(ring.mask).points2d - (160, 120), axis=1).mean() == pytest.approx(100, abs=0.1)

    def test_one_that_is_not_there_or_has_a_few_pixels_is_reported(self, ring):
        assert one(ring.mask, hole=3).reason == "hole 3 was asked for, the mask has 3"
        assert one(ring.mask, hole=2).reason == "the outline is too small: 4 samples, at least 8 are needed"


class TestPieces:
    def test_the_largest_is_taken_and_the_rest_costs_quality(self):
        mask = np.zeros((240, 320), np.uint8)
        cv2.circle(mask, (100, 120), 60, (255,), -1)
        alone = one(mask)
        cv2.circle(mask, (250, 120), 30, (255,), -1)
        shape = one(mask)
        np.testing.assert_array_equal(shape.points2d, alone.points2d)
        assert alone.quality == pytest.approx(1, abs=0.02)
        assert shape.quality == pytest.approx(np.sqrt(0.8), abs=0.03)

    def test_an_object_cut_by_the_images_edge_is_outlined_along_it(self):
        mask = np.zeros((240, 320), np.uint8)
        mask[:100, :150] = 255
        points = one(mask, n=100).points2d
        assert points.min(axis=0) == pytest.approx([-0.5, -0.5], abs=0.5)
        assert points.max(axis=0) == pytest.approx([149.5, 99.5], abs=0.5)


class TestThinAndSmall:
    @pytest.mark.parametrize("width", [3, 4, 6])
    def test_a_thin_ribbon_keeps_its_sides_apart(self, width):
        mask = np.zeros((120, 160), np.uint8)
        mask[60 : 60 + width, 20:140] = 255
        shape = one(mask, n=60)
        assert shape.ok, shape.reason
        true = np.array([[19.5, 59.5], [139.5, 59.5], [139.5, 59.5 + width], [19.5, 59.5 + width]])
        judged = outline_score(shape.points2d, true)
        assert judged.distance < 0.5
        upper, lower = shape.points2d[2:28, 1], shape.points2d[32:58, 1]
        assert np.all(upper < lower.min())

    def test_one_too_thin_is_reported(self):
        mask = np.zeros((120, 160), np.uint8)
        mask[60:62, 20:140] = 255
        assert one(mask).reason == "the mask is 2 px wide: too thin for an outline (at least 2.5)"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"n": 2}, r"contour: n must lie in 3...1000, got 2."),
        ({"hole": -1}, r"contour: hole must be None or >= 0, got -1."),
    ],
)
def test_bad_arguments_are_reported(arguments, message):
    with pytest.raises((ValueError, SpecError), match=message):
        Contour(**arguments)


class TestRing:
    @staticmethod
    def band(covered: tuple[int, int] = (0, 0)) -> np.ndarray:
        """Return a band about (120, 100) of which a sector, in degrees, is covered."""
        mask = np.zeros((200, 240), np.uint8)
        cv2.ellipse(mask, (120, 100), (80, 60), 10, 0, 360, 255, 14)
        if covered[0] != covered[1]:
            cv2.ellipse(mask, (120, 100), (110, 90), 10, *covered, 0, -1)
        return mask

    def test_a_closed_band_is_taken_and_a_covered_one_is_reported(self):
        assert one(self.band(), ring=True).ok
        for covered in ((20, 40), (90, 91), (200, 290)):
            assert one(self.band(covered), ring=False).quality > 0.5  # for all that is known it may be open
            shape = one(self.band(covered), ring=True)
            assert not shape.ok
            assert shape.reason == "the mask encloses no hole: something lies over the ring, or it is open"

    def test_a_track_goes_on_after_the_hand(self):
        detector = ShapeDetector([Contour(ring=True)])
        before = detector.detect_mask(self.band()).shapes[0]
        assert detector.detect_mask(self.band((20, 60))).shapes[0].reason
        after = detector.detect_mask(self.band()).shapes[0]
        np.testing.assert_allclose(after.pixels, before.pixels, atol=1.0)

    def test_specks_in_the_mask_make_no_ring(self):
        mask = self.band((20, 60))
        mask[np.random.default_rng(0).random(mask.shape) < 0.01] = 0
        assert not one(mask, ring=True).ok


def curve(points: np.ndarray, space: np.ndarray | None = None) -> FittedCurve:
    form = FittedCurve.through(np.ascontiguousarray(points), np.zeros(len(points), bool), True)
    return form if space is None else FittedCurve(form.points, form.interpolated, form.arc, True, space=space)


def test_points_have_equal_gaps_where_the_form_was_measured():
    around = 2 * np.pi * np.arange(400) / 400
    flat = np.stack([300 + 100 * np.cos(around), 200 + 40 * np.sin(around)], axis=1)
    tilted = np.stack([np.cos(around), np.sin(around), np.zeros(400)], axis=1) / 4
    elsewhere = tilted * (1, 0.2, 1)
    spec = Contour(n=16, spacing="m")
    places = spec.resample(curve(flat, tilted), curve(elsewhere)).places
    back = (places - (300, 200)) / (100, 40)
    gaps = np.linalg.norm(np.roll(back, -1, axis=0) - back, axis=1)
    assert np.ptp(gaps) / gaps.mean() < 0.01
    assert np.allclose(spec.resample(curve(flat), curve(elsewhere)).places[0], places[0])


def test_a_steep_outline_in_a_small_image_keeps_its_index():
    view = View(height=120)
    rng = np.random.default_rng((500, 7))
    scenes = noisy_depth(in_space(rng, ring(rng, True), view, "tilted", 8.0, 120), view, 500)
    found = tally_visible(list(seen_outline(scenes, view, True)))
    assert found.slips < 1, found
    assert found.refused < 1
