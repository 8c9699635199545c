"""ROS 2 bags written by ``rosbags`` are read back to the pixel; each bad file raises one clear error."""

from __future__ import annotations

import array
import json
import shutil
import struct
import warnings
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("rosbags")

from ros_bags import COLOR, DEPTH, INFO, camera_info, compressed, image, rgbd_messages, write_bag, write_ros1_bag

from shape_obs.recording.format import read_moments
from shape_obs.source import BadRecording, EndOfSource, NotConnected, RGBDSource
from shape_obs_envs.sources import RosbagSource, open_source
from shape_obs_envs.sources.rosbag.images import kind_of, read_colour, read_depth

SIZE = (48, 64)
K = (60.0, 61.0, 31.5, 23.5)


def drawn(count: int, dtype: type = np.uint16) -> list:
    """Return frames of noise, which no decoder can repair by chance; depth in uint16 mm or float32 m."""
    draw = np.random.default_rng(3)
    frames = []
    for _ in range(count):
        depth = draw.integers(0, 4000, SIZE).astype(np.uint16)
        rgb = draw.integers(0, 256, (*SIZE, 3), np.uint8)
        frames.append((rgb, depth if dtype is np.uint16 else (depth / 1000).astype(np.float32)))
    return frames


def frames_of(source) -> list[Any]:
    """Return all frames of a source."""
    return [moment.frame for moment in read_moments(source)]


@pytest.fixture(scope="module")
def frames():
    return drawn(12)


@pytest.fixture(scope="module")
def mcap(frames, tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("bags") / "mcap", rgbd_messages(frames, K))


@pytest.mark.parametrize("storage", ["mcap", "sqlite3", "ROS 1"])
@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_a_bag_is_read_back_to_the_pixel(storage, dtype, tmp_path):
    """A file of a rosbag2 may have lost the rest of its folder."""
    frames = drawn(5, dtype)
    if storage == "ROS 1":
        words = [write_ros1_bag(tmp_path / "ros.bag", rgbd_messages(frames, K))]
    else:
        file = write_bag(tmp_path / "bag", rgbd_messages(frames, K), storage)
        words = [tmp_path / "bag", Path(shutil.copy(file, tmp_path))]
    for word in words:
        source = open_source(word)
        with pytest.raises(NotConnected):
            source.read()
        for _ in range(2):  # connected again, it begins again
            with source:
                assert isinstance(source, RGBDSource)
                assert (source.kind, source.name, source.live, source.has_depth) == ("rosbag", str(word), False, True)
                assert source.intrinsics is not None
                assert (source.intrinsics.fx, source.intrinsics.fy) == K[:2]
                assert (source.intrinsics.cx, source.intrinsics.cy) == K[2:]
                assert not source.intrinsics.distorted
                read = frames_of(source)
                with pytest.raises(EndOfSource, match="end of its 5 frames"):
                    source.read()
            assert [frame.number for frame in read] == list(range(5))
            assert np.allclose([frame.stamp for frame in read], 1700 + np.arange(5) / 30, atol=1e-6)
            for (rgb, depth), frame in zip(frames, read, strict=True):
                assert np.array_equal(frame.rgb, rgb)
                assert frame.depth.dtype == dtype
                assert np.array_equal(frame.depth, depth)
                assert frame.camera.intrinsics.fx == K[0]


def test_colour_is_paired_with_the_depth_of_its_moment(frames, tmp_path):
    """Depth arrives 4 frames late, of one frame it is missing, and of another it is half of an interval off."""
    messages = [
        each
        for each in rgbd_messages(frames, K, late=4 / 30)
        if not (each[0] == DEPTH and each[2].header.stamp == image(frames[3][1], "16UC1", 1700.1 + 0.004).header.stamp)
    ]
    for topic, _, message in messages:
        if topic == DEPTH and message.header.stamp.nanosec == round((5 / 30 + 0.004) * 1e9):
            message.header.stamp.nanosec += 20_000_000
    write_bag(tmp_path / "bag", messages)
    with RosbagSource(tmp_path / "bag") as source:
        assert len(source) == 12
        with pytest.warns(UserWarning, match="2 of 12 colour images were left out"):
            read = {frame.number: frame for frame in frames_of(source)}
    assert sorted(read) == [0, 1, 2, 4, 6, 7, 8, 9, 10, 11]
    for number, frame in read.items():
        assert np.array_equal(frame.depth, frames[number][1])
    with RosbagSource(tmp_path / "bag", max_gap=0.03) as source:
        assert 5 in [moment.frame.number for moment in read_moments(source)]


