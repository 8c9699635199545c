"""The reason of an empty mask says how many pixels match, what would match, and what to do."""

from __future__ import annotations

import re
import warnings

import numpy as np
import pytest

from shape_obs import Centerline, DepthRange, GrayRange, HSVRange, Rectangle, ShapeDetector
from shape_obs.image import mask_hints

BLUE = HSVRange((100, 100, 60), (125, 255, 255))
PICK = "`shape-obs detect IMAGE --pick u,v` proposes a segmentation from a pixel on the object"
SWAPPED = "would: give RGB, not BGR as OpenCV reads it (cv2.cvtColor(image, cv2.COLOR_BGR2RGB))"


def painted(image, colour):
    """Return the picture of the wavy rope in another colour."""
    rope = (image == np.array([30, 60, 200], np.uint8)).all(axis=2)
    return np.where(rope[..., None], np.array(colour, np.uint8), image)


def reason_of(rule, *frame, **options):
    shape = ShapeDetector(segmentation=rule, **options).detect(*frame).shapes[0]
    assert not shape.ok
    return shape.reason


def test_swapped_channels(blue, wave):
    count = np.count_nonzero(wave.mask)
    assert reason_of(BLUE, np.ascontiguousarray(blue[..., ::-1])) == (
        f"the mask is empty: 0 of 76800 pixels match segmentation 'hsv'; with red and blue swapped {count} {SWAPPED}; "
        f"{PICK}"
    )


def test_a_hue_in_degrees_and_gray_from_0_to_1(blue, wave):
    assert f"its bounds look like 0...1, but gray is 0...255; {PICK}" in reason_of(GrayRange(0, 1), blue)
    green, count = painted(blue, (40, 180, 60)), np.count_nonzero(wave.mask)
    assert (
        f"with half the hue {count} would: OpenCV's scale is h 0...179, s and v 0...255; give low=(55, 100, 60), "
        "high=(70, 255, 255)" in reason_of(HSVRange((110, 100, 60), (140, 255, 255)), green)
    )
    assert (
        f"with half the hue, and s and v in percent, {count} would: OpenCV's scale is h 0...179, s and v 0...255; give "
        "low=(55, 127, 102), high=(70, 255, 255)" in reason_of(HSVRange((110, 50, 40), (140, 100, 100)), green)
    )


def test_an_image_without_colours(blue):
    assert "the image is gray" in reason_of(BLUE, np.repeat(blue[..., :1], 3, axis=2))


def test_the_upper_bounds_of_tutorials():
    assert HSVRange((170, 100, 60), (180, 255, 255)) == HSVRange((170, 100, 60), (179, 255, 255))
    with pytest.raises(ValueError, match="179 for no upper limit"):
        HSVRange((100, 100, 60), (255, 255, 255))


def test_a_hue_from_0_to_255(blue, wave):
    green, count = painted(blue, (40, 180, 60)), np.count_nonzero(wave.mask)  # hue 64 of 180, 91 of 256
    message = f"with the hue times 180 / 256 {count} would: .* give low=\\(59, 100, 60\\), high=\\(70, 255, 255\\)"
    assert re.search(message, reason_of(HSVRange((85, 100, 60), (100, 255, 255)), green))


@pytest.mark.parametrize(
    ("colour", "low", "high", "around"),
    [
        ((200, 30, 60), (0, 100, 60), (10, 255, 255), "low=(170, 100, 60), high=(10, 255, 255)"),  # hue 175
        ((200, 60, 30), (165, 100, 60), (179, 255, 255), "low=(165, 100, 60), high=(10, 255, 255)"),  # hue 5
    ],
)
def test_red_on_the_other_side_of_0(blue, wave, colour, low, high, around):
    red, count = painted(blue, colour), np.count_nonzero(wave.mask)
    reason = reason_of(HSVRange(low, high), red)
    assert f"with a hue that wraps around {count} would: red lies on both sides of hue 0; give {around}" in reason


