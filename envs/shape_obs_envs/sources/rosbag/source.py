"""A source of frames from a ROS bag."""

from __future__ import annotations

import time
import warnings
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice, pairwise
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from shape_obs.camera import CameraModel, Intrinsics
from shape_obs.extrinsics import Extrinsics
from shape_obs.frame import Frame
from shape_obs.source import BadRecording, EndOfSource
from shape_obs_envs.sources.rectification import Rectification
from shape_obs_envs.sources.rosbag.images import read_colour, read_depth
from shape_obs_envs.sources.rosbag.topics import Bag, Topics, choose_topics
from shape_obs_envs.sources.sequence import SequenceSource

#: Largest number of colour images that wait for their depth. Bags store messages as they arrived, and depth may take
#: some frames longer; what waits longer has no depth.
_PENDING: Final = 30
#: Added to half a frame, in seconds: stamps jitter.
_JITTER: Final = 0.001

#: distortion model of ROS -> the numbers of coefficients that it may have
_MODELS: Final = {"plumb_bob": (4, 5), "rational_polynomial": (8, 12, 14), "equidistant": (4,)}
_FISHEYE: Final = "equidistant"

#: Number of colour images whose stamps give the time between frames.
_SAMPLE: Final = 16


class Image(NamedTuple):
    """An image message and when it was taken.

    Attributes:
        number: How many images of its topic came before.
        stamp: Seconds of the camera's clock.
        message: The message.
    """

    number: int
    stamp: float
    message: Any


