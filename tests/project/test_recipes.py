"""The recipes of the page on bringing one's own segmentation run as they are printed, where their libraries are there.

``pip install onnx onnxruntime supervision`` into an environment with this package runs all of them.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from shape_obs import Centerline, HSVRange, ShapeDetector

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "segment-with-a-network.md"
RECIPES = dict(re.findall(r"^```py\n# (\w+)\.py\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), flags=re.M | re.S))
BLUE = HSVRange((95, 100, 60), (125, 255, 255))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    for name, code in RECIPES.items():
        (tmp_path / f"{name}.py").write_text(code, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    for name in RECIPES:
        sys.modules.pop(name, None)


def photo(shift=0):
    s = np.linspace(0, 1, 400)
    rope = np.stack([120 + 400 * s, 240 + shift + 60 * np.sin(6 * s)], axis=1)
    image = np.full((480, 640, 3), (200, 198, 190), np.uint8)
    cv2.polylines(image, [np.round(rope).astype(np.int32)], False, (20, 70, 160), 17, cv2.LINE_AA)
    return image


def far_from(shape, image):
    """Return the largest distance of the points from those that the colour gives, pixels."""
    expected = ShapeDetector([Centerline(n=20)], BLUE).detect(image).shapes[0]
    assert shape.ok, shape.reason
    return np.linalg.norm(shape.pixels - expected.pixels, axis=1).max()


def test_the_page_has_all_recipes():
    assert set(RECIPES) == {"onnx_masks", "box_masks", "sam_masks", "yolo_masks", "supervision_shapes"}
    for name, code in RECIPES.items():
        compile(code, name, "exec")


def test_a_box_prompt_follows_the_object(folder):
    detector = ShapeDetector([Centerline(n=20)], "box_masks:rope")
    for shift in (0, 10, 20, 30):
        assert far_from(detector.detect(photo(shift)).shapes[0], photo(shift)) < 3
    from box_masks import rope  # pyright: ignore[reportMissingImports]

    assert rope.box != rope.first
    assert not detector.detect(np.full((480, 640, 3), 200, np.uint8)).shapes[0].visible.any()
    assert rope.box == rope.first
