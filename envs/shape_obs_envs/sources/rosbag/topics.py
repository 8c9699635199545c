"""A bag of ROS messages, and its topics of colour, aligned depth and intrinsics.

Names of the drivers of RealSense, Orbbec, ZED, OAK and Azure Kinect cameras decide only between several candidates:
what an image shows is read from its encoding, and whether depth is aligned from its frame and size.
"""

from __future__ import annotations

import sqlite3
import struct
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from shape_obs.source import BadRecording
from shape_obs.spec import did_you_mean
from shape_obs.utils.errors import install_hint
from shape_obs_envs.sources.rosbag.images import ENCODINGS, UNNAMED, Kind, encoding_of, kind_of, read_colour, read_depth

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

IMAGE: Final = "sensor_msgs/msg/Image"
COMPRESSED: Final = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO: Final = "sensor_msgs/msg/CameraInfo"

_NANO: Final = 1e-9
#: The errors of the libraries that ``rosbags`` may read files with.
_LIBRARIES: Final = (
    ("apsw", "Error"), ("backports.zstd", "ZstdError"), ("compression.zstd", "ZstdError"), ("zstandard", "ZstdError"),
)  # fmt: skip

#: Parts of a topic's name that image_transport adds.
_TRANSPORTS: Final = ("compressed", "compressedDepth")
_COLOUR_NAMES: Final = ("color", "colour", "rgb")
_ALIGNED_NAMES: Final = ("aligned", "registered", "to_color", "to_rgb")
_RECTIFIED: Final = "rect"


class Bag:
    """An open bag.

    Args:
        path: An ``.mcap``, ``.db3`` or ROS 1 ``.bag`` file, or a folder with a ``metadata.yaml``.

    Attributes:
        path: The file or folder.
        types: The type of each topic that has messages.

    Raises:
        ImportError: ``rosbags`` is not installed.
        BadRecording: The file cannot be read.
    """

    def __init__(self, path: Path) -> None:
        try:
            from rosbags.highlevel import AnyReader
            from rosbags.typesys import Stores, get_typestore
        except ImportError as error:
            raise ImportError(
                f"ROS bags need the package rosbags: {install_hint('ros')}. ({error})", name="rosbags"
            ) from error
        self.path, self._damage = path, _damage()
        with self.explained("it cannot be opened as a ROS bag"):
            # Bags of ROS before Iron do not contain the definitions of their messages; those of images never changed.
            reader: AnyReader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
            reader.open()
        self._reader = reader
        self.types = {name: topic.msgtype or "" for name, topic in reader.topics.items() if topic.msgcount}

    def count(self, topic: str) -> int:
        """Return the number of messages of a topic."""
        return self._reader.topics[topic].msgcount

    def first(self, topic: str) -> Any:
        """Return the first message of a topic.

        Raises:
            BadRecording: The file is damaged.
        """
        for _, _, message in self.messages([topic]):
            return message
        raise BadRecording(f"{self.path}: its index counts messages of {topic}, but there are none; it is damaged.")

    def messages(self, topics: Sequence[str], start: float = 0.0) -> Iterator[tuple[str, float, Any]]:
        """Yield the messages of topics in the order in which they were recorded: topic, stamp in seconds, message.

        The stamp is that of the message's header, or the time of its recording if the header has none.

        Args:
            topics: The topics.
            start: Seconds after the beginning of the bag at which to start.

        Raises:
            BadRecording: The file is damaged.
        """
        reader = self._reader
        connections = [each for each in reader.connections if each.topic in topics]
        with self.explained("it is damaged"):
            begin = reader.start_time + round(start / _NANO) if start else None
            for connection, logged, data in reader.messages(connections, start=begin):
                message: Any = reader.deserialize(data, connection.msgtype)
                stamp = message.header.stamp
                nanoseconds = stamp.sec * 10**9 + stamp.nanosec
                yield connection.topic, (nanoseconds or logged) * _NANO, message

    def close(self) -> None:
        """Close the files."""
        self._reader.close()

    @contextmanager
    def explained(self, what: str) -> Iterator[None]:
        """Turn what ``rosbags`` and the readers of its messages raise on damaged files into ``BadRecording``.

        A bag defines its own messages, so in a damaged one they may lack attributes, or have others of their types.
        """
        try:
            yield
        except (BadRecording, GeneratorExit):
            raise
        except self._damage as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise BadRecording(f"{self.path}: {what}: {reason.rstrip('.')}.{_advice(self.path, reason)}") from error


def _advice(path: Path, reason: str) -> str:
    if any(word in reason for word in ("magic", "Truncated", "unpack requires")):
        return (
            " It is truncated, as after a crash, or not an MCAP file; copy it again, or repair it with "
            f"`mcap recover {path.name} -o repaired.mcap`."
        )
    if "Profile" in reason:
        return " It is an MCAP file of another system than ROS 2."
    return ""


