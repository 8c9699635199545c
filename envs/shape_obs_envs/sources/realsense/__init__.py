"""Cameras of the RealSense D400 series, above all the D455, and their recordings. Loaded without librealsense."""

from shape_obs_envs.sources.realsense.software import SoftwareD455
from shape_obs_envs.sources.realsense.source import RealSenseSource

__all__ = ["RealSenseSource", "SoftwareD455"]
