"""Attributes that an env may publish for ``ShapeObservation``. All of them are optional.

``camera_model``: a ``CameraModel`` (or bare ``Intrinsics``); read again at each reset, since poses may be randomised.
``anchors``: a mapping of names to base-frame points (x, y, z) or pixels (u, v); read in each frame.
``goal_layout``: the layout of the points of a goal, ``{"kind": "centerline"}``, ``{"kind": "contour"}`` or
``{"kind": "surface", "rows": 5, "cols": 7}``; default: the layout of the first shape.
``shape_obs_defaults``: a mapping of wrapper arguments, used unless the user passes others.
``action_spec``: an ``ActionSpec``, the meaning of actions; a saved policy contains it and compares it with the robot's.
``dt``: seconds per step, for frames without ``info["stamp"]``; default: ``1 / metadata["render_fps"]``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from shape_obs.camera import CameraModel, as_camera_model
from shape_obs.configurations.base import Configuration
from shape_obs.spec import did_you_mean

GOALS = ("achieved_goal", "desired_goal")
_MISSING: Final = object()


def published(env: gym.Env[Any, Any], name: str, default: Any = None) -> Any:
    """Return an attribute of the env or of the outermost wrapper that has it.

    Equal to ``get_wrapper_attr`` after ``has_wrapper_attr``, but reads the attribute once: a property may be slow.
    """
    while True:
        value = getattr(env, name, _MISSING)
        if value is not _MISSING:
            return value
        if not isinstance(env, gym.Wrapper):
            return default
        env = env.env


def publisher(env: gym.Env[Any, Any], name: str) -> gym.Env[Any, Any] | None:
    """Return the env or the outermost wrapper that has an attribute; None if none has it."""
    while not hasattr(env, name):
        if not isinstance(env, gym.Wrapper):
            return None
        env = env.env
    return env


def camera_model(env: gym.Env[Any, Any]) -> CameraModel | None:
    """Return the camera that the env publishes."""
    return as_camera_model(published(env, "camera_model"))


def anchors(env: gym.Env[Any, Any]) -> Mapping[str, Sequence[float]]:
    """Return the current anchors of the env by name."""
    return published(env, "anchors", {})


def defaults(env: gym.Env[Any, Any]) -> dict[str, Any]:
    """Return the wrapper arguments that the env suggests."""
    first = next(iter(anchors(env)), None)
    return {"dt": seconds_per_step(env), "anchor": first, **published(env, "shape_obs_defaults", {})}


def goal_layout(env: gym.Env[Any, Any]) -> Mapping[str, Any]:
    """Return the layout of the env's goals; empty if the env does not publish it."""
    return published(env, "goal_layout", {})


def has_goals(space: spaces.Space[Any]) -> bool:
    """Return whether an observation space is that of a goal-conditioned env."""
    return isinstance(space, spaces.Dict) and all(key in space.spaces for key in GOALS)


def base_point(shape: Configuration, named: Mapping[str, Sequence[float]]) -> tuple[float, float, float] | None:
    """Return the anchor of a shape as a point in the base frame; None if it has none there."""
    anchor = named.get(shape.anchor) if isinstance(shape.anchor, str) else shape.anchor
    return None if anchor is None or len(anchor) != 3 else (float(anchor[0]), float(anchor[1]), float(anchor[2]))


def seconds_per_step(env: gym.Env[Any, Any]) -> float:
    """Return the time step of the env."""
    fps = env.metadata.get("render_fps") or 30
    return float(published(env, "dt") or 1 / fps)


@dataclass(frozen=True)
class Images:
    """The images in an env's observation.

    Args:
        rgb_key: Key of the uint8 image of shape ``(H, W, 3)``; None if the observation is the image.
        depth_key: Key of the depth image of shape ``(H, W)``; None without depth.
        size: ``(H, W)`` of the images.
    """

    rgb_key: str | None
    depth_key: str | None
    size: tuple[int, int]

    @classmethod
    def find(cls, space: spaces.Space[Any], rgb_key: str | None = None, depth_key: str | None = None) -> Images:
        """Find the images in an observation space; the default keys are ``"rgb"`` and, if it exists, ``"depth"``.

        Raises:
            ValueError: There is no image under a key; the message lists the keys.
        """
        if isinstance(space, spaces.Dict):
            rgb_key = rgb_key or "rgb"
            for name, key in (("rgb_key", rgb_key), ("depth_key", depth_key)):
                if key is not None and key not in space.spaces:
                    raise ValueError(
                        f"{name} {key!r} is not in the observation{did_you_mean(key, space.spaces)} "
                        "Pass rgb_key= and depth_key=."
                    )
            depth = depth_key or ("depth" if "depth" in space.spaces else None)
            return cls(rgb_key, depth, _image_size(space[rgb_key], f"observation[{rgb_key!r}]"))
        return cls(None, None, _image_size(space, "the observation"))

    def read(self, observation: Any) -> tuple[npt.NDArray[np.uint8], npt.NDArray[Any] | None]:
        """Return the colour image and the depth image of an observation."""
        if self.rgb_key is None:
            return observation, None
        for key in (self.rgb_key, self.depth_key):
            if key is not None and key not in observation:
                raise KeyError(f"the observation has no {key!r}, but its space does; keys: {sorted(observation)}.")
        return observation[self.rgb_key], observation[self.depth_key] if self.depth_key else None


def _image_size(space: spaces.Space[Any], where: str) -> tuple[int, int]:
    if not isinstance(space, spaces.Box) or space.dtype != np.uint8 or len(space.shape) != 3 or space.shape[2] != 3:
        raise ValueError(
            f"{where} must be an RGB image, Box(0, 255, (H, W, 3), uint8), got {space}. For state observations add "
            "images first, e.g. with gymnasium.wrappers.AddRenderObservation."
        )
    return space.shape[0], space.shape[1]
