"""`log_rerun` writes a file from which rerun's own reader gives back what was detected."""

from __future__ import annotations

import sys
from typing import Any

import cv2
import numpy as np
import pytest
from rerun_reading import points, read_rrd

import shape_obs
from shape_obs import Centerline, HSVRange, Intrinsics, ShapeDetector
from shape_obs.drawing import HIDDEN, VALID, VISIBLE

SIZE = (120, 160)
QUALITY = "/plots/quality/rope", "Scalars:scalars"
LENS = Intrinsics(width=160, height=120, fx=150.0, fy=150.0, cx=79.5, cy=59.5)
BLUE = HSVRange(low=(100, 120, 40), high=(125, 255, 255))


def frame(shift: float = 0.0, *, rope: bool = True):
    """Return an image of a blue rope, and its depth in millimetres; the table is 0.8 m away, the rope 0.02 m nearer."""
    rgb, depth = np.full((*SIZE, 3), 190, np.uint8), np.full(SIZE, 800, np.uint16)
    if rope:
        u = np.linspace(20, 140, 100)
        line = np.round(np.stack([u, 60 + shift + 15 * np.sin(u / 20)], axis=1)).astype(np.int32)
        cv2.polylines(rgb, [line], False, (30, 60, 200), 7)
        cv2.polylines(depth, [line], False, 780, 7)
    return rgb, depth


@pytest.fixture
def rr() -> Any:
    """Return the module; collecting the tests does not load it."""
    return pytest.importorskip("rerun")


@pytest.fixture
def stream(tmp_path, rr):
    recording = rr.RecordingStream("test")
    recording.save(str(tmp_path / "log.rrd"))
    return recording, tmp_path / "log.rrd"


def test_a_stamp_in_nanoseconds_is_left_out_of_the_timeline(stream):
    recording, path = stream
    rgb, depth = frame()
    detection = ShapeDetector([Centerline(n=12, name="rope")], BLUE).detect(
        rgb, depth, LENS, stamp=1_700_000_000 * 10**9
    )
    shape_obs.log_rerun(detection, recording=recording, number=7)
    recording.disconnect()
    assert list(read_rrd(path, *QUALITY)) == [7]


def test_points_are_those_of_the_detection(stream):
    recording, path = stream
    detector = ShapeDetector([Centerline(n=12, name="rope")], BLUE)
    found = []
    for k in range(5):
        rgb, depth = frame(k)
        found.append(detector.detect(rgb, depth, LENS, stamp=0.1 * k))
        shape_obs.log_rerun(found[-1], rgb, depth, LENS, recording=recording, number=100 + k)
    recording.disconnect()
    flat = read_rrd(path, "/camera/image/shapes/rope/points", "Points2D:positions")
    space = read_rrd(path, "/camera/shapes/rope/points", "Points3D:positions")
    assert list(flat) == list(space) == [100, 101, 102, 103, 104]
    for k, detection in enumerate(found):
        assert detection.ok
        np.testing.assert_array_equal(points(flat[100 + k]), detection["rope"].points2d)
        np.testing.assert_array_equal(points(space[100 + k]), detection["rope"].points3d)
    numbers = read_rrd(path, "/camera/image/shapes/rope/numbers", "Points2D:labels")
    assert numbers[100] == [str(i) for i in range(12)]
    lines = read_rrd(path, "/camera/shapes/rope/lines", "LineStrips3D:strips")
    np.testing.assert_array_equal(points(lines[100])[:, 0], found[0]["rope"].points3d[:-1])
    quality = read_rrd(path, *QUALITY)
    assert np.ravel(quality[102])[0] == pytest.approx(found[2]["rope"].quality)
    total = read_rrd(path, "/plots/timings/total", "Scalars:scalars")
    assert np.ravel(total[103])[0] == pytest.approx(found[3].timings["total"])
    stamps = [np.timedelta64(stamp, "ns") for stamp in read_rrd(path, *QUALITY, index="stamp")]
    assert [stamp / np.timedelta64(1, "s") for stamp in stamps] == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])


