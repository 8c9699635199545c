"""Colour tables and the sparse search give the same pixels as the rule itself."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shape_obs import ColourRule, DepthRange, Frame, GrayRange, HSVRange, Polygon, ShapeDetector, Whole
from shape_obs.image.colour_search import flat_pixels, look_up
from shape_obs.image.find_region import find_region, segment
from shape_obs.image.roi import Window
from shape_obs.image.segmentation import colour_table
from tests.scenes.ropes import KINDS, random_rope

BLUE = HSVRange((100, 120, 60), (125, 255, 255))


@dataclass(frozen=True)
class MostlyRed(ColourRule, kind="test_mostly_red"):
    lead: int = 40

    def matches(self, rgb):
        red, green, blue = np.moveaxis(rgb.astype(int), -1, 0)
        return red - np.maximum(green, blue) >= self.lead


@dataclass(frozen=True)
class BlueAndNear(HSVRange, kind="test_blue_and_near"):
    """A colour rule that looks at more than the colour."""

    def threshold(self, frame, window):
        return super().threshold(frame, window) & DepthRange(0.1, 0.5).threshold(frame, window)


def photograph(mask, rng, noise=5.0, colour=(30, 60, 200)):
    """Return a blue object on a grayish, uneven background, with lens blur and sensor noise, (H, W, 3) uint8."""
    size = (mask.shape[1], mask.shape[0])
    table = cv2.resize(rng.uniform(100, 190, (6, 8, 3)).astype(np.float32), size, interpolation=cv2.INTER_CUBIC)
    image = np.where(mask[..., None] > 0, np.array(colour, np.float32), 0.3 * table + 100)
    return np.clip(cv2.GaussianBlur(image, (0, 0), 0.8) + rng.normal(0, noise, image.shape), 0, 255).astype(np.uint8)


def assert_same_region(found, expected):
    np.testing.assert_array_equal(found.mask > 0, expected.mask > 0)
    np.testing.assert_array_equal(found.runs, expected.runs)
    assert (found.areas, found.window) == (expected.areas, expected.window)
    assert found.box == expected.box


class TestTable:
    HUES = st.tuples(*[st.integers(0, 179)] * 2)  # one pair in two wraps around
    RANGES = st.builds(
        lambda hues, s, v: HSVRange((hues[0], min(s), min(v)), (hues[1], max(s), max(v))),
        HUES,
        *[st.tuples(*[st.integers(0, 255)] * 2)] * 2,
    ) | st.builds(lambda a, b: GrayRange(min(a, b), max(a, b)), *[st.integers(0, 255)] * 2)

    @settings(max_examples=25)
    @given(RANGES, st.integers(0, 2**32 - 1), st.tuples(st.integers(1, 40), st.integers(1, 70)))
    def test_a_table_is_the_rule(self, rule, seed, size):
        """Colours are drawn from everywhere, and from near the rule's range."""
        rng = np.random.default_rng(seed)
        image = rng.integers(0, 256, (*size, 3), np.uint8)
        if isinstance(rule, HSVRange):
            near = np.array(rule.low) + rng.integers(-3, 4, (*size, 3))
            near = np.clip(near, 0, (179, 255, 255)).astype(np.uint8)
            image[::2] = cv2.cvtColor(near, cv2.COLOR_HSV2RGB)[::2]
        left, top = int(rng.integers(size[1])), int(rng.integers(size[0]))
        window = Window(left, top, int(rng.integers(size[1] - left)) + 1, int(rng.integers(size[0] - top)) + 1)
        expected = rule.threshold(Frame(image), window)
        np.testing.assert_array_equal(look_up(*flat_pixels(image, window), window[:4], colour_table(rule)), expected)

    def test_a_rule_of_ones_own_gets_a_table(self, wave):
        rng = np.random.default_rng(0)
        image = photograph(wave.mask, rng, noise=25, colour=(190, 60, 40))
        window, rule = Whole().window((240, 320)), MostlyRed()
        expected = rule.apply(Frame(image), window)
        assert set(np.unique(expected)) == {0, 255}
        np.testing.assert_array_equal(look_up(*flat_pixels(image, window), window[:4], colour_table(rule)), expected)
        shape = ShapeDetector(segmentation=rule).detect(image).shapes[0]
        assert shape.ok, shape.reason


class TestSegment:
    @pytest.mark.parametrize("kind", KINDS)
    def test_ropes_give_the_plain_path_s_region_to_the_pixel(self, kind):
        for seed in range(1):
            rng = np.random.default_rng(seed)
            rope = random_rope(rng, kind)
            frame, whole = Frame(photograph(rope.mask, rng)), Whole().window(rope.mask.shape)
            mask = BLUE.apply(frame, whole)
            expected = find_region(mask, whole, BLUE.min_area, BLUE.min_share)
            for width in (0.0, 8.0, 12.0):
                if width <= rope.width:
                    assert_same_region(segment(frame, whole, BLUE, Whole(), width), expected)

    def test_what_is_in_the_way_of_a_search_is_heeded(self, wave):
        """Opening, closing and a polygon change the mask after the colours; the table still serves."""
        rng = np.random.default_rng(5)
        frame, window = Frame(photograph(wave.mask, rng, noise=30)), Window(41, 50, 239, 170)
        polygon = Polygon(((0, 0), (319, 0), (0, 239)))
        for rule in (BLUE, replace(BLUE, open=3), replace(BLUE, close=3), replace(BLUE, open=2, close=5)):
            for roi in (Whole(), polygon):
                mask = roi.blank(rule.apply(frame, window), window)
                expected = find_region(mask, window, rule.min_area, rule.min_share)
                assert_same_region(segment(frame, window, rule, roi, 10.0), expected)

    def test_thin_objects_are_read_pixel_by_pixel(self):
        image = np.zeros((60, 90, 3), np.uint8)
        image[30, 5:85] = 255  # between the rows that are looked at
        rule, whole = GrayRange(low=128), Whole().window((60, 90))
        region = segment(Frame(image), whole, rule, Whole(), 1.0)
        assert region.areas == (80,)
        image[29] = image[30]  # and its neighbour, where the lattice lies
        image[30] = 0
        assert segment(Frame(image), whole, rule, Whole(), 0.0).areas == (80,)

    def test_a_rule_that_reads_more_than_the_colour_is_asked_itself(self, wave):
        image = photograph(wave.mask, np.random.default_rng(2))
        depth = np.full(wave.mask.shape, 0.3, np.float32)
        depth[:, 160:] = 0.9
        rule, whole = BlueAndNear(BLUE.low, BLUE.high), Whole().window(wave.mask.shape)
        for width in (0.0, 10.0):
            region = segment(Frame(image, depth), whole, rule, Whole(), width)
            assert region.area
            assert region.box.left + region.box.width <= 160
