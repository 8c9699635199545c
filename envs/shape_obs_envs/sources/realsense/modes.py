"""Modes: the sizes and frame rates that a camera has."""

from __future__ import annotations

from typing import Any

from shape_obs_envs.sources.realsense.driver import librealsense

Mode = tuple[int, int, int]  # width and height in pixels, frames per second


def shared_modes(device: Any) -> list[Mode]:
    """The modes that the colour and the depth stream of an ``rs.device`` have in common, smallest first."""
    rs = librealsense()
    modes: dict[Any, set[Mode]] = {rs.stream.color: set(), rs.stream.depth: set()}
    for sensor in device.query_sensors():
        for profile in sensor.get_stream_profiles():
            if profile.stream_type() in modes:
                video = profile.as_video_stream_profile()
                modes[profile.stream_type()].add((video.width(), video.height(), video.fps()))
    return sorted(set.intersection(*modes.values()))