def _damage() -> tuple[type[Exception], ...]:
    """Return what ``rosbags``, its database and its decompressors raise on files that are truncated or damaged."""
    from rosbags.highlevel import AnyReaderError
    from rosbags.rosbag2 import ReaderError
    from rosbags.serde import SerdeError
    from rosbags.typesys import TypesysError

    # Its parsers of binary records and of YAML leave the errors of Python as they are.
    python = (
        OSError, ValueError, TypeError, LookupError, EOFError, AttributeError, RuntimeError, AssertionError,
        MemoryError, OverflowError, struct.error, sqlite3.Error,
    )  # fmt: skip
    # Which libraries it uses depends on its version and on that of Python.
    loaded = [(sys.modules.get(name), error) for name, error in _LIBRARIES]
    return (
        AnyReaderError, ReaderError, SerdeError, TypesysError, *python,
        *(getattr(module, error) for module, error in loaded if module is not None),
    )  # fmt: skip


class Candidate(NamedTuple):
    """A topic with images.

    Attributes:
        topic: The topic.
        kind: What its images show.
        encoding: Their encoding, with the reason if they cannot be decoded.
        frame: The coordinate frame of the camera, ``header.frame_id``.
        size: ``(H, W)`` of the images.
    """

    topic: str
    kind: Kind
    encoding: str
    frame: str
    size: tuple[int, int]

    @property
    def base(self) -> str:
        """The topic without the name of a transport."""
        head, _, tail = self.topic.rpartition("/")
        return head if tail in _TRANSPORTS else self.topic

    @property
    def rectified(self) -> bool:
        """Whether the name says that the images are rectified."""
        return _RECTIFIED in self.base.rpartition("/")[2] or f"/{_RECTIFIED}/" in self.base


class Topics(NamedTuple):
    """The chosen topics.

    Attributes:
        colour: The colour images.
        depth: The depth images, aligned to colour; None without.
        info: The ``CameraInfo`` of the colour images; None without.
    """

    colour: Candidate
    depth: Candidate | None
    info: str | None


def choose_topics(bag: Bag, color: str | None, depth: str | bool | None, info: str | bool | None) -> Topics:
    """Choose the topics of a bag.

    Args:
        bag: The bag.
        color: The topic of the colour images; None to find it.
        depth: The topic of the aligned depth images; None to find it, False for none.
        info: The topic of the intrinsics; None to find it, False for none.

    Raises:
        BadRecording: There is no colour topic, there are several, or not the given ones; the message lists the topics.

    Warns:
        UserWarning: There is depth, but it is not aligned to the colour image, or there are no intrinsics.
    """
    images = [_candidate(bag, topic) for topic, kind in bag.types.items() if kind in (IMAGE, COMPRESSED)]
    depths = _one_transport([each for each in images if each.kind == "depth"])
    colour = _given(bag, images, "color", color) if color else _find_colour(bag, images, depths)
    if colour.encoding in UNNAMED:
        _warn(f"{bag.path}: {colour.topic} does not name its channels ({colour.encoding}); they are taken as BGR.")
    chosen = None
    if depth is None:
        chosen = _find_depth(bag, depths, colour)
    elif depth:
        chosen = _given(bag, images, "depth", str(depth))
        _check_depth(bag, chosen, colour)
    if info is None:
        found = _find_info(bag, colour)
        if found is None and chosen is not None:
            _warn(
                f"{bag.path}: no camera_info of {colour.topic}, so frames have no intrinsics; give its topic as info=."
            )
    elif info and bag.types.get(str(info)) != CAMERA_INFO:
        raise BadRecording(f"{bag.path}: info: no CameraInfo in {info}{_known(bag, str(info), (CAMERA_INFO,))}")
    else:
        found = str(info) if info else None
    return Topics(colour, chosen, found)


def _candidate(bag: Bag, topic: str) -> Candidate:
    message = bag.first(topic)
    kind, encoding, size = kind_of(message), encoding_of(message), (0, 0)
    if hasattr(message, "format"):
        try:
            size = (read_depth(message) if kind == "depth" else read_colour(message)).shape[:2]
        except ValueError as error:  # such as a video codec
            kind, encoding = "other", f"{encoding} ({str(error).rstrip('.')})"
    else:
        size = int(message.height), int(message.width)
    return Candidate(topic, kind, encoding, message.header.frame_id, size)


