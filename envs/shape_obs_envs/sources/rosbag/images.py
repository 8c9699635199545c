"""Decode ROS image messages to the arrays of a frame.

References:
    ``sensor_msgs/image_encodings.hpp``; the codecs of ``image_transport_plugins``: ``compressed_image_transport`` and
    ``compressed_depth_image_transport``.
"""

from __future__ import annotations

import struct
from typing import Any, Final, Literal

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.utils.arrays import decode_image

Kind = Literal["colour", "gray", "depth", "other"]

#: encoding -> number of bytes of a pixel, and OpenCV's conversion to RGB
_COLOURS: Final[dict[str, tuple[int, int | None]]] = {
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    # Without a name of the channels: as OpenCV, which such nodes use, and rviz have them.
    "8UC3": (3, cv2.COLOR_BGR2RGB),
    "8UC4": (4, cv2.COLOR_BGRA2RGB),
    "yuv422": (2, cv2.COLOR_YUV2RGB_UYVY),
    "uyvy": (2, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2RGB_YUYV),
    "yuyv": (2, cv2.COLOR_YUV2RGB_YUYV),
    # OpenCV names a pattern by the second row, ROS by the first one.
    "bayer_rggb8": (1, cv2.COLOR_BayerBG2RGB),
    "bayer_bggr8": (1, cv2.COLOR_BayerRG2RGB),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGR2RGB),
    "bayer_grbg8": (1, cv2.COLOR_BayerGB2RGB),
}
_GRAYS: Final = ("mono8", "8UC1")
_DEPTHS: Final[dict[str, Any]] = {"16UC1": np.uint16, "mono16": np.uint16, "32FC1": np.float32}
#: What can be read.
ENCODINGS: Final = {"colour": (*_COLOURS, *_GRAYS), "depth": tuple(_DEPTHS)}
#: Encodings that do not name the order of their channels.
UNNAMED: Final = ("8UC3", "8UC4")
_PNG: Final = b"\x89PNG"
#: Where the header of a PNG has the bits and the kind of its pixels, in bytes from its beginning.
_PNG_PIXELS: Final = slice(24, 26)
_GRAY_16: Final = bytes((16, 0))
_QUANTIZATION: Final = struct.Struct("<iff")  # before a PNG of compressedDepth: format, and two parameters


def kind_of(message: Any) -> Kind:
    """Return what an ``Image`` or ``CompressedImage`` shows, by its encoding."""
    encoding = encoding_of(message)
    if encoding in _DEPTHS:
        return "depth"
    if encoding in _GRAYS:
        return "gray"
    return "colour" if encoding in _COLOURS or hasattr(message, "format") else "other"


def read_colour(message: Any) -> npt.NDArray[np.uint8]:
    """Return a new RGB image of shape ``(H, W, 3)``.

    Raises:
        ValueError: The encoding is not supported, or the data are damaged.
    """
    if hasattr(message, "format"):
        image = np.asarray(decode_image(message.data.tobytes(), cv2.IMREAD_COLOR, "a compressed image"), np.uint8)
        # The encoder compresses BGR, unless its format says otherwise.
        in_rgb = "compressed rgb" in message.format
        return image if in_rgb else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)
    encoding = message.encoding
    if encoding in _GRAYS:
        return np.asarray(cv2.cvtColor(_pixels(message, 1, np.uint8), cv2.COLOR_GRAY2RGB), np.uint8)
    if encoding not in _COLOURS:
        raise ValueError(f"the encoding {encoding!r} is no colour image; expected {', '.join(ENCODINGS['colour'])}.")
    channels, conversion = _COLOURS[encoding]
    pixels = _pixels(message, channels, np.uint8)
    return pixels if conversion is None else np.asarray(cv2.cvtColor(pixels, conversion), np.uint8)


def read_depth(message: Any) -> npt.NDArray[Any]:
    """Return a new depth image of shape ``(H, W)``: uint16 millimetres or float32 metres, as ROS's REP 118 has it.

    Raises:
        ValueError: The encoding is not supported, or the data are damaged.
    """
    encoding = encoding_of(message)
    if encoding not in _DEPTHS:
        raise ValueError(f"the encoding {encoding!r} is no depth image; expected {', '.join(ENCODINGS['depth'])}.")
    if not hasattr(message, "format"):
        return _pixels(message, 1, _DEPTHS[encoding])
    data = message.data.tobytes()
    begin = data.find(_PNG)
    if begin < 0:
        raise ValueError(f"the format {message.format!r} is not supported; expected depth compressed as PNG.")
    image = decode_image(data[begin:], cv2.IMREAD_UNCHANGED, "a compressed depth image")
    if image.ndim != 2 or image.dtype != np.uint16:
        raise ValueError(f"expected a PNG with 16 bits, got shape {image.shape} of {image.dtype}.")
    if _DEPTHS[encoding] is np.uint16:
        return image
    if begin != _QUANTIZATION.size:
        raise ValueError("expected the parameters of the quantized inverse depth before the PNG, found none.")
    _, scale, offset = _QUANTIZATION.unpack(data[:begin])
    with np.errstate(divide="ignore"):
        depth = scale / (image.astype(np.float32) - np.float32(offset))
    return np.where(image > 0, depth, np.nan).astype(np.float32)


def encoding_of(message: Any) -> str:
    """Return the encoding of the image; of a compressed one that of the image that was compressed, if it is known."""
    if not hasattr(message, "format"):
        return message.encoding
    encoding = message.format.split(";")[0].strip()
    head = bytes(message.data[: _QUANTIZATION.size + 32])
    begin = head.find(_PNG)
    if encoding in _DEPTHS or begin < 0 or head[begin:][_PNG_PIXELS] != _GRAY_16:
        return encoding
    # Some publishers write only "png": 16 bits of gray are depth, quantized if parameters stand before the PNG.
    quantized = begin == _QUANTIZATION.size and _QUANTIZATION.unpack(head[:begin])[1] != 0
    return "32FC1" if quantized else "16UC1"


def _pixels(message: Any, channels: int, dtype: Any) -> npt.NDArray[Any]:
    """Copy the pixels, without the padding of the rows, in this machine's byte order."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    stored = np.dtype(dtype).newbyteorder(">" if message.is_bigendian else "<")
    row = width * channels * stored.itemsize
    if width < 1 or height < 1 or step < row or len(message.data) < step * height:
        raise ValueError(
            f"an image of {width} x {height} pixels in {message.encoding!r} needs {row * height} bytes in rows of "
            f"{row}; it has {len(message.data)} in rows of {step}."
        )
    rows = np.asarray(message.data)[: step * height].view(np.uint8).reshape(height, step)[:, :row]
    pixels = np.ascontiguousarray(rows).view(stored).reshape(height, width, channels).astype(dtype)
    return pixels[:, :, 0] if channels == 1 else pixels
