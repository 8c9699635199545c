"""Specs: dicts in and out, and errors that name what was meant."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import pytest

from shape_obs import (
    ROI,
    Centerline,
    Configuration,
    DepthRange,
    GrayRange,
    HSVRange,
    Polygon,
    Rectangle,
    Segmentation,
    ShapeDetector,
    SpecError,
)
from shape_obs.config.detector_config import DetectorConfig
from shape_obs.features import Points3D


def test_a_config_survives_json():
    rope = Centerline(name="é", n=7, anchor=(1.0, 2.0, 3.0), order="image", spacing="m", segmentation=GrayRange(3, 9))
    rules = HSVRange((9, 1, 2), (4, 5, 6)), DepthRange(0.1, 2.5, close=2, min_share=0.5)
    areas = Rectangle(-5, 1, 30, 40), Polygon(((0.5, 0), (1, 0), (1, -1e3)))
    for rule, roi in zip(rules, areas, strict=True):
        config = DetectorConfig(shapes=(rope,), segmentation=rule, roi=roi, anchor="hand", max_age=0.5)
        assert DetectorConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config


def test_to_dict_fills_defaults_in_and_names_the_kind():
    assert GrayRange(low=3).to_dict() == {
        "kind": "gray", "open": 0, "close": 0, "min_area": 20, "min_share": 0.05, "low": 3, "high": 255,
    }  # fmt: skip


def test_specs_mappings_and_names_are_the_same():
    assert Configuration.from_dict("centerline") == Configuration.from_dict({"kind": "centerline"}) == Centerline()
    assert Centerline.from_dict({"n": 5}) == Centerline.from_dict(Centerline(5)) == Centerline(n=5)
    assert ShapeDetector("centerline").config == ShapeDetector([Centerline()]).config == ShapeDetector().config


def test_lists_and_numpy_values_become_plain_ones_whichever_way_they_come():
    """A list would make the spec unhashable, a NumPy value would break JSON, and 0 would hash unlike 0.0."""
    low, high = np.array([1, 2, 3]), [4, 5, np.int64(6)]
    rule = HSVRange(low, high)  # type: ignore[arg-type]
    assert rule == HSVRange.from_dict({"low": low, "high": high}) == HSVRange((1, 2, 3), (4, 5, 6))
    assert hash(rule) == hash(HSVRange((1, 2, 3), (4, 5, 6)))
    shape = Centerline(n=np.int32(7), radius=0, anchor=np.array([1, 2]))  # type: ignore[arg-type]
    assert json.dumps(shape.to_dict()) == json.dumps(Centerline(n=7, radius=0.0, anchor=(1.0, 2.0)).to_dict())
    assert Polygon([[0, 0], [1, 0], [1, 1]]) == Polygon(((0.0, 0.0), (1.0, 0.0), (1.0, 1.0)))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("family", "value", "message"),
    [
        (Segmentation, {"kind": "hvs"}, "segmentation: unknown kind 'hvs'; did you mean 'hsv'? Known: callable, click"),
        (Segmentation, {"low": 3}, "segmentation: 'kind' is missing; known kinds: callable, click, click_net, depth"),
        (Segmentation, {"kind": "gray", "hihg": 3}, "gray: unknown field 'hihg'; did you mean 'high'? Known: open"),
        (Segmentation, {"kind": "hsv", "low": [1, 2, 3]}, "hsv: missing high; fields: open, close, min_area, "),
        (Segmentation, 7, "Segmentation: expected a mapping or a Segmentation, got 7 (int)."),
        (HSVRange, {"kind": "gray"}, "HSVRange: kind 'gray' is a GrayRange; expected 'hsv'."),
        (Segmentation, {"kind": "hsv", "low": [1, 2], "high": [1, 2, 3]}, "hsv.low: expected 3 values, got 2: [1, 2]."),
        (Segmentation, {"kind": "gray", "low": True}, "gray.low: expected int, got True (bool)."),
        (Segmentation, {"kind": "gray", "low": 1.5}, "gray.low: expected int, got 1.5 (float)."),
        (Configuration, {"kind": "centerline", "ends": "tip"}, "centerline.ends: unknown value 'tip'; did you mean 't"),
        (Configuration, {"kind": "centerline", "anchor": [1]}, "centerline.anchor: expected str | tuple[float, float]"),
        (ROI, {"kind": "polygon", "points": [[1, 2], [3]]}, "polygon.points[1]: expected 2 values, got 1: [3]."),
    ],
)  # fmt: skip
def test_errors_name_the_place_what_came_and_what_is_known(family, value, message):
    with pytest.raises(SpecError) as error:
        family.from_dict(value)
    assert str(error.value).startswith(message)


def test_a_nested_error_names_the_path_to_the_field():
    config = {
        "shapes": ["centerline", {"kind": "centerline", "name": "b", "segmentation": {"kind": "gray", "low": "x"}}]
    }
    with pytest.raises(SpecError) as error:
        DetectorConfig.from_dict(config)
    path = "DetectorConfig.shapes[1]: centerline.segmentation: gray.low: expected int, got 'x' (str)."
    assert str(error.value) == path


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Centerline(n=1), r"centerline: n must lie in 2...1000, got 1."),
        (lambda: Centerline(radius=-1), "centerline: radius must be >= 0 metres, got -1.0."),
        (lambda: Centerline(anchor=(np.nan, 1)), r"centerline: anchor must be finite, got \(nan, 1.0\)."),
        (lambda: HSVRange((180, 0, 0), (10, 255, 255)), "hsv: low must be .h 0...179, s 0...255, v 0...255., got"),
        (lambda: HSVRange((170, 0, 0), (190, 255, 255)), "10 if it wraps around: low 170 and high 10"),
        (lambda: HSVRange((-10, 0, 0), (10, 255, 255)), "170 if it wraps around: low 170 and high 10"),
        (lambda: HSVRange((1, 90, 0), (1, 80, 0)), "low saturation 90 is above high saturation 80; only hue wraps"),
        (lambda: GrayRange(9, 8), "gray: expected 0 <= low <= high <= 255, got low 9 and high 8."),
        (lambda: DepthRange(0.0, 1.0), "depth: expected 0 < near <= far in metres, got near 0.0 and far 1.0."),
        (lambda: Polygon(((0, 0), (1, 1))), "Polygon: needs at least three corners, got 2."),
        (lambda: Points3D(max_depth=0), "points3d: max_depth must be a positive number of metres, got 0.0."),
        (lambda: ShapeDetector(max_age=float("inf")), "expected finite max_age >= 0 and dt > 0 seconds, got inf"),
        (lambda: ShapeDetector(shapes=cast(Any, 5)), r"DetectorConfig.shapes: expected a list, got 5 \(int\)"),
        (lambda: ShapeDetector(["centerline"] * 2), "shapes: two are named 'centerline'; give each its own name=."),
        (lambda: ShapeDetector(on_mising="hold"), "unknown field 'on_mising'; did you mean 'on_missing'"),
    ],
)
def test_values_that_make_no_sense_are_reported(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_a_subclass_registers_a_new_kind():
    @dataclass(frozen=True)
    class Everything(Segmentation, kind="test-everything"):
        value: int = 255

        def threshold(self, frame: Any, window: Any) -> Any:
            return np.full((window.height, window.width), self.value, np.uint8)

    try:
        assert "test-everything" in Segmentation.kinds()
        assert "test-everything" not in Configuration.kinds()
        detector = ShapeDetector(segmentation={"kind": "test-everything", "value": 1})
        assert detector.config.segmentation == Everything(value=1)
        assert detector.detect(np.zeros((40, 300, 3), np.uint8)).shapes[0].ok  # a fat rope as large as the image
        with pytest.raises(SpecError, match=r"test-everything.value: expected int, got 'x' \(str\)"):
            Everything(value="x")  # type: ignore[arg-type]
    finally:
        Segmentation._members.pop("test-everything")
