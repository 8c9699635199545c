"""Cameras of the RealSense D400 series, mainly the D455, and recordings; librealsense is imported on first use."""

from shape_obs_envs.sources.realsense.software import SoftwareD455
from shape_obs_envs.sources.realsense.source import RealSenseSource

__all__ = ["RealSenseSource", "SoftwareD455"]
