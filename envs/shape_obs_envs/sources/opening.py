"""open_source: a source from a word."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import gymnasium as gym

from shape_obs.extrinsics import Extrinsics
from shape_obs.source import BadRecording, CameraNotFound, RGBDSource, SourceError
from shape_obs.spec import did_you_mean
from shape_obs_envs.sources.env import EnvSource
from shape_obs_envs.sources.folder import PHOTOS, FolderSource
from shape_obs_envs.sources.video import VIDEOS, VideoSource

#: Suffixes of librealsense's recordings.
RECORDINGS: Final = (".db3", ".bag")
GRAMMAR: Final = "d455[:serial] | FILE.db3 | FILE.bag | FOLDER | VIDEO FILE | ENV_ID"
_ENV_ID: Final = re.compile(r"(?:[\w.]+:)?(?:[\w.-]+/)?[\w.-]+-v\d+")
_CAMERA: Final = re.compile(r"d455(?::(?P<serial>[\w-]+))?", re.IGNORECASE)
_OURS: Final = "ShapeObs/"


def open_source(
    text: str | Path,
    *,
    extrinsics: Extrinsics | str | Path | None = None,
    width: int | None = None,
    height: int | None = None,
    fps: int | None = None,
    **options: Any,
) -> RGBDSource:
    """The source that a word names; it opens when it is connected.

    Args:
        text: ``d455`` or ``d455:SERIAL`` for a camera, a ``.db3`` or ``.bag`` file that librealsense recorded, a folder
            (of photos, or one that ``shape-obs record`` wrote), a video file, or the id of an environment
            (``ShapeObs/Cable-v0``, ``their_module:TheirEnv-v1``).
        extrinsics: Where the camera stands in the base frame, or the file that says so.
        width: Of the camera's images, pixels; cameras only.
        height: Of the camera's images, pixels; cameras only.
        fps: Of the camera, frames a second; cameras only.
        options: Further arguments of the source's class: ``exposure=`` of ``RealSenseSource``, ``actions=``, ``seed=``
            and those of ``gymnasium.make`` of ``EnvSource``.

    Raises:
        BadRecording: No such path, or a file of another kind.
        CameraNotFound: A word that is none of these.
        SourceError: An environment that nobody registered.
        ValueError: An option that this source does not have.
        ImportError: The extra that it needs is not installed; the message says which.
    """
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
        raise ValueError(f"{word}: {', '.join(mode)} are settings of a camera; this source has its own size and pace.")
    if path.is_dir():
        return _make(FolderSource, path, extrinsics, options)
    if suffix in VIDEOS:
        if not path.exists():
            raise BadRecording(f"{path}: no such file.")
        return _make(VideoSource, path, extrinsics, options)
    if path.exists():
        hint = "; for photos give the folder that they are in" if suffix in PHOTOS else ""
        raise BadRecording(f"{path}: expected {', '.join((*RECORDINGS, *VIDEOS))} or a folder, got {suffix!r}{hint}.")
    if _ENV_ID.fullmatch(word):
        return _make(EnvSource, _registered(word), extrinsics, options)
    if "/" in word or "\\" in word or suffix:
        raise BadRecording(f"{path}: no such file or folder.")
    raise CameraNotFound(f"source {word!r} is no camera, path or environment{did_you_mean(word, _words())}")


def _registered(word: str) -> str:
    """An environment's id as ``gymnasium.make`` takes it."""
    if ":" not in word and word not in gym.registry:
        if word.startswith(_OURS):
            import shape_obs_envs  # noqa: F401 - registers them
        if word not in gym.registry:
            raise SourceError(
                f"environment {word!r} is not registered; for another package's give its module too, "
                f"module:{word}{did_you_mean(word, _ids())}"
            )
    return word


def _ids() -> list[str]:
    import shape_obs_envs  # noqa: F401

    return [name for name in gym.registry if name.startswith(_OURS) and "Shape-v" not in name]


def _words() -> list[str]:
    return ["d455", "FILE.db3", "FILE.bag", "FOLDER", "VIDEO.mp4", *_ids()]


def _realsense(extrinsics: Any, options: Mapping[str, Any]) -> RGBDSource:
    from shape_obs_envs.sources.realsense import RealSenseSource

    return RealSenseSource(extrinsics=extrinsics, **options)


def _make(kind: type[Any], what: Any, extrinsics: Any, options: Mapping[str, Any]) -> RGBDSource:
    try:
        return kind(what, extrinsics, **options)
    except TypeError as error:
        raise ValueError(f"{what}: a {kind.__name__} does not take {sorted(options)}: {error}") from error
