"""Pixel rules and regions of interest, pixel by pixel."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from shape_obs import DepthRange, Frame, GrayRange, HSVRange, Polygon, Rectangle, ShapeDetector, Whole


def mask_of(rule, rgb=None, depth=None):
    frame = Frame(rgb, depth)
    assert frame.size is not None
    mask = rule.apply(frame, Whole().window(frame.size))
    assert mask.dtype == np.uint8
    assert set(np.unique(mask)) <= {0, 255}
    return mask > 0


@given(hnp.arrays(np.uint8, (5, 6, 3)), st.tuples(*[st.integers(0, 179)] * 2), st.integers(0, 255), st.integers(0, 255))
def test_hsv_agrees_with_its_definition(image, hues, s, v):
    (low, high), hsv = hues, np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2HSV)).astype(int)
    hue = hsv[..., 0]
    within = (hue >= low) & (hue <= high) if low <= high else (hue >= low) | (hue <= high)
    expected = within & (hsv[..., 1] >= s) & (hsv[..., 2] >= v)
    np.testing.assert_array_equal(mask_of(HSVRange((low, s, v), (high, 255, 255)), image), expected)


@given(hnp.arrays(np.uint8, (4, 5)), st.integers(0, 255), st.integers(0, 255))
def test_gray_bounds_are_included(values, a, b):
    image = np.repeat(values[..., None], 3, axis=2)  # luma of a gray pixel is its value
    low, high = min(a, b), max(a, b)
    np.testing.assert_array_equal(mask_of(GrayRange(low, high), image), (values >= low) & (values <= high))


DEPTHS = st.sampled_from([float(np.float32(z)) for z in (0.0, -1.0, np.nan, np.inf, 0.3, 0.5, 0.699, 0.7, 0.701, 5.0)])


@given(hnp.arrays(np.float32, (3, 4), elements=DEPTHS))
def test_depth_in_metres_never_takes_what_is_unknown(depth):
    expected = np.isfinite(depth) & (depth >= np.float32(0.5)) & (depth <= np.float32(0.7))
    np.testing.assert_array_equal(mask_of(DepthRange(0.5, 0.7), depth=depth), expected)


@given(hnp.arrays(np.uint16, (3, 4)), st.integers(1, 65535), st.integers(1, 65535))
def test_depth_in_millimetres_includes_its_bounds(depth, a, b):
    near, far = min(a, b), max(a, b)
    expected = (depth >= near) & (depth <= far)
    np.testing.assert_array_equal(mask_of(DepthRange(near / 1000, far / 1000), depth=depth), expected)
    assert (mask_of(DepthRange(1e-9, 100.0), depth=depth) == (depth > 0)).all()  # zero is no depth


def test_opening_removes_specks_and_closing_fills_gaps():
    image = np.zeros((20, 30, 3), np.uint8)
    image[5:12, 3:25] = 255
    image[5:12, 14:16] = 0  # a gap of two
    image[17, 27] = 255  # a speck
    bare = mask_of(GrayRange(low=128), image)
    assert bare[17, 27]
    assert not bare[8, 14]
    closed = mask_of(GrayRange(low=128, close=3), image)
    assert closed[6:11, 14:16].all()
    assert closed[17, 27]
    both = mask_of(GrayRange(low=128, open=3), image)
    assert not both[17, 27]
    assert not both[8, 14]
    assert (mask_of(GrayRange(low=128, open=1, close=1), image) == bare).all()


class TestROI:
    SIZE = (240, 320)

    def test_a_window_is_clipped_to_the_image(self):
        assert Whole().window(self.SIZE) == (0, 0, 320, 240)
        assert Rectangle(-10, 20, 50, 900).window(self.SIZE) == (0, 20, 40, 220)
        assert Polygon(((10, 20), (400, 20), (10, 100.5))).window(self.SIZE) == (10, 20, 310, 82)

    @pytest.mark.parametrize(
        "roi", [Rectangle(320, 0, 10, 10), Rectangle(-20, 0, 20, 10), Polygon(((400, 0), (500, 0), (500, 50)))]
    )
    def test_a_region_outside_the_image_is_reported(self, roi, wave):
        with pytest.raises(ValueError, match=r"the region of interest .* lies outside the image of 320 x 240 pixels"):
            ShapeDetector(roi=roi).detect_mask(wave.mask)

    def test_a_polygon_blanks_its_outside(self, wave):
        roi = Polygon(((0, 0), (160, 0), (160, 239), (0, 239)))
        shape = ShapeDetector(roi=roi).detect_mask(wave.mask).shapes[0]
        assert shape.ok
        assert shape.points2d[:, 0].max() <= 160.5
        triangle = Polygon(((0, 0), (319, 0), (0, 239)))
        window = triangle.window(self.SIZE)
        full = np.full(self.SIZE, 255, np.uint8)
        inside = triangle.blank(full, window)
        assert full.all(), "the mask given stays as it is"
        v, u = np.mgrid[:240, :320]
        beyond = u / 319 + v / 239 - 1
        assert inside[beyond < -0.01].all()
        assert not inside[beyond > 0.01].any()

    @given(left=st.integers(0, 40), top=st.integers(0, 80), right=st.integers(285, 320), bottom=st.integers(195, 240))
    def test_points_do_not_depend_on_the_window(self, wave, left, top, right, bottom):
        """A window around the whole rope gives the whole image's points, in the image's pixels."""
        whole = ShapeDetector().detect_mask(wave.mask).shapes[0]
        roi = Rectangle(left, top, right - left, bottom - top)
        seen = ShapeDetector(roi=roi).detect_mask(wave.mask).shapes[0]
        np.testing.assert_allclose(seen.points2d, whole.points2d, atol=0.6)  # the cells' grid moves with the window
