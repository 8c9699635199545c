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


def test_onnx_runtime(folder):
    pytest.importorskip("onnxruntime")
    onnx = pytest.importorskip("onnx")
    kinds = onnx.TensorProto.FLOAT
    # One convolution of 1 x 1: blue - red - 0.2.
    weights = onnx.helper.make_tensor("weights", kinds, [1, 3, 1, 1], [-1.0, 0.0, 1.0])
    bias = onnx.helper.make_tensor("bias", kinds, [1], [-0.2])
    graph = onnx.helper.make_graph(
        [onnx.helper.make_node("Conv", ["image", "weights", "bias"], ["logits"])],
        "rope",
        [onnx.helper.make_tensor_value_info("image", kinds, [1, 3, 256, 256])],
        [onnx.helper.make_tensor_value_info("logits", kinds, [1, 1, 256, 256])],
        [weights, bias],
    )
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model)
    onnx.save(model, folder / "rope.onnx")
    detector = ShapeDetector([Centerline(n=20)], "onnx_masks:rope")
    for shift in (0, 3, 6):
        assert far_from(detector.detect(photo(shift)).shapes[0], photo(shift)) < 3


def test_a_box_prompt_follows_the_object(folder):
    detector = ShapeDetector([Centerline(n=20)], "box_masks:rope")
    for shift in (0, 10, 20, 30):
        assert far_from(detector.detect(photo(shift)).shapes[0], photo(shift)) < 3
    from box_masks import rope  # pyright: ignore[reportMissingImports]

    assert rope.box != rope.first
    assert not detector.detect(np.full((480, 640, 3), 200, np.uint8)).shapes[0].visible.any()
    assert rope.box == rope.first


def test_supervision_in_and_out(folder):
    sv = pytest.importorskip("supervision")
    from supervision_shapes import mask_of, to_detections, to_key_points  # pyright: ignore[reportMissingImports]

    image = photo()
    masks = np.array([BLUE.matches(image) > 0, np.zeros(image.shape[:2], bool)])
    masks[1, 20:40, 20:60] = True
    found = sv.Detections(xyxy=sv.mask_to_xyxy(masks), mask=masks, class_id=np.array([0, 5]))
    np.testing.assert_array_equal(mask_of(found, class_id=0), masks[0])
    np.testing.assert_array_equal(mask_of(found), masks.any(axis=0))
    detection = ShapeDetector([Centerline(n=20)]).detect_mask(mask_of(found, class_id=0), rgb=image)
    shape = detection.shapes[0]
    assert far_from(shape, image) == 0
    back = to_detections(detection)
    assert len(back) == 1
    np.testing.assert_allclose(back.xyxy[0], found.xyxy[0], atol=20)
    assert back.confidence[0] == pytest.approx(shape.quality)
    assert len(to_detections(ShapeDetector().detect_mask(np.zeros((99, 99), bool)))) == 0
    key_points, edges = to_key_points(shape)
    drawn = sv.EdgeAnnotator(edges=edges).annotate(image.copy(), key_points)
    assert (drawn != image).any()
    assert (sv.VertexAnnotator().annotate(image.copy(), key_points) != image).any()
