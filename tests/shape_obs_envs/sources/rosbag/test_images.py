"""Every encoding of an image gives the array that was encoded."""

from __future__ import annotations

import array
import struct

import cv2
import numpy as np
import pytest

pytest.importorskip("rosbags")

from ros_bags import compressed, image

from shape_obs_envs.sources.rosbag.images import kind_of, read_colour, read_depth

DRAW = np.random.default_rng(1)
NOISE = DRAW.integers(0, 256, (20, 30, 3), np.uint8)
MILLIMETRES = DRAW.integers(0, 65536, (20, 30)).astype(np.uint16)
SMOOTH = np.stack([*np.meshgrid(np.arange(0, 256, 8), np.arange(0, 256, 8)), np.full((32, 32), 90)], -1)
SMOOTH = SMOOTH.astype(np.uint8)


@pytest.mark.parametrize("padding", [0, 6])
@pytest.mark.parametrize(
    ("encoding", "code"),
    [("rgb8", None), ("bgr8", cv2.COLOR_RGB2BGR), ("rgba8", cv2.COLOR_RGB2RGBA), ("bgra8", cv2.COLOR_RGB2BGRA)],
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
    found = read_depth(compressed(struct.pack("<iff", 1, a, b) + png, "32FC1; compressedDepth png", 1.0))
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