def test_half_a_red_rope_is_noticed_once(blue, wave):
    left = np.arange(blue.shape[1])[None, :, None] < 160
    red = np.where(left, painted(blue, (200, 30, 60)), painted(blue, (200, 60, 30))).astype(np.uint8)
    detector = ShapeDetector(segmentation=HSVRange((0, 100, 60), (10, 255, 255)))
    with pytest.warns(UserWarning, match=r"would with a hue that wraps around: .*give low=\(170, 100, 60\)"):
        detector.detect(red)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        detector.reset()
        detector.detect(red)
        ShapeDetector(segmentation=HSVRange((170, 100, 60), (10, 255, 255))).detect(red)
        ShapeDetector(segmentation=HSVRange((0, 100, 60), (10, 255, 255))).detect(painted(blue, (200, 60, 30)))


@pytest.mark.parametrize(
    ("low", "message"),
    [
        ((220, 100, 60), r"got \(220, 100, 60\). Of the hue give 154 if it is 0...255, or 110 if it is in degrees."),
        ((180, 100, 60), r"got \(180, 100, 60\). Of the hue give 0, which is the same hue, or 126 .* or 90 "),
        ((300, 100, 60), r"got \(300, 100, 60\). Of the hue give 150 if it is in degrees."),
        ((0.6, 0.4, 0.2), r"got \(0.6, 0.4, 0.2\). If that is 0...1, give \(107, 102, 51\)."),
        ([0.5, 1, 1], r"got \(0.5, 1, 1\). If that is 0...1, give \(90, 255, 255\)."),
    ],
)
def test_a_colour_on_another_scale_is_refused_with_the_right_one(low, message):
    with pytest.raises(ValueError, match=r"hsv: low must be \(h 0...179, s 0...255, v 0...255\), " + message):
        HSVRange(low, (170, 255, 255))


def test_pixels_outside_the_region_of_interest_and_small_pieces(blue, wave):
    count = np.count_nonzero(wave.mask)
    reason = reason_of(BLUE, blue, roi=Rectangle(0, 0, 320, 50))
    assert f"0 of 16000 pixels match segmentation 'hsv'; {count} pixels outside the region of interest match" in reason
    reason = reason_of(HSVRange(BLUE.low, BLUE.high, min_area=20000), blue)
    assert f"{count} of 76800 pixels match segmentation 'hsv', which lie in pieces of fewer than 20000 pixels" in reason
    reason = reason_of(HSVRange(BLUE.low, BLUE.high, open=31), blue)
    assert f"{count} of 76800 pixels match segmentation 'hsv', which open=31 removes or which lie in pieces" in reason


def test_depth_in_a_wrong_unit(blue):
    far = np.full(blue.shape[:2], 600, np.float32)
    assert reason_of(DepthRange(0.3, 0.9), None, far) == (
        "the mask is empty: 0 of 76800 pixels match segmentation 'depth'; half of the valid depth is below 600 m: "
        "floating depth is read as metres, but these look like millimetres; give depth / 1000, or the camera's uint16 "
        "image as it is"
    )
    reason = reason_of(DepthRange(0.3, 0.9), None, np.full(blue.shape[:2], 1500, np.uint16))
    assert reason.endswith("half of the valid depth is below 1.5 m")
    assert reason_of(DepthRange(0.3, 0.9), None, 0 * far).endswith("no pixel has a valid depth")


@pytest.mark.parametrize("shapes", [[Centerline()], [Centerline(count=2)], [Centerline(lift="cloud")]])
def test_every_kind_of_shape_has_the_hint(blue, intrinsics, shapes):
    detector = ShapeDetector(shapes, BLUE)
    depth = np.full(blue.shape[:2], 700, np.uint16)
    for shape in detector.detect(np.ascontiguousarray(blue[..., ::-1]), depth, intrinsics):
        assert SWAPPED in shape.reason


def test_it_is_looked_at_once_in_thirty_frames_and_not_after_the_shape_was_found(blue, monkeypatch):
    looks = []
    look = mask_hints.why_empty
    monkeypatch.setattr(mask_hints, "why_empty", lambda *arguments: looks.append(1) or look(*arguments))
    swapped, detector = np.ascontiguousarray(blue[..., ::-1]), ShapeDetector(segmentation=BLUE)
    reasons = [detector.detect(swapped).shapes[0].reason for _ in range(60)]
    assert len(looks) == 2
    assert all(SWAPPED in reason for reason in reasons)
    assert detector.detect(blue).ok
    assert [detector.detect(swapped).shapes[0].reason for _ in range(40)] == 40 * ["the mask is empty"]
    assert len(looks) == 2
    detector.reset()
    assert SWAPPED in detector.detect(swapped).shapes[0].reason
