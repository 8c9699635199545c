"""Open a source from a string: a camera, a file, a folder, a class or an environment."""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any, Final

import gymnasium as gym

from shape_obs.extrinsics import Extrinsics
from shape_obs.source import BadRecording, CameraNotFound, RGBDSource, SourceError, check_source
from shape_obs.spec import did_you_mean
from shape_obs.utils.documents import make_named
from shape_obs.utils.errors import hint_at_argument

#: Suffixes of librealsense's recordings.
RECORDINGS: Final = (".db3", ".bag")
#: Suffix of a single file of ROS messages; a rosbag2 is a folder.
MCAP: Final = ".mcap"
#: The file that makes a folder a rosbag2.
ROSBAG2: Final = "metadata.yaml"
#: The topic in which librealsense stores the version of its recordings.
_VERSION: Final = "/file_version"
_ENV_ID: Final = re.compile(r"(?:[\w.]+:)?(?:[\w.-]+/)?[\w.-]+-v\d+")
_REALSENSE: Final = re.compile(r"(?P<model>d4\d\d)(?::(?P<serial>[\w-]+))?", re.IGNORECASE)
_WEBCAM: Final = re.compile(r"webcam(?::(?P<device>.+))?")
_CLASS: Final = re.compile(r"[^\W\d]\w*(?:\.[^\W\d]\w*)*:[^\W\d]\w*")
_OWN_IDS: Final = "ShapeObs/"
#: What the error for an unknown word lists, with the ids of our environments.
_FORMS: Final = (
    "d400", "d405", "d415", "d435", "d455", "d455:SERIAL", "webcam:0", "FILE.db3", "FILE.bag", "FILE.mcap", "FOLDER",
    "VIDEO.mp4", "module:Class",
)  # fmt: skip


def open_source(
    text: str | Path,
    *,
    extrinsics: Extrinsics | str | Path | None = None,
    width: int | None = None,
    height: int | None = None,
    fps: int | None = None,
    **options: Any,
) -> RGBDSource:
    """Make a source from a string; ``connect`` opens it.

    Args:
        text: A camera: ``d455``, ``d435``, ``d405``, ... or ``d400`` for any RealSense camera of that series, with
            several of them ``d455:SERIAL``; ``webcam:0``, ``webcam:/dev/video2`` or ``webcam:rtsp://...`` for what
            OpenCV opens. A recording: a ``.db3`` or ``.bag`` file of librealsense or ROS, an ``.mcap`` file or a
            rosbag2 folder, a folder (of photos, or written by ``shape-obs record``), a video file. A class of your own,
            ``module:Class``, whose objects are an ``RGBDSource``. The id of an environment (``ShapeObs/Cable-v0``,
            ``their_module:TheirEnv-v1``).
        extrinsics: Pose of the camera in the base frame, or a file that contains it.
        width: Width of the camera's images in pixels; cameras and ``module:Class`` only.
        height: Height of the camera's images in pixels; cameras and ``module:Class`` only.
        fps: Frames per second; cameras and ``module:Class`` only.
        options: Further arguments of the source's class: ``exposure=`` of ``RealSenseSource``, ``color=`` of
            ``RosbagSource``, ``actions=``, ``seed=`` and arguments of ``gymnasium.make`` for ``EnvSource``.

    Raises:
        BadRecording: The path does not exist, or the file has an unsupported type.
        CameraNotFound: The string is not a camera, path, class or environment.
        SourceError: The environment is not registered.
        TypeError: The objects of ``module:Class`` are no sources; the message lists what they lack.
        ValueError: The source does not take one of the options.
        ImportError: A module cannot be imported, or a required extra is not installed; the message names it.
    """
    word, path = str(text), Path(text)
    mode = {name: value for name, value in (("width", width), ("height", height), ("fps", fps)) if value is not None}
    if not path.exists():
        if camera := _REALSENSE.fullmatch(word):
            return _realsense(word, extrinsics, {**mode, **options}, model=camera["model"], serial=camera["serial"])
        if webcam := _WEBCAM.fullmatch(word):
            from shape_obs_envs.sources.webcam import WebcamSource

            return _make(WebcamSource, webcam["device"] or "0", extrinsics, {**mode, **options}, word)
        if _CLASS.fullmatch(word):
            return _of_class(word, extrinsics, {**mode, **options})
    if path.suffix.lower() in RECORDINGS and path.is_file():
        if path.with_name(ROSBAG2).is_file():
            raise BadRecording(f"{path} is part of a rosbag2: give its folder, {path.absolute().parent}.")
        if _is_of_ros(path):
            from shape_obs_envs.sources.rosbag import RosbagSource

            return _make(RosbagSource, path, extrinsics, {**mode, **options})
        return _realsense(word, extrinsics, {**mode, **options}, recording=path)
    if mode:
        raise ValueError(
            f"{word}: {', '.join(mode)} are settings of a camera; this source has its own size and frame rate."
        )
    return _recording(word, path, extrinsics, options)


