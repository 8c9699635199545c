"""Several objects of one mask: slots that are found, named, numbered, kept apart and refused."""

from __future__ import annotations

import json

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from shape_obs import Centerline, Contour, Intrinsics, ShapeDetector, SpecError, Surface
from shape_obs.config.config_file import detector_arguments, load_config, save_config, schema_hash
from tests.benchmarks.scenes.moving_ropes import moving_ropes

Mask = npt.NDArray[np.uint8]
SIZE = (240, 320)
UP, LEVEL = [(60, 40), (150, 90), (280, 60)], [(40, 130), (160, 120), (290, 140)]
DOWN = [(60, 220), (150, 180), (270, 210)]


def drawn(*ropes: list[tuple[int, int]], width: int = 7) -> Mask:
    mask = np.zeros(SIZE, np.uint8)
    for rope in ropes:
        curve = np.array(rope, float)
        at = np.linspace(0, 2, 60)
        smooth = np.stack([np.polyval(np.polyfit([0, 1, 2], curve[:, d], 2), at) for d in (0, 1)], axis=1)
        cv2.polylines(mask, [np.round(smooth * 16).astype(np.int32)], False, 255, width, cv2.LINE_8, 4)
    return mask


def cross(angle: float, middle: tuple[float, float] = (160, 120), half: float = 90) -> list[tuple[int, int]]:
    step = half * np.array([np.cos(angle), np.sin(angle)])
    return [tuple(np.round(np.array(middle) + k * step).astype(int)) for k in (-1, 0, 1)]


def test_each_rope_gets_a_slot_from_the_top_left():
    detection = ShapeDetector([Centerline(n=10, count=3, ends="tips")]).detect_mask(drawn(LEVEL, DOWN, UP))
    assert [shape.name for shape in detection] == ["centerline0", "centerline1", "centerline2"]
    assert detection.ok
    assert detection.more == {}
    for shape, rope in zip(detection, (UP, LEVEL, DOWN), strict=True):
        np.testing.assert_allclose(shape.points2d[[0, -1]], [rope[0], rope[-1]], atol=5)
        assert shape.visible.all()
        assert shape.track_id == 1
        assert not shape.reason


def test_fewer_ropes_than_slots_leave_slots_empty():
    detection = ShapeDetector([Centerline(count=3, name="rope")]).detect_mask(drawn(UP, DOWN))
    assert [shape.ok for shape in detection] == [True, True, False]
    assert detection["rope2"].reason == "no other object was found in the mask"
    assert np.isnan(detection["rope2"].points2d).all()


def test_more_ropes_than_slots_are_reported():
    short = [(150, 100), (165, 105), (180, 100)]
    detector = ShapeDetector([Centerline(n=10, count=2, ends="tips")])
    detection = detector.detect_mask(drawn(UP, short, DOWN))
    assert detection.more == {"centerline": 1}
    np.testing.assert_allclose(detection["centerline0"].points2d[0], UP[0], atol=5)  # the longest two
    np.testing.assert_allclose(detection["centerline1"].points2d[0], DOWN[0], atol=5)
    assert json.loads(json.dumps(detection.to_dict()))["more"] == {"centerline": 1}


