"""A bag of ROS 2 messages: its topics, and its messages in order, with one error for all damage."""

from __future__ import annotations

import sqlite3
import struct
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from shape_obs.source import BadRecording
from shape_obs.utils.errors import install_hint

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


class Bag:
    """An open bag.

    Args:
        path: An ``.mcap`` file, or a folder with a ``metadata.yaml``.

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
        with self.explained("it cannot be opened as a ROS 2 bag"):
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
