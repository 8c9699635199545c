"""Sources of RGB-D frames: cameras, recordings, folders, videos and environments, all with one interface.

The classes are imported on first use, so a camera library is loaded only when a camera is opened.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import gymnasium as gym

from shape_obs.extrinsics import Extrinsics
from shape_obs.source import BadRecording, CameraNotFound, RGBDSource, SourceError
from shape_obs.spec import did_you_mean

if TYPE_CHECKING:
    from shape_obs_envs.sources.env import EnvSource as EnvSource
    from shape_obs_envs.sources.photo import PhotoSource as PhotoSource
    from shape_obs_envs.sources.realsense import RealSenseSource as RealSenseSource
    from shape_obs_envs.sources.realsense import SoftwareD455 as SoftwareD455
    from shape_obs_envs.sources.sequence import FolderSource as FolderSource
    from shape_obs_envs.sources.video import VideoSource as VideoSource

_HOME: Final = {
    "EnvSource": "env",
    "FolderSource": "sequence",
    "PhotoSource": "photo",
    "RealSenseSource": "realsense",
    "SoftwareD455": "realsense",
    "VideoSource": "video",
}
__all__ = sorted([*_HOME, "open_source"])  # pyright: ignore[reportUnsupportedDunderAll]

#: Suffixes of librealsense's recordings.
RECORDINGS: Final = (".db3", ".bag")
_ENV_ID: Final = re.compile(r"(?:[\w.]+:)?(?:[\w.-]+/)?[\w.-]+-v\d+")
_CAMERA: Final = re.compile(r"d455(?::(?P<serial>[\w-]+))?", re.IGNORECASE)
_OWN_IDS: Final = "ShapeObs/"


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it has: {', '.join(__all__)}.")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]


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
        text: ``d455`` or ``d455:SERIAL`` for a camera, a ``.db3`` or ``.bag`` file that librealsense recorded, a folder
            (of photos, or written by ``shape-obs record``), a video file, or the id of an environment
            (``ShapeObs/Cable-v0``, ``their_module:TheirEnv-v1``).
        extrinsics: Pose of the camera in the base frame, or a file that contains it.
        width: Width of the camera's images in pixels; cameras only.
        height: Height of the camera's images in pixels; cameras only.
        fps: Frames per second; cameras only.
        options: Further arguments of the source's class: ``exposure=`` of ``RealSenseSource``, ``actions=``, ``seed=``
            and arguments of ``gymnasium.make`` for ``EnvSource``.

    Raises:
        BadRecording: The path does not exist, or the file has an unsupported type.
        CameraNotFound: The string is not a camera, path or environment.
        SourceError: The environment is not registered.
        ValueError: The source does not take one of the options.
        ImportError: A required extra is not installed; the message names it.
    """
    from shape_obs_envs.sources.env import EnvSource
    from shape_obs_envs.sources.sequence import PHOTOS, FolderSource
    from shape_obs_envs.sources.video import VIDEOS, VideoSource

    word, path = str(text), Path(text)
    mode = {name: value for name, value in (("width", width), ("height", height), ("fps", fps)) if value is not None}
    camera, suffix = _CAMERA.fullmatch(word), path.suffix.lower()
    if camera and not path.exists():
        return _realsense(extrinsics, {"serial": camera["serial"], **mode, **options})
    if suffix in RECORDINGS and not path.is_dir():
        if not path.exists():
            raise BadRecording(f"{path}: no such file.")
        return _realsense(extrinsics, {"recording": path, **mode, **options})
    if mode:
        raise ValueError(
            f"{word}: {', '.join(mode)} are settings of a camera; this source has its own size and frame rate."
        )
    if path.is_dir():
        return _make(FolderSource, path, extrinsics, options)
    if suffix in VIDEOS:
        if not path.exists():
            raise BadRecording(f"{path}: no such file.")
        return _make(VideoSource, path, extrinsics, options)
    if path.exists():
        hint = "; for photos give the folder that contains them" if suffix in PHOTOS else ""
        raise BadRecording(f"{path}: expected {', '.join((*RECORDINGS, *VIDEOS))} or a folder, got {suffix!r}{hint}.")
    if _ENV_ID.fullmatch(word):
        return _make(EnvSource, _registered_id(word), extrinsics, options)
    if "/" in word or "\\" in word or suffix:
        raise BadRecording(f"{path}: no such file or folder.")
    words = ["d455", "FILE.db3", "FILE.bag", "FOLDER", "VIDEO.mp4", *_own_ids()]
    raise CameraNotFound(f"source {word!r} is not a camera, path or environment{did_you_mean(word, words)}")


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


def _realsense(extrinsics: Any, options: Mapping[str, Any]) -> RGBDSource:
    from shape_obs_envs.sources.realsense import RealSenseSource

    return RealSenseSource(extrinsics=extrinsics, **options)


def _make(kind: type[Any], what: Any, extrinsics: Any, options: Mapping[str, Any]) -> RGBDSource:
    try:
        return kind(what, extrinsics, **options)
    except TypeError as error:
        raise ValueError(f"{what}: a {kind.__name__} does not take {sorted(options)}: {error}") from error