def test_more_ropes_than_can_share_pixels_raise_no_error():
    mask = np.zeros((480, 640), np.uint8)
    places = [(35 + 62 * (k % 10), 30 + 65 * (k // 10)) for k in range(70)]
    for k, (u, v) in enumerate(places):
        half = 24 if k < 69 else 20
        cv2.line(mask, (u - half, v - 10), (u + half, v + 10), 255, 4)
    anchors = {"shortest": places[-1]}
    detector = ShapeDetector([Centerline(n=10, count=1, anchor="shortest")])
    assert detector.detect_mask(mask, anchors=anchors).more == {"centerline": 69}


def test_anchors_tie_slots_to_ropes():
    anchors = {"left": DOWN[-1], "right": UP[-1]}
    spec = Centerline(n=10, count=2, ends="tips", anchor={"centerline0": "left", "centerline1": "right"})
    detection = ShapeDetector([spec]).detect_mask(drawn(UP, LEVEL, DOWN), anchors=anchors)
    np.testing.assert_allclose(detection["centerline0"].points2d[0], DOWN[-1], atol=5)
    np.testing.assert_allclose(detection["centerline1"].points2d[0], UP[-1], atol=5)


def test_all_ropes_are_returned_by_a_detector_alone():
    detector = ShapeDetector([Centerline(count="all")])
    for ropes in ((UP,), (UP, LEVEL, DOWN), (UP, LEVEL, DOWN)):
        detection = detector.detect_mask(drawn(*ropes))
        assert len(detection) == len(ropes)
        assert detection.ok
    lone = ShapeDetector([Centerline(count="all")], on_missing="raise").detect_mask(drawn(UP))
    assert len(lone) == 1


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ({"count": 0}, "count must lie in 1...16, be 'all' or None, got 0"),
        ({"count": "every"}, "count: expected"),
        ({"anchor": {"centerline0": "g"}}, "an anchor for each slot, {'centerline0': 'g'}, needs count="),
        ({"count": 2, "anchor": {"centerline2": "g"}}, "anchor for unknown slot 'centerline2'"),
    ],
)
def test_bad_counts_are_refused(spec, message):
    with pytest.raises((ValueError, SpecError), match=message.replace("...", r"\.\.\.").replace("{", r"\{")):
        Centerline(**spec)


def test_a_count_is_hashed_and_saved(tmp_path):
    one, two = ({"shapes": [Centerline(count=count)]} for count in (None, 2))
    assert schema_hash(one) != schema_hash(two)
    assert schema_hash(one) == schema_hash({"shapes": ["centerline"]})
    save_config(tmp_path / "two.yaml", two)
    assert schema_hash(detector_arguments(load_config(tmp_path / "two.yaml"))) == schema_hash(two)


@pytest.mark.parametrize("angle", [25, 45, 90])
def test_crossing_ropes_are_found(angle):
    ropes = cross(0.3), cross(0.3 + np.deg2rad(angle))
    detection = ShapeDetector([Centerline(n=20, count=2, ends="tips")]).detect_mask(drawn(*ropes))
    assert detection.ok
    assert len(detection.crossings) == 1
    found = detection.crossings[0]
    assert found.slots == ("centerline0", "centerline1")
    assert found.arcs == pytest.approx((0.5, 0.5), abs=0.03)
    assert found.pixel == pytest.approx((160, 120), abs=2)
    assert found.above is None
    for shape in detection:
        assert shape.crossings == detection.crossings
        chord = shape.points2d[-1] - shape.points2d[0]
        assert np.linalg.norm(chord) == pytest.approx(180, abs=8)


def test_outlines_and_sheets_have_slots_too():
    mask = np.zeros(SIZE, np.uint8)
    cv2.ellipse(mask, (80, 80), (40, 25), 20, 0, 360, 255, -1)
    cv2.ellipse(mask, (230, 150), (50, 30), -30, 0, 360, 255, -1)
    outlines = ShapeDetector([Contour(count=2)])
    for step in range(3):
        detection = outlines.detect_mask(np.roll(mask, 3 * step, axis=1))
        assert detection.ok
        for shape, centre in zip(detection, ((80, 80), (230, 150)), strict=True):
            np.testing.assert_allclose(shape.points2d.mean(axis=0), np.add(centre, (3 * step, 0)), atol=2)
    sheets = np.zeros(SIZE, np.uint8)
    cv2.fillPoly(sheets, [np.array([(30, 30), (110, 40), (105, 110), (25, 100)])], 255)
    cv2.fillPoly(sheets, [np.array([(180, 120), (280, 110), (290, 200), (190, 215)])], 255)
    detection = ShapeDetector([Surface(rows=3, cols=3, count=2)]).detect_mask(sheets)
    assert detection.ok
    np.testing.assert_allclose(detection["surface0"].points2d.mean(axis=0), (67, 70), atol=4)


def test_a_closed_ring_next_to_a_rope_is_refused_alone():
    mask = drawn(DOWN)
    cv2.circle(mask, (160, 80), 40, 255, 7)
    detection = ShapeDetector([Centerline(count=2)]).detect_mask(mask)
    assert sorted(shape.ok for shape in detection) == [False, True]
    (lost,) = [shape for shape in detection if not shape.ok]
    assert "closed ring" in lost.reason


def nightly(*values: object) -> object:
    return pytest.param(*values, marks=pytest.mark.nightly)


@pytest.mark.parametrize(
    ("kind", "seed", "count", "frames"),
    [
        ("slow hand", 5, 2, 90),
        ("crossing", [15, 3], 3, 100),  # a tip passes over another tip: each is expected up to its end
        ("crossing", [32, 3], 3, 108),  # two ropes pass over each other, nearly parallel
        ("touching", [31, 3], 3, 60),  # side by side, with tips that the other rope could take over
        nightly("crossing", [46, 3], 3, 90),
        nightly("crossing", [50, 3], 3, 122),
        nightly("touching", [30, 3], 3, 120),
        nightly("touching", [26, 3], 3, 90),
    ],
)
def test_ropes_that_meet_keep_their_slots_and_their_direction(kind, seed, count, frames):
    """A slot that is found lies on the rope that it was first found on, and runs along it as it did."""
    detector, own, due, found = ShapeDetector([Centerline(n=20, count=count, ends="tips")]), {}, 0, 0
    for moment in moving_ropes(np.random.default_rng(seed), count, frames, kind=kind):
        shapes = [shape for shape in detector.detect_mask(moment.mask) if shape.ok and not shape.reason]
        in_sight = sum(visible.mean() >= 0.5 for visible in moment.visible)
        due, found = due + in_sight, found + min(len(shapes), in_sight)
        for shape in shapes:
            points = shape.pixels[shape.visible]
            away = [np.linalg.norm(points[:, None] - curve[None], axis=2).min(axis=1).mean() for curve in moment.curves]
            rope = own.setdefault(shape.name, {}).setdefault("rope", int(np.argmin(away)))
            assert away[rope] < moment.widths[rope]
            even = moment.curves[rope][np.linspace(0, len(moment.curves[rope]) - 1, 20).round().astype(int)]
            off, back = (np.linalg.norm(shape.pixels - way, axis=1).mean() for way in (even, even[::-1]))
            forwards = own[shape.name].setdefault(shape.track_id, bool(off <= back))
            if min(off, back) < 0.5 * max(off, back):
                assert (off <= back) == forwards
    assert len({slot["rope"] for slot in own.values()}) == count
    assert found >= 0.97 * due


def test_a_rope_that_was_hidden_comes_back_to_its_slot_while_another_stays():
    detector = ShapeDetector([Centerline(n=10, count=2, ends="tips")], max_age=0.2)
    frames = [(UP, DOWN)] * 3 + [(DOWN,)] * 10 + [(UP, DOWN)] * 3
    detection = [detector.detect_mask(drawn(*ropes)) for ropes in frames][-1]
    np.testing.assert_allclose(detection["centerline0"].points2d[0], UP[0], atol=5)
    np.testing.assert_allclose(detection["centerline1"].points2d[0], DOWN[0], atol=5)


def test_a_rope_without_a_slot_next_to_a_connector_is_not_searched_for_in_each_frame(monkeypatch):
    find, searches = Centerline.find_objects, []
    monkeypatch.setattr(Centerline, "find_objects", lambda *arguments: searches.append(1) or find(*arguments))
    mask = drawn([(40, 60), (130, 60), (220, 60)], [(40, 120), (130, 120), (220, 120)])
    cv2.rectangle(mask, (220, 45), (250, 75), 255, -1)
    more = np.maximum(mask, drawn([(40, 200), (130, 200), (220, 200)]))
    detector = ShapeDetector([Centerline(n=20, count=2, ends="tips")])
    for frame in range(24):
        detection = detector.detect_mask(np.roll(mask if frame < 4 else more, frame % 3, axis=1))
        assert detection.ok
        assert max(detection["centerline0"].points2d[:, 0]) < 224  # the connector is cut off in all frames
    assert 2 <= len(searches) <= 6


def test_a_rope_that_enters_takes_a_slot_that_was_never_used():
    detector = ShapeDetector([Centerline(n=10, count=3, ends="tips")], max_age=0.2)
    frames = [(UP, DOWN)] * 3 + [(DOWN,)] * 12 + [(LEVEL, DOWN)] * 2 + [(UP, LEVEL, DOWN)] * 2
    detection = [detector.detect_mask(drawn(*ropes)) for ropes in frames][-1]
    for name, rope in (("centerline0", UP), ("centerline1", DOWN), ("centerline2", LEVEL)):
        np.testing.assert_allclose(detection[name].points2d[0], rope[0], atol=5)


def test_a_cloud_is_of_one_object():
    with pytest.raises(ValueError, match="a cloud is of one object; count= needs an image"):
        ShapeDetector([Centerline(count=2)]).detect_cloud(np.random.default_rng(0).normal(size=(200, 3)))


def test_ropes_under_a_cloud_have_slots():
    mask = drawn(UP, DOWN)
    depth, camera = np.full(SIZE, 0.6, np.float32), Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5)
    detector = ShapeDetector([Centerline(n=10, count=2, lift="cloud")])
    for _ in range(3):
        detection = detector.detect_mask(mask, depth, camera)
        assert detection.ok
        assert all(shape.track_id == 1 for shape in detection)


def test_ropes_under_a_cloud_may_cross():
    """One lies over the other and moves along it: each is found where it is."""
    camera = Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5)
    detector = ShapeDetector([Centerline(n=10, count=2, lift="cloud", ends="tips")])
    for frame in range(20):
        across = [(120 + 3 * frame, 30), (130 + 3 * frame, 120), (155 + 3 * frame, 215)]
        mask = drawn(LEVEL, across)
        detection = detector.detect_mask(mask, np.where(mask > 0, 0.6, 0.7).astype(np.float32), camera)
        assert detection.ok, (frame, detection)
        for name, rope in (("centerline0", across), ("centerline1", LEVEL)):
            np.testing.assert_allclose(detection[name].points2d[[0, -1]], [rope[0], rope[2]], atol=6)
