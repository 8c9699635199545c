"""A model of the Intel RealSense D455: what it makes of a clean RGB-D image, and a wrapper that puts it over an env."""

from shape_obs_envs.d455.camera import D455Camera
from shape_obs_envs.d455.colour import Light
from shape_obs_envs.d455.depth import Cause, Measurement
from shape_obs_envs.d455.model import D455Model
from shape_obs_envs.d455.noise import D455Noise

__all__ = ["Cause", "D455Camera", "D455Model", "D455Noise", "Light", "Measurement"]