def test_depth_of_another_clock_is_an_error_that_names_the_gap(frames, tmp_path):
    messages = rgbd_messages(frames, K)
    for topic, _, message in messages:
        message.header.stamp.sec += 7 * (topic == DEPTH)
    write_bag(tmp_path / "bag", messages)
    with RosbagSource(tmp_path / "bag") as source, pytest.raises(BadRecording, match=r"nearest is 6\.\d+ s away"):
        source.read()


def test_messages_without_a_stamp_have_the_time_of_their_recording(frames, tmp_path):
    write_bag(tmp_path / "bag", [("/image", 5 + n / 10, image(frames[n][0], "bgr8", 0.0)) for n in range(3)])
    with RosbagSource(tmp_path / "bag") as source:
        assert source.intrinsics is None
        assert not source.has_depth
        read = frames_of(source)
    assert [frame.stamp for frame in read] == pytest.approx([5.0, 5.1, 5.2])
    assert all(np.array_equal(frame.rgb, frames[n][0][..., ::-1]) for n, frame in enumerate(read))
    with RosbagSource(tmp_path / "bag", start=0.15) as source:
        assert source.read().stamp == pytest.approx(5.2)


@pytest.mark.parametrize(
    ("model", "d"),
    [
        ("plumb_bob", (-0.3, 0.1, 0.001, -0.002, 0.0)),
        ("rational_polynomial", (0.4, -0.3, 1e-3, 2e-4, -0.05, 0.7, -0.2, -0.05)),
        ("equidistant", (0.05, -0.02, 0.003, 0.0)),
    ],
)
def test_images_of_a_lens_with_distortion_are_rectified(model, d, tmp_path):
    """A grid of dots on a plane, projected with OpenCV's model, stands where a pinhole shows it."""
    size, k = (480, 640), (500.0, 505.0, 320.0, 240.0)
    grid = np.stack(np.meshgrid(np.linspace(-0.3, 0.3, 5), np.linspace(-0.2, 0.2, 4), [1.0]), -1).reshape(-1, 1, 3)
    matrix = np.array([[k[0], 0, k[2]], [0, k[1], k[3]], [0, 0, 1]])
    project = cv2.fisheye.projectPoints if model == "equidistant" else cv2.projectPoints
    zero = np.zeros(3)
    bent = project(grid, zero, zero, matrix, np.array(d))[0].reshape(-1, 2)
    straight = cv2.projectPoints(grid, zero, zero, matrix, np.zeros(4))[0].reshape(-1, 2)
    assert np.abs(bent - straight).max() > 5
    rgb, depth = np.zeros((*size, 3), np.uint8), np.full(size, 0, np.uint16)
    for u, v in bent:
        cv2.circle(rgb, (round(16 * u), round(16 * v)), 16 * 6, (255, 255, 255), -1, cv2.LINE_AA, 4)
    depth[rgb[..., 0] > 127] = 1000
    write_bag(
        tmp_path / "bag",
        [
            (INFO, 1.0, camera_info(size, k, d, model)),
            (COLOR, 1.0, image(rgb, "rgb8", 1.0)),
            (DEPTH, 1.0, image(depth, "16UC1", 1.0)),
        ],
    )
    with RosbagSource(tmp_path / "bag") as source:
        frame = source.read()
    assert frame.rgb is not None
    assert frame.depth is not None
    assert frame.camera is not None
    assert not frame.camera.intrinsics.distorted
    for mask in (frame.rgb[..., 0] > 127, frame.depth > 0):
        _, _, stats, centres = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
        found = centres[1:][stats[1:, cv2.CC_STAT_AREA] > 20]  # the nearest pixel may separate one from an edge
        assert len(found) == len(straight)
        apart = np.linalg.norm(found[:, None] - straight[None], axis=2).min(axis=1)
        assert apart.max() < 0.6
    assert set(np.unique(frame.depth)) == {0, 1000}  # no depth between an edge and what is behind it


