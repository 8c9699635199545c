"""What a rule of the user's returns is checked on every path, and the error names the rule."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from shape_obs import ColourRule, Contour, Segmentation, ShapeDetector
from shape_obs.image.mask_check import checked_mask

WRONG: dict[str, tuple[Any, type[Exception], str]] = {
    "none": (lambda mask: None, TypeError, "expected a numpy array of bool or uint8, got NoneType: return the mask."),
    "list": (lambda mask: mask.tolist(), TypeError, "expected a numpy array of bool or uint8, got list."),
    "floats": (lambda mask: mask * 0.9, TypeError, "got an array of float64: compare it with a threshold, such as ma"),
    "labels": (lambda mask: mask * np.uint8(3), ValueError, "only the values 0 and 1, or 0 and 255, got 0, 3."),
    "ignored": (lambda mask: labels(mask), ValueError, "got 0, 1, 255. Of an image of labels return one, such as"),
    "int64": (lambda mask: mask * np.int64(7), ValueError, "expected only the values 0 and 1, or 0 and 255, got 0, 7."),
    "negative": (lambda mask: -mask.astype(np.int8), ValueError, "or 0 and 255, got -1, 0."),
    "batch": (lambda mask: mask[None], ValueError, r"got \(1, \d+, \d+\): take mask\[0\]"),
    "channel": (lambda mask: mask[..., None], ValueError, r"got \(\d+, \d+, 1\): take mask\[..., 0\]"),
    "transposed": (lambda mask: mask.T, ValueError, r"expected shape \(\d+, \d+\), got \(\d+, \d+\): it is transposed"),
    "small": (lambda mask: mask[::2, ::2], ValueError, r"got \(\d+, \d+\): resize it with cv2.resize\(mask, \(width"),
}  # fmt: skip
RIGHT = {
    "bool": lambda mask: mask,
    "ones": lambda mask: mask.astype(np.uint8),
    "full": lambda mask: mask * np.uint8(255),
    "int64": lambda mask: mask.astype(np.int64),
    "int64 full": lambda mask: mask * 255,
    "read-only": lambda mask: np.broadcast_to(mask, mask.shape),
    "fortran": lambda mask: np.asfortranarray(mask),
}
SWITCH = {"make": RIGHT["bool"]}


def labels(mask):
    found = mask.astype(np.uint8)
    found[0, 0] = 255
    return found


def is_blue(rgb):
    return rgb[..., 2] > rgb[..., 0] + 60


def by_function(rgb, depth):
    return SWITCH["make"](is_blue(rgb.astype(int)))


@dataclass(frozen=True)
class Threshold(Segmentation, kind="test_threshold"):
    def threshold(self, frame, window):
        assert frame.rgb is not None
        return SWITCH["make"](is_blue(frame.rgb[window.slices].astype(int)))


@dataclass(frozen=True)
class Apply(Segmentation, kind="test_apply"):
    def threshold(self, frame, window):
        raise AssertionError

    def apply(self, frame, window):
        assert frame.rgb is not None
        return SWITCH["make"](is_blue(frame.rgb[window.slices].astype(int)))


@dataclass(frozen=True)
class Matches(ColourRule, kind="test_matches"):
    def matches(self, rgb):
        return SWITCH["make"](is_blue(rgb.astype(int)))


@dataclass(frozen=True)
class MatchesUntabulated(Matches, kind="test_matches_untabulated"):
    def clean(self, mask):
        return mask


RULES = {
    "callable": (by_function, r"segmentation [\w.]*test_mask_check:by_function"),
    "threshold": (Threshold(), "segmentation 'test_threshold'"),
    "apply": (Apply(), "segmentation 'test_apply'"),
    "matches": (MatchesUntabulated(), "segmentation 'test_matches_untabulated'"),
}


@pytest.fixture(autouse=True)
def _right():
    SWITCH["make"] = RIGHT["bool"]


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_mask_is_an_error_that_names_the_rule(blue, rule, wrong):
    make, error, message = WRONG[wrong]
    spec, name = RULES[rule]
    SWITCH["make"] = make
    with pytest.raises(error, match=rf"^{name}: .*{message}"):
        ShapeDetector(segmentation=spec).detect(blue)


@pytest.mark.parametrize("rule", RULES)
def test_a_wrong_mask_in_the_search_window_of_a_warm_frame(blue, rule):
    make, error, message = WRONG["labels"]
    spec, name = RULES[rule]
    detector = ShapeDetector(segmentation=spec)
    for _ in range(3):
        assert detector.detect(blue).ok
    SWITCH["make"] = make
    with pytest.raises(error, match=rf"^{name}: .*{message}"):
        detector.detect(blue)
    SWITCH["make"] = RIGHT["bool"]
    assert detector.detect(blue).ok


@pytest.mark.parametrize("wrong", [name for name in WRONG if name != "transposed"])  # the table is made in squares
def test_a_wrong_colour_rule_is_an_error_when_its_table_is_made(wrong):
    make, error, message = WRONG[wrong]
    SWITCH["make"] = make
    with pytest.raises(error, match=rf"^segmentation 'test_matches': .*{message}"):
        ShapeDetector(segmentation=Matches(min_area=len(wrong)))


@pytest.mark.parametrize("wrong", [name for name in WRONG if name not in ("transposed", "small")])
def test_a_wrong_mask_that_is_given(wave, wrong):
    make, error, message = WRONG[wrong]
    with pytest.raises(error, match=rf"^mask: .*{message}"):
        ShapeDetector().detect_mask(make(wave.mask > 0))


@pytest.mark.parametrize("right", RIGHT)
@pytest.mark.parametrize("rule", RULES)
def test_every_right_mask_gives_the_same_points(wave, blue, rule, right):
    expected = ShapeDetector().detect_mask(wave.mask > 0).shapes[0]
    SWITCH["make"] = RIGHT[right]
    detector = ShapeDetector(segmentation=RULES[rule][0])
    given = ShapeDetector().detect_mask(RIGHT[right](wave.mask > 0)).shapes[0]
    for shape in (given, detector.detect(blue).shapes[0]):
        np.testing.assert_array_equal(shape.pixels, expected.pixels)


def test_the_images_of_a_rule_are_not_changed_by_its_clean_up(wave, blue):
    """A rule may return the same array in each frame; opening and closing work on a copy of a function's mask."""
    kept = wave.mask.astype(bool)
    before = kept.copy()
    detector = ShapeDetector([Contour()], {"kind": "callable", "function": lambda rgb, depth: kept, "open": 5})
    detector.detect(blue)
    np.testing.assert_array_equal(kept, before)


def test_a_tensor_is_named_with_what_to_do():
    class Tensor:
        def cpu(self):
            raise AssertionError

    with pytest.raises(TypeError, match=r"^rule: .* got Tensor: return its .cpu\(\).numpy\(\)."):
        checked_mask(Tensor(), None, "rule")
