"""Clicks on drawn photos whose masks are known become segmentations; more with `python -m tests.benchmarks clicks`."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from shape_obs import Centerline, Contour, ShapeDetector
from shape_obs.clicks import propose_segmentation
from shape_obs.config.config_file import detector_arguments, load_config, save_config
from shape_obs.frame import Frame
from shape_obs.image.click_net import load_network
from shape_obs.image.roi import Window
from shape_obs.image.segmentation import Segmentation
from shape_obs.utils.arrays import read_image
from tests.benchmarks.clicks import first_click
from tests.benchmarks.scenes.object_photos import object_photo

REAL = Path(__file__).parents[2] / "shared" / "data" / "real" / "blue_rope_640x480.png"


def overlap(found: np.ndarray, truth: np.ndarray) -> float:
    return np.count_nonzero(found & truth) / np.count_nonzero(found | truth)


@pytest.fixture(scope="module")
def rope():
    return object_photo(np.random.default_rng(4), "rope", "plain")


@pytest.fixture(scope="module")
def pick(rope):
    return first_click(np.random.default_rng(0), rope)


@pytest.fixture(scope="module")
def proposal(rope, pick):
    return propose_segmentation(rope.rgb, [pick])


def test_the_detector_sees_the_mask_that_was_proposed(rope, proposal):
    assert overlap(proposal.mask, rope.mask) > 0.8
    seen = proposal.rule.clean(proposal.rule.matches(rope.rgb).view(np.uint8)) > 0
    assert overlap(seen, proposal.mask) > 0.95
    assert f"{np.count_nonzero(proposal.mask):,} pixels" in proposal.text


def test_a_config_file_keeps_the_clicks_and_gives_the_same_points(rope, pick, proposal, tmp_path):
    save_config(tmp_path / "shape.yaml", {"segmentation": proposal.rule})
    scene = yaml.safe_load((tmp_path / "shape.yaml").read_text())["scene"]
    assert scene["segmentation"]["kind"] == "click"
    assert scene["segmentation"]["picks"] == [list(pick)]
    before = ShapeDetector([Centerline(n=20)], proposal.rule).detect(rope.rgb).shapes[0]
    after = ShapeDetector(**detector_arguments(load_config(tmp_path / "shape.yaml"))).detect(rope.rgb).shapes[0]
    assert np.array_equal(before.points2d, after.points2d)


@pytest.fixture
def two_ropes():
    """Two ropes of similar colours, red and orange, and the mask of the red one."""
    rng = np.random.default_rng(0)
    photo = np.clip(rng.normal(205, 3, (240, 320, 3)), 0, 255)
    cv2.line(photo, (40, 60), (280, 80), (190.0, 70.0, 50.0), 12, cv2.LINE_AA)
    cv2.line(photo, (40, 180), (280, 160), (205.0, 100.0, 50.0), 12, cv2.LINE_AA)
    truth = np.zeros((240, 320), np.uint8)
    cv2.line(truth, (40, 60), (280, 80), (1.0,), 12)
    return np.clip(photo + rng.normal(0, 4, photo.shape), 0, 255).astype(np.uint8), truth > 0


def test_a_click_that_is_not_on_the_object_excludes_what_is_there(two_ropes):
    photo, red = two_ropes
    found = propose_segmentation(photo, [(160, 70)], [(160, 170)]).mask
    assert overlap(found, red) > 0.8
    assert not found[170, 160]
    large = propose_segmentation(cv2.resize(photo, (1280, 960)), [(640, 280)], [(640, 680)]).mask
    assert overlap(large, cv2.resize(red.astype(np.uint8), (1280, 960)) > 0) > 0.8


@pytest.fixture
def alike():
    """Two ropes of one colour that cross, and the mask of the level one."""
    photo, truth = np.full((240, 320, 3), (120, 150, 120), np.uint8), np.zeros((240, 320), np.uint8)
    cv2.line(photo, (200, 20), (110, 220), (190.0, 70.0, 50.0), 12, cv2.LINE_AA)
    for image, colour in ((photo, (190.0, 70.0, 50.0)), (truth, (1.0,))):
        cv2.line(image, (40, 110), (280, 130), colour, 12, cv2.LINE_AA)
    return cv2.GaussianBlur(photo, (0, 0), 0.8), truth > 0


def test_of_ropes_of_one_colour_the_clicked_one_is_found_and_followed(alike):
    photo, level = alike
    proposal = propose_segmentation(photo, [(70, 112)])
    assert overlap(proposal.mask, level) > 0.8
    assert proposal.rule.kind == "click_net"
    assert "network" in proposal.text
    away = propose_segmentation(photo, [(150, 119)], [(190, 42)])
    assert overlap(away.mask, level) > 0.8
    saved = Segmentation.from_dict(proposal.rule.to_dict())
    assert saved == proposal.rule
    assert overlap(saved.apply(Frame(photo), Window(0, 0, 320, 240)) > 0, proposal.mask) > 0.95
    detector = ShapeDetector([Centerline(n=20)], saved)
    expected = np.stack([np.linspace(34, 286, 41)[1::2], np.linspace(109.5, 130.5, 41)[1::2]], axis=1)
    moved = photo
    for shift in range(0, 41, 4):  # pixels
        moved = np.roll(photo, shift, axis=0)
        moved[:shift] = photo[0]
        shape = detector.detect(moved).shapes[0]
        assert shape.ok, shape.reason
        assert np.abs(shape.points2d[:, 1] - shift - np.interp(shape.points2d[:, 0], *expected.T)).max() < 4
    assert not detector.detect(np.full_like(photo, (120, 150, 120))).shapes[0].visible.any()
    assert detector.detect(moved).shapes[0].ok  # found again, by the colours


def test_an_object_is_not_left_for_another_one_like_it():
    """All of the image is searched every 30 frames; by then the object has left the place of the click."""
    rng, photo = np.random.default_rng(0), np.full((240, 320, 3), (120, 150, 120), np.uint8)
    for corners in (((50, 60), (100, 110)), ((180, 60), (280, 160))):
        cv2.rectangle(photo, *corners, (190.0, 70.0, 50.0), -1)
    photo = np.clip(cv2.GaussianBlur(photo, (0, 0), 0.8) + rng.normal(0, 4, photo.shape), 0, 255).astype(np.uint8)
    detector = ShapeDetector([Contour(n=16)], propose_segmentation(photo, [(75, 85)]).rule)
    for shift in range(0, 64, 2):  # pixels
        moved = np.roll(photo, shift, axis=0)
        moved[:shift] = photo[0]
        shape = detector.detect(moved).shapes[0]
        assert shape.ok, shape.reason
        assert np.abs(shape.points2d.mean(axis=0) - (75, 85 + shift)).max() < 3


def test_depth_separates_what_has_one_colour():
    """A rope 10 cm in front of a table of nearly its colour: the region of a click ends where depth changes."""
    rng = np.random.default_rng(1)
    photo, depth = np.full((240, 320, 3), 120.0), np.full((240, 320), 0.9, np.float32)
    truth = np.zeros((240, 320), np.uint8)
    cv2.line(truth, (40, 60), (280, 180), (1.0,), 22)
    photo[truth > 0] = (120, 118, 132)
    depth[truth > 0] = 0.8
    photo = np.clip(photo + rng.normal(0, 2, photo.shape), 0, 255).astype(np.uint8)
    found = propose_segmentation(photo, [(160, 120)], depth=depth).mask
    assert overlap(found, truth > 0) > 0.7


@pytest.mark.parametrize(
    ("picks", "nots", "text"),
    [
        ([], [], "expected at least one pixel on the object, got none"),
        ([(float("nan"), 5)], [], r"pixel \(nan, 5\) lies outside"),
        ([(900, 5)], [], r"pixel \(900, 5\) lies outside the image of 640 x 480"),
        ([(5, 5)], [(5, 900)], r"pixel \(5, 900\) lies outside"),
        ([(50, 50), (90, 90)], [(91, 90)], r"\(90, 90\) is given as on the object, and \(91, 90\) as off it"),
    ],
)
def test_clicks_outside_the_image_or_against_each_other(rope, picks, nots, text):
    with pytest.raises(ValueError, match=text):
        propose_segmentation(rope.rgb, picks, nots)


@pytest.mark.parametrize("picks", [(3.0, 4.0), [(1, 2, 3)], ["ab"], None])
def test_clicks_that_are_no_pixels(rope, picks):
    with pytest.raises(TypeError, match=r"pick: expected pixels \[\(u, v\), ...\], got"):
        propose_segmentation(rope.rgb, picks)


def test_clicks_of_other_number_types_mean_the_same(rope, pick, proposal):
    found = propose_segmentation(rope.rgb, np.array([pick], np.int64)).rule
    assert found == proposal.rule


def test_clicks_on_two_objects_are_pointed_out(two_ropes):
    text = propose_segmentation(two_ropes[0], [(160, 70), (160, 170)]).text
    assert "Clicks lie in 2 of the pieces" in text


def test_depth_that_is_unknown_changes_nothing(rope, pick, proposal):
    for unknown in (np.zeros(rope.mask.shape, np.uint16), np.full(rope.mask.shape, np.nan, np.float32)):
        assert np.array_equal(propose_segmentation(rope.rgb, [pick], depth=unknown).mask, proposal.mask)


@pytest.mark.parametrize(
    ("photo", "error", "text"),
    [
        (np.zeros((48, 64, 3)), TypeError, "uint8"),
        (np.zeros((48, 64), np.uint8), ValueError, r"\(H, W, 3\)"),
        (np.zeros((48, 64, 4), np.uint8), ValueError, r"\(H, W, 3\)"),
        (np.zeros((16, 16, 3), np.uint8), ValueError, "at least 32 x 32 pixels, got 16 x 16"),
        (np.full((240, 320, 3), 90, np.uint8), ValueError, "stands out"),
    ],
)
def test_what_is_no_photo_of_an_object(photo, error, text):
    with pytest.raises(error, match=text):
        propose_segmentation(photo, [(10, 10)])


def test_a_photo_of_twelve_megapixels_is_reduced(two_ropes):
    photo, red = (cv2.resize(image.astype(np.uint8), (4000, 3000)) for image in two_ropes)
    assert overlap(propose_segmentation(photo, [(2000, 875)]).mask, red > 0) > 0.8


def test_a_damaged_network_is_refused(monkeypatch, tmp_path):
    (tmp_path / "click_net.onnx").write_bytes(b"another")
    monkeypatch.setattr("shape_obs.image.click_net.files", lambda package: tmp_path)
    load_network.cache_clear()
    with pytest.raises(RuntimeError, match=r"click_net.onnx is damaged.*install shape-obs again"):
        propose_segmentation(np.zeros((48, 64, 3), np.uint8), [(10, 10)])
    load_network.cache_clear()


def test_a_rule_without_colours_says_how_to_learn_them():
    with pytest.raises(ValueError, match="--pick u,v"):
        Segmentation.from_dict({"kind": "click", "picks": [[3, 4]]})
    with pytest.raises(ValueError, match="--pick u,v"):
        Segmentation.from_dict({"kind": "click_net", "picks": [[3, 4]]})
    flat = {"weight": 1, "mean": [50, 0, 0], "covariance": [1, 0, 0, 0, 0, 1]}
    with pytest.raises(ValueError, match="not positive definite"):
        Segmentation.from_dict({"kind": "click", "object": [flat], "background": [flat]})


@pytest.mark.skipif(not REAL.exists(), reason="the shared real photo is absent")
def test_a_real_rope():
    photo = read_image(REAL)
    proposal = propose_segmentation(photo, [(300, 123)])
    assert proposal.rule.kind == "click"
    shape = ShapeDetector([Centerline(n=20)], proposal.rule).detect(photo).shapes[0]
    assert shape.ok, shape.reason
    assert 15_000 < np.count_nonzero(proposal.mask) < 22_000