# ---- encodings of images

DRAW = np.random.default_rng(1)
NOISE = DRAW.integers(0, 256, (20, 30, 3), np.uint8)
MILLIMETRES = DRAW.integers(0, 65536, (20, 30)).astype(np.uint16)
SMOOTH = np.stack([*np.meshgrid(np.arange(0, 256, 8), np.arange(0, 256, 8)), np.full((32, 32), 90)], -1)
SMOOTH = SMOOTH.astype(np.uint8)


@pytest.mark.parametrize("padding", [0, 6])
@pytest.mark.parametrize(
    ("encoding", "code"),
    [
        ("rgb8", None),
        ("bgr8", cv2.COLOR_RGB2BGR),
        ("rgba8", cv2.COLOR_RGB2RGBA),
        ("bgra8", cv2.COLOR_RGB2BGRA),
        ("8UC3", cv2.COLOR_RGB2BGR),
        ("8UC4", cv2.COLOR_RGB2BGRA),
    ],
)
def test_raw_colour_is_exact_whatever_its_rows_end_with(encoding, code, padding):
    stored = NOISE if code is None else np.asarray(cv2.cvtColor(NOISE, code))
    message = image(stored, encoding, 1.0, padding=padding)
    assert kind_of(message) == "colour"
    assert np.array_equal(read_colour(message), NOISE)
    gray = image(NOISE[..., 0], "mono8", 1.0, padding=padding)
    assert kind_of(gray) == "gray"
    assert np.array_equal(read_colour(gray), np.repeat(NOISE[..., :1], 3, axis=2))


def yuyv(colour):
    """Return an image of one colour as Y U Y V, by ITU-R BT.601."""
    weights = np.array([[65.481, 128.553, 24.966], [-37.797, -74.203, 112.0], [112.0, -93.786, -18.214]])
    y, u, v = np.rint(weights @ np.array(colour) / 255 + (16, 128, 128))
    packed = np.full((16, 16, 2), y, np.uint8)
    packed[:, 0::2, 1], packed[:, 1::2, 1] = u, v
    return packed


