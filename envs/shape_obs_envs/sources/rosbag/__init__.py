"""A source of frames from ROS 2 bags: MCAP files and rosbag2 folders, read with ``rosbags``."""

from __future__ import annotations

from shape_obs_envs.sources.rosbag.source import RosbagSource as RosbagSource