def test_images_are_those_of_the_camera(stream):
    recording, path = stream
    rgb, depth = frame()
    mask = rgb[..., 2] > 195
    shape_obs.log_rerun(None, rgb, depth, LENS, mask=mask, recording=recording)
    recording.disconnect()
    jpeg = read_rrd(path, "/camera/image/rgb", "EncodedImage:blob")[0][0]
    decoded = cv2.imdecode(np.frombuffer(bytes(jpeg), np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None
    assert np.abs(decoded[..., ::-1].astype(int) - rgb).mean() < 3
    raw = bytes(read_rrd(path, "/camera/image/depth", "DepthImage:buffer")[0][0])
    np.testing.assert_array_equal(np.frombuffer(raw, np.uint16).reshape(SIZE), depth)
    raw = bytes(read_rrd(path, "/camera/image/mask", "SegmentationImage:buffer")[0][0])
    np.testing.assert_array_equal(np.frombuffer(raw, np.uint8).reshape(SIZE) > 0, mask)
    matrix = np.reshape(read_rrd(path, "/camera/image", "Pinhole:image_from_camera")[0][0], (3, 3)).T
    np.testing.assert_allclose(matrix, [[150, 0, 79.5], [0, 150, 59.5], [0, 0, 1]])


def test_colours_say_which_points_are_valid(stream):
    recording, path = stream
    detector = ShapeDetector([Centerline(n=12, name="rope")], BLUE, on_missing="hold", max_age=9.0)
    rgb, depth = frame()
    depth[:, :70] = 0  # so that the points on the left have no depth
    seen = detector.detect(rgb, depth, LENS, stamp=0.0)
    held = detector.detect(*frame(rope=False), LENS, stamp=0.1)
    shape_obs.log_rerun(seen, recording=recording)
    shape_obs.log_rerun(held, recording=recording)
    recording.disconnect()
    colours = read_rrd(path, "/camera/image/shapes/rope/points", "Points2D:colors")
    shape = seen["rope"]
    assert shape.visible.all()
    assert 3 < shape.valid.sum() < 9
    expected = [VALID if valid else VISIBLE for valid in shape.valid]
    assert [(c >> 24, c >> 16 & 255, c >> 8 & 255) for c in colours[0]] == expected
    assert {(c >> 24, c >> 16 & 255, c >> 8 & 255) for c in colours[1]} == {HIDDEN}


def test_a_lost_shape_leaves_no_points_and_its_reason_is_logged_once(stream):
    recording, path = stream
    detector = ShapeDetector([Centerline(n=12, name="rope")], BLUE, on_missing="nan")
    for k, there in enumerate([True, False, False, True]):
        rgb, depth = frame(rope=there)
        shape_obs.log_rerun(detector.detect(rgb, depth, LENS, stamp=0.1 * k), recording=recording)
    recording.disconnect()
    flat = read_rrd(path, "/camera/image/shapes/rope/points", "Points2D:positions")
    assert [len(each) for each in flat.values()] == [12, 0, 0, 12]
    texts = read_rrd(path, "/log", "TextLog:text")
    assert list(texts) == [0, 1, 3]
    assert "rope: the mask is empty" in texts[1][0]
    assert texts[3][0].startswith("rope: found")


def test_features_have_the_names_of_their_components(stream):
    recording, path = stream
    features = {"rope/points2d": {"u0": 1.0, "v0": 2.0}, "rope/length": 0.4, "force": np.array([1.0, 2.0, 3.0])}
    shape_obs.log_rerun(None, features=features, recording=recording)
    recording.disconnect()
    assert read_rrd(path, "/plots/features/rope/points2d", "Scalars:scalars")[0] == [1.0, 2.0]
    for feature, names in (
        ("rope/points2d", ["rope/points2d u0", "rope/points2d v0"]),
        ("rope/length", ["rope/length"]),
        ("force", ["force 0", "force 1", "force 2"]),
    ):
        assert [*read_rrd(path, f"/plots/features/{feature}", "SeriesLines:names").values()] == [names]


def test_the_recording_of_init_is_used(tmp_path, monkeypatch, rr):
    monkeypatch.setattr(rr, "get_global_data_recording", lambda: None)
    with pytest.raises(ValueError, match=r'call rerun\.init\("my_app", spawn=True\) first'):
        shape_obs.log_rerun(None)
    monkeypatch.undo()
    rr.init("test_of_init")
    rr.save(str(tmp_path / "log.rrd"))
    rgb, _ = frame()
    for _ in range(3):
        shape_obs.log_rerun(None, rgb)
    rr.disconnect()
    assert list(read_rrd(tmp_path / "log.rrd", "/camera/image/rgb", "EncodedImage:blob")) == [0, 1, 2]


def test_bad_images_and_a_missing_library_are_reported(stream, monkeypatch):
    recording, _ = stream
    with pytest.raises(TypeError, match="rgb: expected a numpy array of uint8"):
        shape_obs.log_rerun(None, np.zeros((4, 4, 3)), recording=recording)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="the mask has 3 x 2 pixels"):
        shape_obs.log_rerun(None, frame()[0], mask=np.zeros((2, 3), bool), recording=recording)
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ImportError, match=r'pip install "\.\[rerun\]"'):
        shape_obs.log_rerun(None)
