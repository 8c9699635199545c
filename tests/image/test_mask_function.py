"""A function of the user's as the pixel rule: how often it is called, with what, and how it is saved."""

from __future__ import annotations

import subprocess
import sys
from functools import partial
from typing import Any

import numpy as np
import pytest

from shape_obs import (
    Centerline,
    Contour,
    HSVRange,
    Rectangle,
    ShapeDetector,
    SpecError,
    load_config,
    save_config,
    schema_hash,
)
from shape_obs.image.mask_function import MaskFunction

BLUE = HSVRange((100, 100, 60), (125, 255, 255))
MODULE = """
print("imported", __name__)

def blue(rgb, depth):
    return rgb[..., 2] > rgb[..., 0].astype(int) + 60

class Blue:
    def __call__(self, rgb, depth):
        return blue(rgb, depth)

segment = Blue()
"""


def is_blue(rgb, depth):
    return rgb[..., 2] > rgb[..., 0].astype(int) + 60


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Return the name of a module with a mask function."""
    (tmp_path / "my_masks.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    yield "my_masks"
    sys.modules.pop("my_masks", None)


class Recorder:
    """Record the calls."""

    def __init__(self):
        self.calls = []

    def __call__(self, rgb, depth):
        self.calls.append((rgb, depth))
        return is_blue(rgb, depth)


def test_it_is_called_once_for_each_frame_and_with_the_whole_image(blue):
    record = Recorder()
    rules: Any = {"kind": "callable", "function": record, "close": 5}, MaskFunction(record, min_share=0.5)
    shapes = [Centerline(), Contour(segmentation=rules[0]), Centerline(name="more", count=2, segmentation=rules[1])]
    roi = Rectangle(10, 10, 300, 220)
    detector = ShapeDetector(shapes, record, roi=roi)
    depth = np.full(blue.shape[:2], 700, np.uint16)
    for frame in range(4):
        detection = detector.detect(blue, depth)
        assert detection["centerline"].ok
        assert detection["contour"].ok
        assert len(record.calls) == frame + 1
    for rgb, seen in record.calls:
        assert rgb is blue
        assert seen.shape == depth.shape
        assert seen.dtype == np.uint16


def test_its_mask_gives_the_points_of_the_same_colour_rule(blue, wave):
    """Cold and warm, with a region of interest and a clean-up."""
    roi = Rectangle(5, 5, 310, 230)
    rule = {"open": 3, "close": 5, "min_area": 30}
    moving = [np.roll(blue, 2 * k, axis=0) for k in range(5)]
    own = ShapeDetector(segmentation=MaskFunction(is_blue, **rule), roi=roi)
    hsv = ShapeDetector(segmentation=HSVRange(BLUE.low, BLUE.high, **rule), roi=roi)
    for image in moving:
        np.testing.assert_array_equal(own.detect(image).shapes[0].pixels, hsv.detect(image).shapes[0].pixels)


@pytest.mark.parametrize("given", ["function", "path", "mapping", "spec", "object"])
def test_it_is_found_by_its_import_path(blue, module, given, tmp_path):
    rule = {
        "function": lambda: getattr(__import__(module), "blue"),  # noqa: B009
        "path": lambda: f"{module}:blue",
        "mapping": lambda: {"kind": "callable", "function": f"{module}:blue"},
        "spec": lambda: MaskFunction(f"{module}:blue"),
        "object": lambda: f"{module}:segment",
    }[given]()
    detector = ShapeDetector(["centerline"], rule)
    expected = ShapeDetector(["centerline"], BLUE).detect(blue).shapes[0]
    np.testing.assert_array_equal(detector.detect(blue).shapes[0].pixels, expected.pixels)
    save_config(tmp_path / "shape.yaml", {"segmentation": rule})
    function = "segment" if given == "object" else "blue"
    assert f"function: {module}:{function}" in (tmp_path / "shape.yaml").read_text()
    again = ShapeDetector(**load_config(tmp_path / "shape.yaml"))
    assert again.config == detector.config
    np.testing.assert_array_equal(again.detect(blue).shapes[0].pixels, expected.pixels)


def test_reading_a_config_imports_nothing(module, tmp_path):
    """The code runs when a detector is made."""
    save_config(tmp_path / "shape.yaml", {"segmentation": f"{module}:blue"})
    arguments = load_config(tmp_path / "shape.yaml")
    assert module not in sys.modules
    ShapeDetector(**arguments)
    assert module in sys.modules


def at_least(lead, rgb, depth):
    return rgb[..., 2] > rgb[..., 0].astype(int) + lead


class Model:
    def __call__(self, rgb, depth):
        return is_blue(rgb, depth)

    def segment(self, rgb, depth):
        return is_blue(rgb, depth)


@pytest.mark.parametrize(
    "function",
    [lambda rgb, depth: is_blue(rgb, depth), Model(), Model().segment, partial(at_least, 60)],
    ids=["lambda", "object", "method", "partial"],
)
def test_what_has_no_import_path_works_in_a_detector_but_cannot_be_saved(blue, function: Any, tmp_path):
    detector = ShapeDetector(["centerline"], function)
    for _ in range(2):
        assert detector.detect(blue).ok
    message = "cannot be saved or recorded, since it has no import path. Define a function with def at the top of a mo"
    for save in (
        lambda: save_config(tmp_path / "shape.yaml", {"segmentation": function}),
        lambda: save_config(tmp_path / "shape.yaml", {"shapes": [Centerline(segmentation=function)]}),
        detector.config.to_dict,
    ):
        with pytest.raises(SpecError, match=f"segmentation: .* {message}"):
            save()
    assert not (tmp_path / "shape.yaml").exists()


def test_it_does_not_change_the_schema_of_a_policy():
    own: Any = is_blue, lambda rgb, depth: None
    schema = schema_hash({"segmentation": BLUE})
    for function in own:
        assert schema_hash({"segmentation": function}) == schema
        assert schema_hash({"shapes": [Centerline(segmentation=function)]}) == schema


def test_a_function_of_the_script_itself_is_not_saved_to_a_file(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "from shape_obs import ShapeDetector, save_config\n"
        "def mask(rgb, depth): return rgb[..., 0] > 100\n"
        "detector = ShapeDetector(segmentation=mask)\n"
        "print(detector.config.segmentation.function)\n"
        "save_config('shape.yaml', {'segmentation': mask})\n"
    )
    done = subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stdout == "__main__:mask\n"
    assert done.returncode == 1
    assert "SpecError: segmentation: __main__:mask cannot be saved, since no other program can import it" in done.stderr
    assert not (tmp_path / "shape.yaml").exists()


@pytest.mark.parametrize(
    ("rule", "error", "message"),
    [
        ("my_masks:bleu", ValueError, "segmentation: module 'my_masks' has no 'bleu'; did you mean 'blue'?"),
        ("no_such_module:blue", ImportError, "segmentation: cannot import 'no_such_module': No module named"),
        ("my_masks:Blue", ValueError, r"expected a function \(rgb, depth\) -> mask as my_masks:Blue, got <class .*of"),
        ("./my_masks:blue", SpecError, "expected module:function, such as my_lab.masks:rope, got './my_masks:blue'"),
        ({"kind": "callable", "function": 3}, SpecError, "or its import path 'module:function', got 3"),
        (HSVRange, SpecError, "expected a mapping or a Segmentation, got <class"),
        ("__main__:gone", ValueError, "__main__:gone was defined in the script or notebook that recorded it, and is"),
    ],
)  # fmt: skip
def test_what_is_no_function_is_an_error(module, rule, error, message):
    with pytest.raises(error, match=message):
        ShapeDetector(["centerline"], rule)
