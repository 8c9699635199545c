"""Sources of frames: cameras, recordings, folders, videos and environments, all with one interface.

The classes are imported on first use, so a camera library is loaded only when a camera is opened.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from shape_obs_envs.sources.opening import open_source as open_source

if TYPE_CHECKING:
    from shape_obs_envs.sources.env import EnvSource as EnvSource
    from shape_obs_envs.sources.live import LiveSource as LiveSource
    from shape_obs_envs.sources.photo import PhotoSource as PhotoSource
    from shape_obs_envs.sources.realsense import RealSenseSource as RealSenseSource
    from shape_obs_envs.sources.realsense import SoftwareD455 as SoftwareD455
    from shape_obs_envs.sources.rosbag import RosbagSource as RosbagSource
    from shape_obs_envs.sources.sequence import FolderSource as FolderSource
    from shape_obs_envs.sources.video import VideoSource as VideoSource
    from shape_obs_envs.sources.webcam import WebcamSource as WebcamSource

_HOME: Final = {
    "EnvSource": "env",
    "FolderSource": "sequence",
    "LiveSource": "live",
    "PhotoSource": "photo",
    "RealSenseSource": "realsense",
    "RosbagSource": "rosbag",
    "SoftwareD455": "realsense",
    "VideoSource": "video",
    "WebcamSource": "webcam",
}
__all__ = sorted([*_HOME, "open_source"])  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it has: {', '.join(__all__)}.")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
