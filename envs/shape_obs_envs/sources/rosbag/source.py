"""A source of frames from a ROS 2 bag."""

from __future__ import annotations

import time
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Final

from shape_obs.camera import CameraModel
from shape_obs.extrinsics import Extrinsics
from shape_obs.frame import Frame
from shape_obs.source import BadRecording, EndOfSource
from shape_obs_envs.sources.rectification import Rectification
from shape_obs_envs.sources.rosbag.bag import Bag
from shape_obs_envs.sources.rosbag.images import read_colour, read_depth
from shape_obs_envs.sources.rosbag.lens import read_lens
from shape_obs_envs.sources.rosbag.pairing import Image, half_interval, pair_images
from shape_obs_envs.sources.rosbag.topics import Topics, choose_topics
from shape_obs_envs.sources.sequence import SequenceSource

#: Number of colour images whose stamps give the time between frames.
_SAMPLE: Final = 16


class RosbagSource(SequenceSource):
    """Frames of a ROS 2 bag: an ``.mcap`` file, or a rosbag2 folder (MCAP or SQLite).

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
        UserWarning: By ``connect``: depth is not aligned to colour and left out, or there are no intrinsics.
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
        self._count, self._read, self._gaps = 0, 0, list[float]()
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
