"""Detection of markers, the region of interest between them, and the table from above."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace

import cv2
import numpy as np
import pytest

from shape_obs import HSVRange, MarkerLayout, Markers, Polygon, ShapeDetector, ShapeLostError, SpecError, TopView
from shape_obs.markers import MarkersNotSeen, find_markers, fourth_marker
from tests.benchmarks.scenes.tabletop import CAMERA, LAYOUT, MarkerScene, marker_scene

BLUE = HSVRange((100, 80, 40), (130, 255, 255))
ROPE = np.stack([np.linspace(0.15, 0.45, 60), 0.21 + 0.04 * np.sin(np.linspace(0, 6, 60))], axis=1)
OUTSIDE = ROPE + (0.0, 0.45)  # the same rope, off the marked area


def with_ropes(scene: MarkerScene) -> np.ndarray:
    picture = scene.rgb.copy()
    for rope, thick in ((ROPE, 5), (OUTSIDE, 9)):
        line = np.round(scene.to_pixels(rope) * 16).astype(np.int32)
        cv2.polylines(picture, [line], False, (20, 50, 170), thick, cv2.LINE_AA, 4)
    return picture


def hide(picture: np.ndarray, scene: MarkerScene, *ids: int) -> np.ndarray:
    picture = picture.copy()
    for each in ids:
        middle = scene.to_pixels(LAYOUT.array[each].mean(axis=0))
        cv2.circle(picture, np.round(middle).astype(int).tolist(), 30, (120, 110, 100), -1)
    return picture


def moved(picture: np.ndarray, du: float, dv: float) -> np.ndarray:
    return cv2.warpAffine(picture, np.array([[1.0, 0, du], [0, 1, dv]]), (640, 480), borderValue=(150, 150, 150))


def shifted(corners, by: float):
    return tuple((x + by, y + by / 4) for x, y in corners)


def found_rope(detection, scene: MarkerScene, shift=(0, 0)) -> bool:
    """Return whether the points lie along the rope inside the markers, and not on the thicker one outside."""
    shape = detection.shapes[0]
    if shape.reason:
        return False
    line = scene.to_pixels(ROPE) + shift
    return bool(np.linalg.norm(shape.points2d[:, None] - line, axis=2).min(axis=1).max() < 4)


def detector(**roi) -> ShapeDetector:
    return ShapeDetector(["centerline"], BLUE, roi={"kind": "markers", **roi}, max_age=0.1)


@pytest.fixture(scope="module")
def scene() -> MarkerScene:
    return marker_scene(3)


@pytest.fixture(scope="module")
def picture(scene) -> np.ndarray:
    return with_ropes(scene)


class TestTopView:
    def test_table_within_two_millimetres(self):
        for seed in range(6):
            scene = marker_scene(seed)
            view, places = TopView.find(scene.rgb, scene.layout), scene.grid()
            assert len(view.seen) == 4
            assert np.linalg.norm(view.to_table(scene.to_pixels(places)) - places, axis=1).max() <= 0.0005

    def test_to_pixels_is_the_way_back(self, scene):
        view = TopView.find(scene.rgb, LAYOUT)
        points = scene.grid(4).reshape(4, 4, 2)
        np.testing.assert_allclose(view.to_table(view.to_pixels(points)), points, atol=1e-9)
        assert view.seen == (0, 1, 2, 3)
        assert view.rms < 0.2
        assert np.isnan(view.to_table([np.nan, 3.0])).all()

    def test_two_markers_are_enough_and_one_is_not(self, scene):
        view = TopView.find(hide(scene.rgb, scene, 1, 3), LAYOUT)
        assert view.seen == (0, 2)
        off = np.linalg.norm(view.to_table(scene.to_pixels(scene.grid())) - scene.grid(), axis=1)
        assert off.max() < 0.004
        with pytest.raises(MarkersNotSeen, match="markers 0, 1, 2 of '4x4_50' not seen, at least 2 of 4 are needed"):
            TopView.find(hide(scene.rgb, scene, 0, 1, 2), LAYOUT)

    def test_warp_is_true_to_scale(self, scene):
        above = TopView.find(scene.rgb, LAYOUT).warp(scene.rgb, 1000, margin=0.03)
        assert above.shape == (480, 660, 3)
        for each, corners in find_markers(above).items():
            np.testing.assert_allclose(corners, (LAYOUT.array[each] + 0.03) * 1000 - 0.5, atol=0.4)

    def test_pose_of_the_table(self, scene):
        transform = TopView.find(scene.rgb, LAYOUT).transform_table_to_camera(CAMERA)
        np.testing.assert_allclose(transform[:3, 3], scene.transform[:3, 3], atol=0.003)
        np.testing.assert_allclose(transform[:3, :3], scene.transform[:3, :3], atol=0.01)
        bent = replace(CAMERA, model="brown_conrady", coeffs=(0.1, 0, 0, 0, 0))
        with pytest.raises(ValueError, match="rectified"):
            TopView.find(scene.rgb, LAYOUT).transform_table_to_camera(bent)

    def test_layout_errors(self):
        with pytest.raises(SpecError, match="at least two markers' width"):
            MarkerLayout.rectangle(marker=0.3, width=0.5, height=0.7)
        with pytest.raises(ValueError, match=r"its own id, got \[0, 1, 1, 3\]"):
            MarkerLayout.rectangle(0.05, 0.5, 0.5, ids=(0, 1, 1, 3))


@pytest.mark.parametrize("hidden", range(4))
def test_the_fourth_marker_is_where_it_is(scene, hidden):
    seen = find_markers(scene.rgb)
    place = seen.pop(hidden)
    for ids in ((0, 1, 2, 3), (3, 2, 1, 0)):
        assert np.linalg.norm(fourth_marker(seen, ids).mean(axis=0) - place.mean(axis=0)) < 1.0


class TestRegion:
    def test_what_lies_outside_is_not_seen(self, scene, picture):
        whole = ShapeDetector(["centerline"], BLUE).detect(picture)
        assert not found_rope(whole, scene)
        assert found_rope(detector().detect(picture), scene)

    def test_which_corners(self, scene):
        areas = {}
        for inside in ("inner", "centers", "outer"):
            region = Markers(inside=inside).place(scene.rgb, None).region
            assert isinstance(region, Polygon)
            areas[inside] = cv2.contourArea(np.array(region.points, np.float32))
        corners = scene.to_pixels(LAYOUT.array)
        outer = cv2.contourArea(np.array([corners[i, i] for i in range(4)], np.float32))
        inner = cv2.contourArea(np.array([corners[i, (i + 2) % 4] for i in range(4)], np.float32))
        assert areas["outer"] == pytest.approx(outer, rel=0.01)
        assert areas["inner"] == pytest.approx(inner, rel=0.01)
        assert areas["inner"] < areas["centers"] < areas["outer"]

    @pytest.mark.parametrize("hidden", range(4))
    def test_one_may_be_hidden_from_the_start(self, scene, picture, hidden):
        assert found_rope(detector().detect(hide(picture, scene, hidden)), scene)

    def test_all_may_be_hidden_later(self, scene, picture):
        finder = detector(every=2)
        covered = hide(picture, scene, 0, 1, 2, 3)
        assert found_rope(finder.detect(picture), scene)
        assert all(found_rope(finder.detect(covered), scene) for _ in range(5))

    def test_until_it_is_found_shapes_are_not_ok_and_say_why(self, scene, picture):
        finder = detector()
        shape = finder.detect(hide(picture, scene, 2, 3)).shapes[0]
        assert not shape.ok
        assert shape.reason == "markers 2, 3 not seen"
        assert not shape.visible.any()
        assert found_rope(finder.detect(picture), scene), "found as soon as the markers are seen"
        strict = ShapeDetector(["centerline"], BLUE, roi="markers", on_missing="raise")
        with pytest.raises(ShapeLostError, match="markers 2, 3 not seen"):
            strict.detect(hide(picture, scene, 2, 3))

    @pytest.mark.parametrize("hidden", [(), (1,), (0, 2)])
    def test_it_follows_the_camera(self, scene, picture, hidden):
        finder = detector(every=3)
        assert found_rope(finder.detect(picture), scene)
        after = moved(hide(picture, scene, *hidden), 37, -22)
        found_again = [found_rope(finder.detect(after), scene, (37, -22)) for _ in range(4)]
        assert found_again[-1]

    def test_one_marker_does_not_determine_where_the_camera_has_gone(self, scene, picture):
        finder = detector(every=1)
        finder.detect(picture)
        shape = finder.detect(moved(hide(picture, scene, 0, 1, 3), 60, 0)).shapes[0]
        assert shape.reason == "markers 0, 1, 3 not seen"
        assert found_rope(finder.detect(picture), scene)

    @pytest.mark.parametrize("twin", [copy.deepcopy, lambda it: pickle.loads(pickle.dumps(it))])
    def test_copies_go_on_identically(self, scene, picture, twin):
        first = detector(every=3)
        first.detect(picture)
        second = twin(first)
        for frame in (picture, hide(picture, scene, 1), moved(picture, 20, 10), moved(picture, 20, 10)):
            one, other = first.detect(frame).shapes[0], second.detect(frame).shapes[0]
            np.testing.assert_array_equal(one.points2d, other.points2d)

    def test_markers_that_stand_around_nothing_are_reported(self, scene, picture):
        strewn = marker_scene(
            3, layout=replace(LAYOUT, corners=(*LAYOUT.corners[:3], shifted(LAYOUT.corners[0], 0.25)))
        )
        shape = detector().detect(strewn.rgb).shapes[0]
        assert shape.reason == "markers 0, 1, 2, 3 do not stand in the corners of an area"

    @pytest.mark.parametrize(
        ("fields", "message"),
        [
            ({"ids": [0, 1, 2, 50]}, "markers of '4x4_50' have the ids 0 to 49, got 50"),
            ({"dictionary": "4x4"}, "unknown marker dictionary '4x4'; did you mean '4x4_50'"),
            ({"every": 0}, "expected every >= 1"),
            ({"inside": "iner"}, "unknown value 'iner'; did you mean 'inner'"),
        ],
    )
    def test_errors(self, fields, message):
        with pytest.raises(SpecError, match=message):
            detector(**fields)