def half_interval(stamps: Sequence[float]) -> float:
    """Return half of the usual time between frames in seconds, with a margin for jitter, from some stamps."""
    steps = sorted(after - before for before, after in pairwise(stamps) if after > before)
    return (steps[len(steps) // 2] / 2 if steps else 0.5) + _JITTER


def pair_images(
    images: Iterable[tuple[bool, Image]], max_gap: float, gaps: list[float] | None = None
) -> Iterator[tuple[Image, Image]]:
    """Yield each colour image with the depth image that is nearest in time; one without such a depth is left out.

    Args:
        images: Colour and depth images as they arrived; True for depth.
        max_gap: Largest time between the two in seconds.
        gaps: Filled with the gap of each colour image to its nearest depth image; None if not needed.
    """
    colours: deque[Image] = deque()
    depths: deque[Image] = deque()

    def match(colour: Image) -> Iterator[tuple[Image, Image]]:
        nearest = min(depths, key=lambda depth: abs(depth.stamp - colour.stamp), default=None)
        if nearest is None:
            return
        gap = abs(nearest.stamp - colour.stamp)
        if gaps is not None:
            gaps.append(gap)
        if gap <= max_gap:
            yield colour, nearest
        while depths and depths[0].stamp < colour.stamp - max_gap and depths[0] is not depths[-1]:
            depths.popleft()

    for is_depth, image in images:
        (depths if is_depth else colours).append(image)
        while colours and ((depths and depths[-1].stamp >= colours[0].stamp) or len(colours) > _PENDING):
            yield from match(colours.popleft())
        while len(depths) > _PENDING:
            depths.popleft()
    for colour in colours:
        yield from match(colour)


def read_lens(message: Any, size: tuple[int, int], rectified: bool, topic: str) -> Rectification | None:
    """Return how to rectify the images that a ``CameraInfo`` describes; None if the camera is not calibrated.

    Args:
        message: The message.
        size: ``(H, W)`` of the images.
        rectified: Whether the images are rectified already; their intrinsics are then those of P, not of K.
        topic: The topic of the message, for errors.

    Raises:
        BadRecording: It describes images of another size, a part of the image, or an unknown lens.
    """
    k, d, p = (getattr(message, name if hasattr(message, name) else name.upper()) for name in "kdp")  # ROS 1: K, D, P
    matrix = np.reshape(k, (3, 3))
    if rectified and np.any(p):
        matrix = np.reshape(p, (3, 4))[:, :3]
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0):
        return None
    if (message.height, message.width) != size:
        raise BadRecording(
            f"{topic} describes images of {message.width} x {message.height} pixels, the colour image has {size[1]} x "
            f"{size[0]}: choose the topic of this image with info=, or info=false for frames without intrinsics."
        )
    roi = message.roi
    if max(message.binning_x, message.binning_y) > 1 or roi.x_offset or roi.y_offset:
        raise BadRecording(f"{topic}: binning and regions of interest are not supported; record the whole image.")
    fx, fy, cx, cy = (float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    pinhole = Intrinsics(size[1], size[0], fx, fy, cx, cy)
    if rectified or not np.any(d):
        return Rectification(pinhole, None)
    model, count = message.distortion_model, len(d)
    if count not in _MODELS.get(model, ()):
        raise BadRecording(
            f"{topic}: the distortion model {model!r} with {count} coefficients is not supported, expected "
            f"{', '.join(_MODELS)}: record the rectified image (image_proc), or give its topic with color=."
        )
    return Rectification.from_opencv(pinhole, np.asarray(d, np.float64), fisheye=model == _FISHEYE)


class RosbagSource(SequenceSource):
    """Frames of a ROS bag: an ``.mcap`` or ``.db3`` file, a rosbag2 folder (MCAP or SQLite), or a ``.bag`` of ROS 1.

    Images are paired by the stamps of their headers: a frame is a colour image with the nearest aligned depth image, at
    most half a frame away; colour images without one are left out, which leaves gaps in ``Frame.number``. Images are
    rectified with the ``CameraInfo`` unless the topic's name says that they are (``image_rect``). Colour may be
    raw (RGB, BGR, YUV 4:2:2, Bayer, gray) or compressed (JPEG, PNG), depth 16-bit millimetres or 32-bit metres, raw or
    as PNG (``compressedDepth``).

    Args:
        path: The file or folder.
        extrinsics: See ``Source``.
        color: Topic of the colour images; None to find it.
        depth: Topic of the depth images, aligned to colour; None to find it, False for colour only.
        info: Topic of the ``CameraInfo`` of the colour images; None to find it, False for none.
        max_gap: Largest time between colour and depth in seconds; None for half of the time between frames.
        start: Seconds after the beginning of the bag at which to start.

    Raises:
        ValueError: An argument is invalid.
        ImportError: By ``connect``: the extra ``ros`` is not installed.
        BadRecording: By ``connect``: the path is not a ROS 2 bag, truncated, or without one colour topic; the message
            lists the topics. By ``read``: the file is damaged, or no depth belongs to any colour image.

    Warns:
        UserWarning: By ``connect``: depth is not aligned to colour and left out, or there are no intrinsics. At the
            end: colour images without depth were left out.
    """

    kind: str = "rosbag"

    def __init__(
        self,
        path: str | Path,
        extrinsics: Extrinsics | str | Path | None = None,
        *,
        color: str | None = None,
        depth: str | bool | None = None,
        info: str | bool | None = None,
        max_gap: float | None = None,
        start: float = 0.0,
    ) -> None:
        super().__init__(str(path), extrinsics)
        if depth is True or info is True:
            raise ValueError("depth, info: expected a topic, or false for none; leave it out to find the topic.")
        if (max_gap is not None and not max_gap >= 0) or not start >= 0:
            raise ValueError(f"max_gap, start: expected seconds, 0 or more, got {max_gap!r} and {start!r}.")
        self.path = Path(path)
        self._wanted = color, depth, info
        self._max_gap, self._start = max_gap, start
        self._bag: Bag | None = None
        self._topics: Topics | None = None
        self._lens: Rectification | None = None
        self._count, self._read, self._gap, self._gaps = 0, 0, 0.0, list[float]()
        self._pairs: Iterator[tuple[Image, Image | None]] = iter(())

    def __len__(self) -> int:
        """Return the number of colour images; 0 before ``connect``. Those without depth are left out later."""
        return self._count

    @property
    def has_depth(self) -> bool:
        """Whether frames include depth."""
        self._check_connected()
        return self._topics is not None and self._topics.depth is not None

    @property
    def topics(self) -> Topics:
        """The topics that are read."""
        self._check_connected()
        assert self._topics is not None
        return self._topics

    def connect(self) -> None:
        """Open the bag, choose its topics, and start at its first frame."""
        if self._connected:
            return
        if not self.path.exists():
            raise BadRecording(f"{self.path}: no such file or folder.")
        bag = Bag(self.path)
        try:
            with bag.explained("it is damaged"):
                topics = choose_topics(bag, *self._wanted)
                self._lens = None
                if topics.info is not None:
                    message, colour = bag.first(topics.info), topics.colour
                    self._lens = read_lens(message, colour.size, colour.rectified, f"{self.path}: {topics.info}")
                self._pairs = self._paired(bag, topics)
        except BadRecording:
            bag.close()
            raise
        self._bag, self._topics, self._count, self._read = bag, topics, bag.count(topics.colour.topic), 0
        self._connected = True

    def disconnect(self) -> None:
        """Close the bag."""
        if self._bag is not None:
            self._pairs = iter(())
            self._bag.close()
            self._bag = None
        super().disconnect()

    def _paired(self, bag: Bag, topics: Topics) -> Iterator[tuple[Image, Image | None]]:
        colour, self._gaps = topics.colour.topic, []
        if topics.depth is None:
            return ((image, None) for _, image in _images(bag, [colour], self._start, None))
        depth, gap = topics.depth.topic, self._max_gap
        if gap is None:
            gap = half_interval([stamp for _, stamp, _ in islice(bag.messages([colour]), _SAMPLE)])
        self._gap = gap
        return pair_images(_images(bag, [colour, depth], self._start, depth), gap, self._gaps)

    def _next(self) -> Frame:
        pair = next(self._pairs, None)
        if pair is None:
            if not self._read and self._gaps:
                raise BadRecording(
                    f"{self.path}: no depth image is within {1000 * self._gap:.0f} ms of any colour image; the nearest "
                    f"is {min(self._gaps):.3f} s away. Their clocks differ; --set max_gap=SECONDS allows more."
                )
            left_out = sum(gap > self._gap for gap in self._gaps)
            if left_out:
                warnings.warn(
                    f"{self.path}: {left_out} of {len(self._gaps)} colour images were left out: no depth image is "
                    f"within {1000 * self._gap:.0f} ms of them; --set max_gap=SECONDS allows more.",
                    stacklevel=2,
                )
            raise EndOfSource(f"{self.path}: end of its {self._read} frames.")
        assert self._bag is not None
        self._read += 1
        colour, depth = pair
        with self._bag.explained(f"colour image {colour.number}"):
            rgb = read_colour(colour.message)
            metres = None if depth is None else read_depth(depth.message)
            if self._lens is not None and self._lens.output.size == rgb.shape[:2]:
                rgb = self._lens.colour(rgb)
                metres = None if metres is None else self._lens.depth(metres)
            return Frame(rgb, metres, self.camera, colour.stamp, time.monotonic(), colour.number)

    def _known_camera(self) -> CameraModel | None:
        return None if self._lens is None else CameraModel(self._lens.output)


def _images(bag: Bag, topics: list[str], start: float, depth: str | None) -> Iterator[tuple[bool, Image]]:
    """Yield image messages with their numbers, and whether they are of the topic ``depth``."""
    counts = dict.fromkeys(topics, 0)
    for topic, stamp, message in bag.messages(topics, start):
        yield topic == depth, Image(counts[topic], stamp, message)
        counts[topic] += 1