def test_yuv_and_bayer_give_the_colours_of_uniform_images():
    for colour in ((200, 40, 30), (30, 60, 200), (60, 180, 60)):
        packed = yuyv(colour)
        for encoding, stored in (("yuv422_yuy2", packed), ("yuv422", packed[..., ::-1])):
            found = read_colour(image(np.ascontiguousarray(stored), encoding, 1.0))
            assert np.abs(found.astype(int) - colour).max() <= 3
        for pattern in ("rggb", "bggr", "gbrg", "grbg"):
            mosaic = np.empty((16, 16), np.uint8)
            for at, name in enumerate(pattern):
                mosaic[at // 2 :: 2, at % 2 :: 2] = colour["rgb".index(name)]
            found = read_colour(image(mosaic, f"bayer_{pattern}8", 1.0))
            assert np.abs(found[4:-4, 4:-4].astype(int) - colour).max() <= 1


@pytest.mark.parametrize("kind", ["jpeg", "png", "bgr8; jpeg compressed bgr8", "rgb8; png compressed bgr8"])
def test_compressed_colour_is_decoded_from_bgr(kind):
    exact = "png" in kind
    rgb = NOISE if exact else SMOOTH
    data = cv2.imencode(".png" if exact else ".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
    message = compressed(data, kind, 1.0)
    assert kind_of(message) == "colour"
    assert np.abs(read_colour(message).astype(int) - rgb).max() <= (0 if exact else 12)


@pytest.mark.parametrize("big_endian", [False, True])
def test_raw_depth_is_exact_in_both_byte_orders(big_endian):
    metres = (MILLIMETRES / 1000).astype(np.float32)
    metres[0, 0] = np.nan
    for pixels, encoding in ((MILLIMETRES, "16UC1"), (metres, "32FC1")):
        message = image(pixels, encoding, 1.0, padding=4, big_endian=big_endian)
        assert kind_of(message) == "depth"
        found = read_depth(message)
        assert found.dtype == pixels.dtype
        assert np.array_equal(found, pixels, equal_nan=True)


def test_compressed_depth_is_decoded():
    png = cv2.imencode(".png", MILLIMETRES)[1].tobytes()
    for data, kind in (
        (struct.pack("<iff", 0, 0.0, 0.0) + png, "16UC1; compressedDepth png"),
        (struct.pack("<iff", 0, 0.0, 0.0) + png, "16UC1; compressedDepth"),
        (png, "16UC1; png compressed"),
        (png, "png"),  # as published by hand, without the encoding
        (struct.pack("<iff", 0, 0.0, 0.0) + png, "compressedDepth"),
    ):
        message = compressed(data, kind, 1.0)
        assert kind_of(message) == "depth"
        assert np.array_equal(read_depth(message), MILLIMETRES)


def test_quantized_inverse_depth_is_decoded():
    """Encoded as ``compressed_depth_image_transport`` does it: a/z + b, with precision 100 at 10 m."""
    metres = np.linspace(0.4, 5.0, 600, dtype=np.float32).reshape(20, 30)
    a = 100.0 * (100.0 + 1.0)
    b = 1.0 - a / 10.0
    stored = (a / metres + b).astype(np.uint16)
    stored[0, 0] = 0
    png = cv2.imencode(".png", stored)[1].tobytes()
    for kind in ("32FC1; compressedDepth png", "compressedDepth"):
        found = read_depth(compressed(struct.pack("<iff", 1, a, b) + png, kind, 1.0))
        assert np.isnan(found[0, 0])
        assert np.allclose(found.ravel()[1:], metres.ravel()[1:], rtol=2e-3)


@pytest.mark.parametrize(
    ("read", "message", "expected"),
    [
        (read_colour, image(NOISE, "rgb16", 1.0), "'rgb16' is no colour image; expected rgb8, bgr8"),
        (read_depth, image(NOISE, "rgb8", 1.0), "'rgb8' is no depth image; expected 16UC1"),
        (read_colour, compressed(b"junk", "jpeg", 1.0), "not an image that can be read"),
        (read_depth, compressed(b"x" * 40, "16UC1; compressedDepth rvl", 1.0), "rvl' is not supported; expected depth"),
    ],
)
def test_what_cannot_be_decoded_says_why(read, message, expected):
    with pytest.raises(ValueError, match=expected):
        read(message)
    cut = image(NOISE, "rgb8", 1.0)
    cut.data = cut.data[:-1]
    with pytest.raises(ValueError, match="needs 1800 bytes in rows of 90; it has 1799 in rows of 90"):
        read_colour(cut)


def test_messages_of_a_live_node_are_read_too():
    """``rclpy`` keeps data in an ``array.array``, not in a NumPy array."""
    for message, read, pixels in (
        (image(NOISE, "rgb8", 1.0), read_colour, NOISE),
        (image(MILLIMETRES, "16UC1", 1.0), read_depth, MILLIMETRES),
        (compressed(cv2.imencode(".png", NOISE[..., ::-1])[1].tobytes(), "png", 1.0), read_colour, NOISE),
    ):
        message.data = array.array("B", message.data.tobytes())
        assert np.array_equal(read(message), pixels)


# ---- errors


def test_flipped_bytes_never_raise_anything_else(mcap, frames, tmp_path):
    whole = np.frombuffer(mcap.read_bytes(), np.uint8)
    draw = np.random.default_rng(0)
    path = tmp_path / "flipped.mcap"
    messages: list[str] = []
    for _ in range(20):
        data = whole.copy()
        at = draw.integers(0, len(data), 1 + draw.integers(4))
        at[0] = len(data) - draw.integers(1, 3000)  # the index is at the end
        data[at] ^= draw.integers(1, 256, len(at)).astype(np.uint8)
        path.write_bytes(data.tobytes())
        try:
            with warnings.catch_warnings(), open_source(path) as source:
                warnings.simplefilter("ignore")
                assert sum(1 for _ in read_moments(source)) <= len(frames)
        except BadRecording as error:
            messages.append(str(error))
    assert 2 < len(messages) < 20
    assert all("flipped.mcap" in message and "\n" not in message for message in messages)


def test_a_bag_without_an_index_is_read(mcap, frames, tmp_path):
    """A footer without a summary: what a recorder writes that was asked for no index."""
    whole = mcap.read_bytes()
    summary = int.from_bytes(whole[-28:-20], "little")
    bare = whole[:summary] + whole[-37:-28] + bytes(20) + whole[-8:]
    (tmp_path / "bare.mcap").write_bytes(bare)
    with open_source(tmp_path / "bare.mcap") as source:
        read = frames_of(source)
    assert len(read) == len(frames)
    assert all(np.array_equal(frame.rgb, rgb) for frame, (rgb, _) in zip(read, frames, strict=True))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("half.mcap", r"half\.mcap: it cannot be opened.*mcap recover"),
        ("empty.mcap", r"empty\.mcap: .*empty"),
        ("none.mcap", "no such file"),
        ("alone", "missing"),
        ("broken", "YAML"),
        ("else", "metadata key"),
        ("sqlite/sqlite.db3", "part of a rosbag2: give its folder, .*sqlite"),
    ],
)
def test_bad_files_and_folders_are_refused(mcap, frames, tmp_path, name, message):
    whole, listed = mcap.read_bytes(), (mcap.parent / "metadata.yaml").read_text()
    for file, data in (("half", whole[: len(whole) // 2]), ("empty", b"")):
        (tmp_path / f"{file}.mcap").write_bytes(data)
    for folder, text in (("alone", listed), ("broken", "{"), ("else", "a: 1")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "metadata.yaml").write_text(text)
    write_bag(tmp_path / "sqlite", rgbd_messages(frames[:2], K), "sqlite3")
    with pytest.raises(BadRecording, match=message):
        open_source(tmp_path / name).connect()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"depth": True}, "expected a topic, or false"),
        ({"start": -1.0}, "start: expected seconds"),
        ({"colour": "/x"}, r"does not take \['colour'\]"),
    ],
)
def test_bad_arguments_are_refused(mcap, arguments, message):
    with pytest.raises(ValueError, match=message):
        open_source(mcap, **arguments)


