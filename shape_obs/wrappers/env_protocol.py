"""Attributes that an env may publish for ``ShapeObservation``. All of them are optional.

``camera_model``: a ``CameraModel``, or what ``as_camera_model`` makes one of; read again at each reset, since poses may
be randomised.
``anchors``: a mapping of names to base-frame points (x, y, z) or pixels (u, v); read in each frame that needs one.
``goal_layout``: the layout of the points of a goal, ``{"kind": "centerline"}``, ``{"kind": "contour"}`` or
``{"kind": "surface", "rows": 5, "cols": 7}``; default: the layout of the first shape. With ``"count": K`` a goal has
those of the first K shapes, such as the slots of one configuration, equally many points for each.
``shape_obs_defaults``: a mapping of wrapper arguments, used unless the user passes others.
``action_spec``: an ``ActionSpec``, the meaning of actions; a saved policy contains it and compares it with the robot's.
``dt``: seconds per step, for frames without ``info["stamp"]``; default: ``1 / metadata["render_fps"]``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import gymnasium as gym
from gymnasium import spaces

from shape_obs.camera import CameraModel, as_camera_model
from shape_obs.configurations.base import Configuration

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


class PublishedAnchors(Mapping[str, Sequence[float]]):
    """The anchors of an env as they are now, read whenever one is asked for: an env may compute them from its state."""

    def __init__(self, source: gym.Env[Any, Any] | None) -> None:
        self._source = source

    @property
    def _read(self) -> Mapping[str, Sequence[float]]:
        return getattr(self._source, "anchors", {})

    def __getitem__(self, name: str) -> Sequence[float]:
        return self._read[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._read)

    def __len__(self) -> int:
        return len(self._read)


def camera_model(env: gym.Env[Any, Any], size: tuple[int, int] | None = None) -> CameraModel | None:
    """Return the camera that the env publishes, whose images have a size ``(H, W)``."""
    return as_camera_model(published(env, "camera_model"), size)


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
    anchor: Any = named.get(shape.anchor) if isinstance(shape.anchor, str) else shape.anchor
    return None if anchor is None or len(anchor) != 3 else (float(anchor[0]), float(anchor[1]), float(anchor[2]))


def seconds_per_step(env: gym.Env[Any, Any]) -> float:
    """Return the time step of the env."""
    fps = env.metadata.get("render_fps") or 30
    return float(published(env, "dt") or 1 / fps)