def _find_colour(bag: Bag, images: list[Candidate], depths: list[Candidate]) -> Candidate:
    found = [each for each in images if each.kind == "colour"] or [each for each in images if each.kind == "gray"]
    found = _prefer(_one_transport(found), lambda each: each.encoding not in UNNAMED)
    if not found:
        raise BadRecording(f"{bag.path}: no topic with colour images; it has {_content(bag, images)}.")
    found = _prefer(found, lambda each: any(part in _COLOUR_NAMES for part in each.topic.split("/")))
    found = _prefer(found, lambda each: any(_is_aligned(depth, each) for depth in depths))
    found = _prefer(found, lambda each: each.rectified)
    if len(found) > 1:
        raise BadRecording(
            f"{bag.path}: several topics with colour images, {', '.join(each.topic for each in found)}: choose one, "
            f"--set color={found[0].topic}."
        )
    return found[0]


def _find_depth(bag: Bag, depths: list[Candidate], colour: Candidate) -> Candidate | None:
    aligned = [each for each in depths if _is_aligned(each, colour)]
    aligned = _prefer(aligned, lambda each: any(name in each.topic for name in _ALIGNED_NAMES))
    aligned = _prefer(aligned, lambda each: each.rectified == colour.rectified)
    if len(aligned) > 1:
        raise BadRecording(
            f"{bag.path}: several topics with depth aligned to {colour.topic}, "
            f"{', '.join(each.topic for each in aligned)}: choose one, --set depth={aligned[0].topic}."
        )
    if depths and not aligned:
        _warn(
            f"{bag.path}: depth is left out: {', '.join(each.topic for each in depths)} is not aligned to "
            f"{colour.topic} (frame {depths[0].frame!r} against {colour.frame!r}, {_pixels(depths[0])} against "
            f"{_pixels(colour)}). Record depth aligned to colour (RealSense: align_depth.enable:=true, Orbbec: "
            "depth_registration:=true), or name an aligned topic with --set depth=TOPIC."
        )
    return aligned[0] if aligned else None


def _check_depth(bag: Bag, depth: Candidate, colour: Candidate) -> None:
    """Check a depth topic that the user chose."""
    if depth.size != colour.size:
        raise BadRecording(
            f"{bag.path}: {depth.topic} has {_pixels(depth)}, {colour.topic} has {_pixels(colour)}: depth must be "
            "aligned to colour, pixel by pixel; --set depth=false leaves it out."
        )
    if depth.frame != colour.frame:
        _warn(
            f"{bag.path}: {depth.topic} is in the frame {depth.frame!r}, {colour.topic} in {colour.frame!r}; it is "
            "taken as aligned. If it is not, all points in space are wrong."
        )


def _find_info(bag: Bag, colour: Candidate) -> str | None:
    infos = [topic for topic, kind in bag.types.items() if kind == CAMERA_INFO]
    for topic in (f"{colour.base.rpartition('/')[0]}/camera_info", f"{colour.base}/camera_info"):
        if topic in infos:
            return topic
    alike = [topic for topic in infos if bag.first(topic).header.frame_id == colour.frame != ""]
    return alike[0] if len(alike) == 1 else None


def _given(bag: Bag, images: list[Candidate], name: str, topic: str) -> Candidate:
    chosen = next((each for each in images if each.topic == topic), None)
    if chosen is None:
        raise BadRecording(f"{bag.path}: {name}: no images in {topic}{_known(bag, topic)}")
    wanted = ("depth",) if name == "depth" else ("colour", "gray")
    if chosen.kind not in wanted:
        supported = f"expected {', '.join(ENCODINGS[wanted[0]])}, or these compressed"
        raise BadRecording(
            f"{bag.path}: {name}: the images in {topic} have the encoding {chosen.encoding}; {supported}."
        )
    return chosen


def _is_aligned(depth: Candidate, colour: Candidate) -> bool:
    return depth.size == colour.size and depth.frame == colour.frame


def _one_transport(found: list[Candidate]) -> list[Candidate]:
    """Return one topic of each image: the raw one if there is one."""
    best: dict[str, Candidate] = {}
    for each in sorted(found, key=lambda each: each.topic != each.base):
        best.setdefault(each.base, each)
    return list(best.values())


def _prefer(found: list[Candidate], condition: Callable[[Candidate], bool]) -> list[Candidate]:
    """Return those that meet a condition, or all if none does."""
    return [each for each in found if condition(each)] or found


def _known(bag: Bag, topic: str, types: Iterable[str] = (IMAGE, COMPRESSED)) -> str:
    return did_you_mean(topic, [name for name, kind in bag.types.items() if kind in types])


def _content(bag: Bag, images: list[Candidate]) -> str:
    """Return the topics with their types, and of images the encoding."""
    encodings = {each.topic: f", {each.encoding}" for each in images}
    listed = [f"{name} ({kind}{encodings.get(name, '')})" for name, kind in sorted(bag.types.items())]
    return ", ".join(listed) or "no messages"


def _pixels(candidate: Candidate) -> str:
    return f"{candidate.size[1]} x {candidate.size[0]} pixels"


def _warn(text: str) -> None:
    warnings.warn(text, UserWarning, stacklevel=5)