# ---- the command


def test_replay_finds_the_shape_in_a_bag(run, tmp_path):
    frames = []
    for shift in range(6):
        rgb, depth = np.full((240, 320, 3), 200, np.uint8), np.full((240, 320), 700, np.uint16)
        cv2.line(rgb, (60 + shift, 90), (260 + shift, 140), (20, 60, 200), 7)
        frames.append((rgb, depth))
    file = write_bag(tmp_path / "bags" / "rope", rgbd_messages(frames, (300.0, 300.0, 159.5, 119.5)))
    config = tmp_path / "rope.yaml"
    config.write_text(
        "version: 1\nshape: {shapes: [{kind: centerline, n: 10, ends: tips}], features: [points3d]}\n"
        "scene: {segmentation: {kind: hsv, low: [100, 120, 40], high: [125, 255, 255]}}\n"
    )
    code, out, err = run("replay", file, "--config", config, "--npz", tmp_path / "rope.npz", "--json")
    assert code == 0, err
    assert json.loads(out)["shapes"]["centerline"]["ok"] == 6
    points = np.load(tmp_path / "rope.npz")["centerline/points3d"]
    ends = np.sort(points[:, [0, -1], 0], axis=1)
    assert np.allclose(ends[:, 0], (60 - 3.5 + np.arange(6) - 159.5) * 0.7 / 300, atol=0.003)
    assert np.allclose(points[..., 2], 0.7, atol=0.002)
    code, _, err = run("replay", file, "--config", config, "--set", "depth=false")
    assert code == 1
    assert "has no depth, but the config needs it: feature 'points3d'" in err
