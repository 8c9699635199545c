"""Write ROS 2 bags with the writer of ``rosbags``, for tests of the reader."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = STORE.types
COLOR = "/camera/camera/color/image_raw"
DEPTH = "/camera/camera/aligned_depth_to_color/image_raw"
INFO = "/camera/camera/color/camera_info"
FRAME = "camera_color_optical_frame"


def header(stamp: float, frame: str = FRAME) -> Any:
    """Return a header; a stamp of 0 stands for none."""
    nanoseconds = round(stamp * 1e9)
    time = TYPES["builtin_interfaces/msg/Time"](sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
    return TYPES["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def image(
    pixels: Any, encoding: str, stamp: float, frame: str = FRAME, *, padding: int = 0, big_endian: bool = False
) -> Any:
    """Return an ``Image`` of an array whose rows end with ``padding`` bytes."""
    stored = np.ascontiguousarray(pixels.astype(pixels.dtype.newbyteorder(">" if big_endian else "<")))
    rows = stored.view(np.uint8).reshape(len(pixels), -1)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=77)
    return TYPES["sensor_msgs/msg/Image"](
        header=header(stamp, frame),
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=int(big_endian),
        step=rows.shape[1],
        data=rows.reshape(-1),
    )


def compressed(data: bytes, kind: str, stamp: float, frame: str = FRAME) -> Any:
    """Return a ``CompressedImage``."""
    pixels = np.frombuffer(data, np.uint8)
    return TYPES["sensor_msgs/msg/CompressedImage"](header=header(stamp, frame), format=kind, data=pixels)


def camera_info(
    size: tuple[int, int], k: Any, d: Any = (), model: str = "plumb_bob", p: Any = None, frame: str = FRAME, **more: Any
) -> Any:
    """Return a ``CameraInfo`` of images ``(H, W)`` with ``k`` = (fx, fy, cx, cy)."""
    matrix = np.array([[k[0], 0, k[2]], [0, k[1], k[3]], [0, 0, 1]], np.float64)
    projection = np.hstack([matrix, np.zeros((3, 1))])
    if p is not None:
        projection[[0, 1, 0, 1], [0, 1, 2, 2]] = p
    return TYPES["sensor_msgs/msg/CameraInfo"](
        header=header(1.0, frame),
        height=size[0],
        width=size[1],
        distortion_model=model,
        d=np.array(d, np.float64),
        k=matrix.reshape(-1),
        r=np.eye(3).reshape(-1),
        p=projection.reshape(-1),
        binning_x=more.get("binning", 0),
        binning_y=0,
        roi=TYPES["sensor_msgs/msg/RegionOfInterest"](
            x_offset=more.get("x_offset", 0), y_offset=0, height=0, width=0, do_rectify=False
        ),
    )


def write_ros1_bag(path: Path, messages: list[tuple[str, float, Any]]) -> Path:
    """Write the same messages as ROS 1 does: the names of the matrices of a ``CameraInfo`` are capital letters."""
    from rosbags.rosbag1 import Writer as Ros1Writer

    store = get_typestore(Stores.ROS1_NOETIC)

    def of_ros1(message: Any) -> Any:
        if not hasattr(message, "__msgtype__") or message.__msgtype__ not in store.types:
            return message
        made: Any = store.types[message.__msgtype__]
        given = {name.lower(): of_ros1(value) for name, value in vars(message).items()}
        return made(**{name: given.get(name.lower(), 0) for name in made.__dataclass_fields__ if name != "__msgtype__"})

    with Ros1Writer(path) as writer:
        connections: dict[str, Any] = {}
        for topic, logged, message in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], round(logged * 1e9), store.serialize_ros1(of_ros1(message), kind))
    return path


def write_bag(path: Path, messages: list[tuple[str, float, Any]], storage: str = "mcap") -> Path:
    """Write (topic, time of recording in seconds, message) to a rosbag2 folder; return its ``.mcap`` or ``.db3``."""
    plugin = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}[storage]
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections: dict[str, Any] = {}
        for topic, logged, message in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], round(logged * 1e9), STORE.serialize_cdr(message, kind))
    (file,) = (each for each in path.iterdir() if each.suffix in (".mcap", ".db3"))
    return file


def rgbd_messages(frames: list[tuple[Any, Any]], k: Any, late: float = 0.02, begin: float = 1700.0) -> Any:
    """Return the messages of RGB-D frames at 30 Hz under RealSense's names; depth arrives ``late`` seconds later."""
    messages: list[tuple[str, float, Any]] = [(INFO, begin, camera_info(frames[0][0].shape[:2], k))]
    for number, (rgb, depth) in enumerate(frames):
        stamp = begin + number / 30
        messages.append((COLOR, stamp + 0.01, image(rgb, "rgb8", stamp)))
        encoding = "16UC1" if depth.dtype == np.uint16 else "32FC1"
        messages.append((DEPTH, stamp + 0.01 + late, image(depth, encoding, stamp + 0.004)))
    return sorted(messages, key=lambda each: each[1])
