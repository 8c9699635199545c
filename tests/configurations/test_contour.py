"""Contours: numbering, tracking, holes, pieces, thin ribbons, bad input."""

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
from shape_obs.geometry.outline import Outline, clockwise
from shape_obs.geometry.polyline import MAX_SHIFT_AROUND, arc_length, catmull_rom, equal_chords
from shape_obs.geometry.topology import Ring
from shape_obs.metrics import spacing_cv
from tests.benchmarks.scenes.blobs import KINDS, random_blob
from tests.benchmarks.scores import outline_score


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

    def test_image_follows_the_image_and_tracked_the_material(self):
        rng = np.random.default_rng(4)
        blob = random_blob(rng, "c", size=(480, 480))
        tracked, image = ShapeDetector([Contour()]), ShapeDetector([Contour(order="image")])
        start, middle = one(blob.mask, tracked).points2d[0], np.array([239.5, 239.5])
        one(blob.mask, image)
        first, turn = start, np.eye(2)
        for angle in np.arange(1, 41) * np.pi / 40:
            turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
            turned = draw_blob((blob.outline - middle) @ turn + middle, size=(480, 480))
            first, topmost = one(turned.mask, tracked).points2d[0], one(turned.mask, image).points2d[0]
            assert topmost.sum() == pytest.approx(turned.outline.sum(axis=1).min(), abs=0.7)
        np.testing.assert_allclose(first, (start - middle) @ turn + middle, atol=1)

    @settings(max_examples=15)
    @given(
        seed=st.integers(0, 2**32 - 1),
        kind=st.sampled_from(KINDS),
        shift=st.tuples(st.integers(-8, 8), st.integers(-8, 8)),
        quarters=st.integers(0, 3),
    )
    def test_a_moved_and_turned_mask_gives_moved_and_turned_points(self, seed, kind, shift, quarters):
        blob = random_blob(np.random.default_rng(seed), kind, size=(480, 480))
        anchor = blob.outline[0]
        before = one(blob.mask, anchor=tuple(float(x) for x in anchor)).points2d.astype(np.float64)

        def moved(points: np.ndarray) -> np.ndarray:
            for _ in range(quarters):
                points = np.stack([points[..., 1], 479 - points[..., 0]], axis=-1)
            return points + shift

        mask = np.roll(np.rot90(blob.mask, quarters), (shift[1], shift[0]), axis=(0, 1)).copy()
        after = one(mask, anchor=tuple(float(x) for x in moved(anchor))).points2d
        # A quarter turn has the contour traced from another pixel, so other pixels share a sample.
        np.testing.assert_allclose(after, moved(before), atol=1e-3 if quarters == 0 else 1.5)

    @settings(max_examples=25)
    @given(n=st.integers(3, 200), kind=st.sampled_from(KINDS))
    def test_any_number_of_points(self, n, kind):
        blob = random_blob(np.random.default_rng(n), kind)
        shape = one(blob.mask, n=n)
        assert shape.ok
        assert len(shape) == n
        assert shape.visible.all()
        judged = outline_score(shape.points2d, blob.outline)
        assert judged.ordered
        assert judged.clockwise
        assert judged.distance < 0.4

    def test_the_points_close(self):
        shape = one(random_blob(np.random.default_rng(0)).mask)
        assert spacing_cv(shape.points2d, shape.layout) < 0.003
        assert shape.layout.edges()[-1].tolist() == [31, 0]


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

    def test_one_that_is_not_there_is_reported(self, ring):
        assert one(ring.mask, hole=3).reason == "hole 3 was asked for, the mask has 3"
        assert one(random_blob(np.random.default_rng(0)).mask, hole=0).reason == "hole 0 was asked for, the mask has 0"

    def test_one_of_a_few_pixels_is_reported(self, ring):
        shape = one(ring.mask, hole=2)
        assert not shape.ok
        assert shape.reason == "the outline is too small: 4 samples, at least 8 are needed"

    def test_a_piece_inside_a_hole_and_its_own_hole_are_not_taken(self, ring):
        mask = ring.mask.copy()
        cv2.circle(mask, (130, 120), 20, (255,), -1)
        cv2.circle(mask, (130, 120), 10, (0,), -1)
        points = one(mask, hole=0, n=24).points2d
        assert np.linalg.norm(points - (130, 120), axis=1).mean() == pytest.approx(40, abs=0.15)


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

    def test_halves_are_refused(self):
        mask = np.zeros((240, 320), np.uint8)
        cv2.circle(mask, (80, 120), 60, (255,), -1)
        cv2.circle(mask, (240, 120), 58, (255,), -1)
        shape = one(mask)
        assert not shape.ok
        assert shape.reason == "the mask falls into 2 pieces, and the largest is 52% of it (at least 60%)"

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

    @pytest.mark.parametrize("radius", [4, 6, 10])
    def test_a_small_blob(self, radius):
        mask = np.zeros((60, 80), np.uint8)
        cv2.circle(mask, (40, 30), radius, (255,), -1)
        points = one(mask, n=12).points2d
        expected = np.sqrt((mask > 0).sum() / np.pi)
        assert np.linalg.norm(points - (40, 30), axis=1).mean() == pytest.approx(expected, abs=0.35)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"n": 2}, r"contour: n must lie in 3...1000, got 2."),
        ({"n": 1001}, r"contour: n must lie in 3...1000, got 1001."),
        ({"hole": -1}, r"contour: hole must be None or >= 0, got -1."),
        ({"n": "32"}, r"contour.n: expected int"),
        ({"hole": 0.5}, r"contour.hole: expected"),
    ],
)
def test_bad_arguments_are_reported(arguments, message):
    with pytest.raises((ValueError, SpecError), match=message):
        Contour(**arguments)


