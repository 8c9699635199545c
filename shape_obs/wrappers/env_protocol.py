"""What an env may publish for ``ShapeObservation``, and how it is read. All of it is optional.

``camera_model``: a ``CameraModel`` (or bare ``Intrinsics``); read again at each reset, since poses may be randomised.
``anchors``: a mapping of names to base-frame points (x, y, z) or pixels (u, v); read at each frame.
``goal_layout``: how the points of a goal hang together, ``{"kind": "centerline"}``, ``{"kind": "contour"}`` or
``{"kind": "surface", "rows": 5, "cols": 7}``; without it, like the first shape's.
``shape_obs_defaults``: a mapping of wrapper arguments, used where the user gives none.
``action_spec``: an ``ActionSpec``, what actions mean; a policy's bundle keeps it, and holds it against the robot's.
``dt``: seconds per step, for frames without ``info["stamp"]``; else ``1 / metadata["render_fps"]``.
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
from shape_obs.configurations import Configuration
from shape_obs.spec import did_you_mean

GOALS = ("achieved_goal", "desired_goal")
_NOWHERE: Final = object()


def published(env: gym.Env[Any, Any], name: str, default: Any = None) -> Any:
    """An attribute of the env or of the outermost of its wrappers that has it.

    As ``get_wrapper_attr`` after ``has_wrapper_attr``, but asked for once: a property may have much to compute.
    """
    while True:
        value = getattr(env, name, _NOWHERE)
        if value is not _NOWHERE:
            return value
        if not isinstance(env, gym.Wrapper):
            return default
        env = env.env


def camera_model(env: gym.Env[Any, Any]) -> CameraModel | None:
    """The env's camera."""
    return as_camera_model(published(env, "camera_model"))


def anchors(env: gym.Env[Any, Any]) -> Mapping[str, Sequence[float]]:
    """The env's anchors as they are now."""
    return published(env, "anchors", {})


def defaults(env: gym.Env[Any, Any]) -> dict[str, Any]:
    """Arguments of the wrapper that suit the env."""
    first = next(iter(anchors(env)), None)
    return {"dt": seconds_per_step(env), "anchor": first, **published(env, "shape_obs_defaults", {})}


def goal_layout(env: gym.Env[Any, Any]) -> Mapping[str, Any]:
    """How the env's goals are laid out; empty where it does not say."""
    return published(env, "goal_layout", {})


def has_goals(space: spaces.Space[Any]) -> bool:
    """Whether an observation space is that of a goal-conditioned env."""
    return isinstance(space, spaces.Dict) and all(key in space.spaces for key in GOALS)


def base_point(shape: Configuration, named: Mapping[str, Sequence[float]]) -> tuple[float, float, float] | None:
    """A shape's anchor in the base frame; None when it has none there."""
    anchor = named.get(shape.anchor) if isinstance(shape.anchor, str) else shape.anchor
    return None if anchor is None or len(anchor) != 3 else (float(anchor[0]), float(anchor[1]), float(anchor[2]))


def seconds_per_step(env: gym.Env[Any, Any]) -> float:
    """The env's time step."""
    fps = env.metadata.get("render_fps") or 30
    return float(published(env, "dt") or 1 / fps)


@dataclass(frozen=True)
class Images:
    """Where the images are in an env's observation.

    Args:
        rgb_key: Key of the (H,W,3) uint8 image; None where the observation is the image.
        depth_key: Key of the (H,W) depth image; None without.
        size: (H, W).
    """

    rgb_key: str | None
    depth_key: str | None
    size: tuple[int, int]

    @classmethod
    def find(cls, space: spaces.Space[Any], rgb_key: str | None = None, depth_key: str | None = None) -> Images:
        """Look at an observation space; keys that are not given are ``"rgb"`` and, where there is one, ``"depth"``.

        Raises:
            ValueError: No image where one was expected; the message tells the keys there are.
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
        """(rgb, depth) of an observation."""
        if self.rgb_key is None:
            return observation, None
        for key in (self.rgb_key, self.depth_key):
            if key is not None and key not in observation:
                raise KeyError(f"the observation has no {key!r}, though its space has; it has: {sorted(observation)}.")
        return observation[self.rgb_key], observation[self.depth_key] if self.depth_key else None


def _image_size(space: spaces.Space[Any], where: str) -> tuple[int, int]:
    if not isinstance(space, spaces.Box) or space.dtype != np.uint8 or len(space.shape) != 3 or space.shape[2] != 3:
        raise ValueError(
            f"{where} must be an RGB image, Box(0, 255, (H, W, 3), uint8), got {space}. For state observations add "
            "images first, e.g. with gymnasium.wrappers.AddRenderObservation."
        )
    return space.shape[0], space.shape[1]
