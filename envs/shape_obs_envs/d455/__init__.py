"""A model of the Intel RealSense D455 that degrades clean RGB-D images, and a wrapper that applies it to an env."""

from shape_obs_envs.d455.model import D455Model
from shape_obs_envs.d455.noise import D455Camera, D455Noise
from shape_obs_envs.d455.sensors import Cause, Light, Measurement

__all__ = ["Cause", "D455Camera", "D455Model", "D455Noise", "Light", "Measurement"]