def _is_of_ros(path: Path) -> bool:
    """Return whether ROS recorded a .db3 or .bag file, and not librealsense, which stores its own version."""
    try:
        if path.suffix.lower() == ".db3":
            with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as database:
                topics = {name for (name,) in database.execute("SELECT name FROM topics")}
        else:
            from rosbags.rosbag1 import Reader

            with Reader(path) as reader:
                topics = set(reader.topics)
    except Exception:  # noqa: BLE001 - not installed, or a damaged file, whose reader explains what is wrong
        return False
    return bool(topics) and _VERSION not in topics


def takes_size(text: str) -> bool:
    """Return whether a string names a camera that can be asked for an image size."""
    webcam = _WEBCAM.fullmatch(text)
    return bool(_REALSENSE.fullmatch(text)) or (webcam is not None and "://" not in (webcam["device"] or ""))


def _recording(word: str, path: Path, extrinsics: Any, options: Mapping[str, Any]) -> RGBDSource:
    """Make a source of a file, a folder or an environment."""
    from shape_obs_envs.sources.env import EnvSource
    from shape_obs_envs.sources.sequence import PHOTOS, FolderSource
    from shape_obs_envs.sources.video import VIDEOS, VideoSource

    suffix = path.suffix.lower()
    if suffix in (MCAP, *RECORDINGS, *VIDEOS) and not path.exists():
        raise BadRecording(f"{path}: no such file.")
    if (suffix == MCAP and path.is_file()) or (path / ROSBAG2).is_file():
        from shape_obs_envs.sources.rosbag import RosbagSource

        return _make(RosbagSource, path, extrinsics, options)
    if path.is_dir():
        return _make(FolderSource, path, extrinsics, options)
    if suffix in VIDEOS:
        return _make(VideoSource, path, extrinsics, options)
    if path.exists():
        hint = "; for photos give the folder that contains them" if suffix in PHOTOS else ""
        expected = ", ".join((*RECORDINGS, MCAP, *VIDEOS))
        raise BadRecording(f"{path}: expected {expected} or a folder, got {suffix!r}{hint}.")
    if _ENV_ID.fullmatch(word):
        return _make(EnvSource, _registered_id(word), extrinsics, options)
    if "/" in word or "\\" in word or suffix:
        raise BadRecording(f"{path}: no such file or folder.")
    near = did_you_mean(word, [*_FORMS, *_own_ids()])
    raise CameraNotFound(f"source {word!r} is not a camera, path, class or environment{near}")


def _of_class(word: str, extrinsics: Any, options: Mapping[str, Any]) -> RGBDSource:
    """Make a source of a class of the user."""
    given = {} if extrinsics is None else {"extrinsics": extrinsics}
    source = make_named(word, f"source {word}", {**given, **options})
    check_source(source, f"source {word}")
    return source


def _registered_id(word: str) -> str:
    """Return an environment id that ``gymnasium.make`` accepts."""
    if ":" not in word and word not in gym.registry:
        if word.startswith(_OWN_IDS):
            import shape_obs_envs  # noqa: F401 - registers the ids
        if word not in gym.registry:
            raise SourceError(
                f"environment {word!r} is not registered; for an id of another package include its module, "
                f"module:{word}{did_you_mean(word, _own_ids())}"
            )
    return word


def _own_ids() -> list[str]:
    import shape_obs_envs  # noqa: F401 - registers the ids

    return [name for name in gym.registry if name.startswith(_OWN_IDS) and "Shape-v" not in name]


def _realsense(word: str, extrinsics: Any, options: Mapping[str, Any], **own: Any) -> RGBDSource:
    from shape_obs_envs.sources.realsense import RealSenseSource

    try:
        return RealSenseSource(extrinsics=extrinsics, **{**own, **options})
    except TypeError as error:
        hint = hint_at_argument(error, RealSenseSource)
        raise ValueError(f"{word}: a RealSenseSource does not take {sorted(options)}: {error}{hint}") from error


def _make(
    kind: type[Any], what: Any, extrinsics: Any, options: Mapping[str, Any], word: str | None = None
) -> RGBDSource:
    try:
        return kind(what, extrinsics, **options)
    except TypeError as error:
        hint = hint_at_argument(error, kind)
        raise ValueError(f"{word or what}: a {kind.__name__} does not take {sorted(options)}: {error}{hint}") from error
