"""Sources of RGB-D frames: cameras, recordings, folders, videos and environments, all read in one way.

Names are loaded on first use: a camera's library is imported only by those who open a camera.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from shape_obs_envs.sources.env import EnvSource as EnvSource
    from shape_obs_envs.sources.folder import FolderSource as FolderSource
    from shape_obs_envs.sources.opening import open_source as open_source
    from shape_obs_envs.sources.realsense import RealSenseSource as RealSenseSource
    from shape_obs_envs.sources.realsense import SoftwareD455 as SoftwareD455
    from shape_obs_envs.sources.video import VideoSource as VideoSource

_HOME = {
    "EnvSource": "env",
    "FolderSource": "folder",
    "RealSenseSource": "realsense",
    "SoftwareD455": "realsense",
    "VideoSource": "video",
    "open_source": "opening",
}

__all__ = sorted(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it has: {', '.join(__all__)}.")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
