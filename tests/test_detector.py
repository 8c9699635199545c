"""The detector against drawn ropes: points, order, anchors, gaps, several shapes, results and memory."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shape_obs import Centerline, HSVRange, ShapeDetector
from shape_obs.bench.scenes import draw_rope, resample
from tests.scenes.ropes import KINDS, random_rope

BLUE = HSVRange((100, 100, 60), (125, 255, 255))


def one(detector: ShapeDetector, mask: np.ndarray, **kwargs: Any) -> Any:
    return detector.detect_mask(mask, **kwargs).shapes[0]


def at_shares(curve: np.ndarray, shares: np.ndarray) -> np.ndarray:
    fine = resample(curve, 0.1)
    return fine[np.round(shares * (len(fine) - 1)).astype(int)]


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from(KINDS), n=st.sampled_from([8, 20, 50]))
def test_points_lie_on_the_centreline_in_order(seed, kind, n):
    """Run a sample of the measurement `shape-obs bench claims`."""
    rope = random_rope(np.random.default_rng(seed), kind)
    shape = one(ShapeDetector(Centerline(n=n, ends="tips")), rope.mask)
    assert shape.ok, shape.reason
    true = at_shares(rope.curve, np.linspace(0, 1, n))
    apart = [np.linalg.norm(shape.points2d - order, axis=1) for order in (true, true[::-1])]
    error = min(apart, key=np.mean)
    assert error.max() < 0.5 * rope.length / (n - 1) + 2
    assert shape.visible.all()
    assert shape.valid.all()


class TestAnchors:
    """Point 0 belongs to the end nearest the anchor, for anchors of every kind."""

    LEFT, RIGHT = (50.0, 140.0), (270.0, 112.0)

    def begins_at(self, mask, where, **kwargs):
        spec = kwargs.pop("spec", Centerline(ends="tips"))
        first = one(ShapeDetector(spec), mask, **kwargs).points2d[0]
        np.testing.assert_allclose(first, where, atol=2)

    def test_without_one_it_is_the_end_nearest_the_images_top_left(self, wave):
        self.begins_at(wave.mask, self.LEFT)
        self.begins_at(wave.mask[:, ::-1].copy(), (319 - 270, 112))
        upright = draw_rope(
            np.stack([np.linspace(150, 140, 200), np.linspace(20, 200, 200)], axis=1), 8, size=(240, 320)
        )
        self.begins_at(upright.mask, (150, 20))

    @pytest.mark.parametrize(("pixel", "end"), [((0, 239), LEFT), ((319, 0), RIGHT), ((200.5, 100), RIGHT)])
    def test_a_pixel(self, wave, pixel, end):
        self.begins_at(wave.mask, end, spec=Centerline(ends="tips", anchor=pixel))

    def test_a_point_in_the_base_frame(self, wave, overhead):
        for end in (self.LEFT, self.RIGHT):
            point = tuple(overhead.to_base(overhead.intrinsics.deproject(end, 1.0)))
            self.begins_at(wave.mask, end, spec=Centerline(ends="tips", anchor=point), camera=overhead)

    def test_a_name(self, wave, overhead):
        spec = Centerline(ends="tips", anchor="gripper")
        self.begins_at(wave.mask, self.RIGHT, spec=spec, anchors={"gripper": (300, 110), "other": (0, 0)})
        point = overhead.to_base(overhead.intrinsics.deproject(self.RIGHT, 1.0))
        self.begins_at(wave.mask, self.RIGHT, spec=spec, anchors={"gripper": point}, camera=overhead)

    def test_the_detectors_anchor_is_the_default_of_its_shapes(self, wave):
        shapes = [Centerline(name="a", ends="tips"), Centerline(name="b", ends="tips", anchor=(0, 0))]
        detection = ShapeDetector(shapes, anchor="hand").detect_mask(wave.mask, anchors={"hand": (319, 0)})
        np.testing.assert_allclose(detection["a"].points2d, detection["b"].points2d[::-1], atol=1e-3)

    @pytest.mark.parametrize(
        ("anchor", "anchors", "message"),
        [
            ("griper", {"gripper": (1, 2), "hand": (3, 4)}, "anchor 'griper' was not given; did you mean 'gripper'"),
            ("gripper", None, "anchor 'gripper' was not given; there are none."),
            ("gripper", {"gripper": (1, np.nan)}, r"anchor must be a finite \(u, v\) or \(x, y, z\), got \(1, nan\)"),
            ((1, 2, 3), None, r"anchor \(1.0, 2.0, 3.0\) in the base frame needs the camera's place"),
        ],
    )
    def test_one_that_cannot_be_resolved_is_reported(self, wave, anchor, anchors, message):
        with pytest.raises(ValueError, match=message):
            ShapeDetector(anchor=anchor).detect_mask(wave.mask, anchors=anchors)

    def test_one_behind_the_camera_is_reported(self, wave, overhead):
        with pytest.raises(ValueError, match="does not lie in front of the camera"):
            ShapeDetector(anchor=(0, 0, 2)).detect_mask(wave.mask, camera=overhead)


class TestOrder:
    """A straight rope that turns over: its left end becomes its right end."""

    @staticmethod
    def turning(step=3):
        for degrees in range(20, 200, step):
            direction = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
            yield draw_rope((160, 120) + np.linspace(-90, 90, 181)[:, None] * direction, 9, size=(240, 320))

    def test_tracked_survives_a_jump_that_needs_a_fresh_start(self):
        """The rope is found far from its prediction, in a sharper bend: its ends are where they were."""
        detector = ShapeDetector(Centerline(n=6, ends="tips"))
        for rope in self.turning():
            one(detector, rope.mask)
        s = np.linspace(-1, 1, 200)
        bent = draw_rope(np.stack([165 - 85 * s, 70 + 70 * s**2], axis=1), 9, size=(240, 320))  # from right to left
        shape = one(detector, bent.mask)
        assert shape.ok
        np.testing.assert_allclose(shape.points2d, at_shares(bent.curve, np.linspace(0, 1, 6)), atol=4)
        assert one(ShapeDetector(Centerline(n=6, ends="tips")), bent.mask).points2d[0, 0] < 100

    def test_reset_forgets_the_orientation(self):
        detector = ShapeDetector(Centerline(n=6, ends="tips"))
        ropes = list(self.turning())
        for rope in ropes:
            one(detector, rope.mask)
        tracked = one(detector, ropes[-1].mask).points2d
        detector.reset()
        np.testing.assert_allclose(one(detector, ropes[-1].mask).points2d, tracked[::-1], atol=1)


def test_a_gap_is_bridged_and_reported(wave):
    """A gripper finger hides 14 px of the rope: the points under it are in place and invisible."""
    mask = wave.mask.copy()
    mask[:, 150:164] = 0
    for spacing in (20, 60):
        shape = one(ShapeDetector(Centerline(n=spacing, ends="tips")), mask)
        assert shape.ok
        true = at_shares(wave.curve, np.linspace(0, 1, spacing))
        np.testing.assert_allclose(shape.points2d, true, atol=3)
        hidden = (true[:, 0] > 153) & (true[:, 0] < 160)
        assert hidden.any()
        assert not shape.visible[hidden].any()
        assert not shape.valid[hidden].any()
        assert shape.visible[(true[:, 0] < 147) | (true[:, 0] > 167)].all()


def test_several_shapes_each_with_its_own_rule(blue):
    image = blue.copy()
    line = draw_rope(np.stack([np.linspace(40, 280, 100), np.full(100, 215.0)], axis=1), 8, size=(240, 320))
    image[line.mask > 0] = (220, 40, 30)
    red = {"kind": "hsv", "low": [170, 120, 60], "high": [10, 255, 255]}
    shapes = [Centerline(n=8, name="red", segmentation=red), Centerline(n=5, name="blue"), Centerline(n=9, name="too")]  # type: ignore[arg-type]
    detection = ShapeDetector(shapes, BLUE).detect(image)
    assert [shape.name for shape in detection] == ["red", "blue", "too"]
    assert [len(shape) for shape in detection] == [8, 5, 9]
    np.testing.assert_allclose(detection["red"].points2d[:, 1], 215, atol=1)
    alone = ShapeDetector(Centerline(n=5), BLUE).detect(blue).shapes[0]
    np.testing.assert_array_equal(detection["blue"].points2d, alone.points2d)


def test_a_detection_is_read_by_name_and_place(wave):
    detection = ShapeDetector([Centerline(name="rope"), Centerline(name="cable")]).detect_mask(wave.mask, stamp=3.5)
    assert detection["cable"] is detection.shapes[1]
    assert detection["cable"] in detection
    assert list(detection) == list(detection.shapes)
    assert (len(detection), detection.stamp, detection.ok) == (2, 3.5, True)
    assert type(ShapeDetector().detect_mask(wave.mask, stamp=np.float32(3.5)).stamp) is float  # type: ignore[arg-type]
    with pytest.raises(KeyError) as error:
        detection["roep"]
    assert error.value.args[0] == "no shape named 'roep'; did you mean 'rope'? Known: rope, cable."
    with pytest.raises(TypeError, match=r"takes the name of a shape, not 0; use detection.shapes\[0\]"):
        detection[0]  # type: ignore[arg-type]


def test_a_detection_becomes_json(wave, intrinsics):
    depth = np.full(wave.mask.shape, 800, np.uint16)
    depth[:, 150:] = 0
    detection = ShapeDetector().detect_mask(wave.mask, depth, intrinsics)
    data = json.loads(json.dumps(detection.to_dict(), allow_nan=False))
    np.testing.assert_allclose(data["shapes"][0]["points2d"], detection.shapes[0].points2d, atol=1e-3)
    assert data["shapes"][0]["points3d"][-1] == [None] * 3
    assert data["shapes"][0]["valid"] == detection.shapes[0].valid.tolist()
    np.testing.assert_allclose(data["shapes"][0]["sigma"], detection.shapes[0].sigma, atol=1e-5)
    assert (data["shapes"][0]["track_id"], data["shapes"][0]["new"]) == (1, True)
    assert data["shapes"][0]["length"] == pytest.approx(detection.shapes[0].length, abs=1e-4)
    assert data["warning"] == ""


def test_a_detection_prints_what_was_found_where_and_why_not(wave):
    detector = ShapeDetector()
    assert "ok" in repr(found := detector.detect_mask(wave.mask))
    assert "px" in repr(found)
    assert "the mask is empty" in repr(detector.detect_mask(np.zeros_like(wave.mask)))