def test_it_is_built_from_a_mapping():
    assert ShapeDetector([{"kind": "contour", "n": 12, "hole": 1}]).shapes[0].to_dict()["hole"] == 1
    assert ShapeDetector("contour").shapes[0].layout.size == 32


class TestClosedCurves:
    def test_the_smooth_curve_closes_like_an_open_one_that_goes_on(self):
        nodes = np.random.default_rng(0).normal(size=(7, 3))
        closed = catmull_rom(nodes, 4, True)
        assert closed.shape == (28, 3)
        np.testing.assert_allclose(closed[::4], nodes)
        turned = catmull_rom(np.roll(nodes, -2, axis=0), 4, True)
        np.testing.assert_allclose(turned, np.roll(closed, -8, axis=0))

    @given(n=st.integers(3, 100), seed=st.integers(0, 1000))
    def test_chords_are_equal_around(self, n, seed):
        blob = random_blob(np.random.default_rng(seed)).outline
        around = np.concatenate([blob, blob[:1]])
        arc = arc_length(around)
        at = equal_chords(around, arc, around, arc, n + 1, 0.0, MAX_SHIFT_AROUND)[1][:n]
        assert at[0] == 0
        assert np.all(np.diff(at) > 0)
        points = FittedCurve.through(blob, np.zeros(len(blob), bool), closed=True).at(at)
        assert spacing_cv(points, Ring(n)) < (0.003 if n > 6 else 0.2)

    @given(begin=st.floats(-3, 3))
    def test_a_curve_begins_anywhere(self, begin):
        square = FittedCurve.through(np.array([[0.0, 0], [4, 0], [4, 4], [0, 4]]), np.zeros(4, bool), closed=True)
        turned = square.starting_at(begin * 16)
        assert turned.size == pytest.approx(16)
        np.testing.assert_allclose(turned.points[0], square.at([begin * 16])[0], atol=1e-9)
        np.testing.assert_allclose(turned.at([1, 5]), square.at([begin * 16 + 1, begin * 16 + 5]), atol=1e-6)


@given(angle=st.floats(0, 2 * np.pi))
def test_a_straight_border_lies_where_the_mask_ends(angle):
    """The outline has no bias at any slope: half a pixel outside along the axes, 0.35 along the diagonals."""
    normal = np.array([np.cos(angle), np.sin(angle)])
    v, u = np.mgrid[:120, :120]
    inside = (np.abs((u - 59.3) * normal[0] + (v - 60.1) * normal[1]) < 20) & (np.hypot(u - 60, v - 60) < 50)
    contours = cv2.findContours(inside.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    traced = max(contours, key=len).reshape(-1, 2).astype(np.float64)
    border = Outline(traced if clockwise(traced) else traced[::-1])
    off = np.abs((border.points - (59.3, 60.1)) @ normal)
    along = np.abs((border.points - (59.3, 60.1)) @ [-normal[1], normal[0]])
    assert off[along < 35].mean() == pytest.approx(20, abs=0.25)
