"""Attributes that an env may publish for ``ShapeObservation``. All of them are optional.

``camera_model``: a ``CameraModel``, or what ``as_camera_model`` makes one of; read again at each reset, since poses may
be randomised.
``anchors``: a mapping of names to base-frame points (x, y, z) or pixels (u, v); read in each frame that needs one.
``goal_layout``: the layout of the points of a goal, ``{"kind": "centerline"}``, ``{"kind": "contour"}`` or
``{"kind": "surface", "rows": 5, "cols": 7}``; default: the layout of the first shape. With ``"count": K`` a goal has
those of the first K shapes, such as the slots of one configuration, equally many points for each.
``shape_obs_defaults``: a mapping of wrapper arguments, used unless the user passes others.
``action_spec``: an ``ActionSpec``, the meaning of actions; a saved policy contains it and compares it with the robot's.
``dt``: seconds per step, for frames without ``info["stamp"]``; default: ``1 / metadata["render_fps"]``. Wrappers that
repeat a step are counted, see ``EnvClock``; one that publishes ``dt`` gives the duration of its steps.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Final, SupportsFloat

import gymnasium as gym
from gymnasium import spaces

from shape_obs.camera import CameraModel, as_camera_model
from shape_obs.configurations.base import Configuration

GOALS = ("achieved_goal", "desired_goal")
#: Wrappers that repeat each step, of Gymnasium and Stable-Baselines3, and the attribute that holds how often.
_REPEATS: Final = {
    "AtariPreprocessing": "frame_skip",
    "MaxAndSkipEnv": "_skip",
    "MaxAndSkipObservation": "_skip",
    "RepeatAction": "num_repeats",
}
_USUAL_RATE: Final = 30.0  # steps a second of an env that publishes none
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
    return {"anchor": first, **published(env, "shape_obs_defaults", {}), "dt": seconds_per_step(env)}


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
    """Return the duration of a step, as far as it is known before one was taken."""
    timed, dt = _timed(env)
    repeats = 1
    while env is not timed and isinstance(env, gym.Wrapper):
        repeats *= getattr(env, _REPEATS.get(type(env).__name__, ""), 1)
        env = env.env
    return repeats * (dt or 1 / _USUAL_RATE)


def _timed(env: gym.Env[Any, Any]) -> tuple[gym.Env[Any, Any], float | None]:
    """Return the env or wrapper whose steps have a known duration, and this duration in seconds; None if unknown."""
    fps = env.metadata.get("render_fps")
    while True:
        dt = getattr(env, "shape_obs_defaults", {}).get("dt") or getattr(env, "dt", None)
        if dt or not isinstance(env, gym.Wrapper):
            break
        env = env.env
    if dt:
        return env, _positive("dt", "seconds per step", dt)
    return env, 1 / _positive("metadata['render_fps']", "frames per second", fps) if fps else None


def _positive(name: str, what: str, value: Any) -> float:
    """Return a published number; text is refused, which is likelier a mistake than a number."""
    if isinstance(value, str) or not isinstance(value, SupportsFloat) or not 0 < float(value) < math.inf:
        raise ValueError(f"the env publishes {name}={value!r}: expected {what}, a number above 0.")
    return float(value)


class EnvClock:
    """Take the steps of an env and measure their time, also if its wrappers change what a step is.

    A wrapper may repeat a step (``RepeatAction``, a user's frame skip) or reset the env within one (``Autoreset``): the
    calls that reach the env are counted, and its ``dt`` passes with each of its steps.

    Args:
        env: The env.
        dt: Seconds of a whole step, if they are not to be measured.

    Attributes:
        now: Seconds since the clock was made; a user may set it.
        dt: Seconds of a whole step: as given, else as far as was measured or is known before.
        was_reset: Whether the env was reset within the last step, so that its observation begins an episode.

    Warns:
        UserWarning: Once, if a stamp is asked for and nothing shows how long a step is.
    """

    def __init__(self, env: gym.Env[Any, Any], dt: float | None = None) -> None:
        self._env, self._given = env, dt
        self._timed, known = _timed(env)
        self._unknown = known is None and dt is None
        self._each = known or 1 / _USUAL_RATE
        self.now, self.dt, self.was_reset = 0.0, dt or seconds_per_step(env), False

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the env, and return what it returned."""
        calls: list[str] = []
        replaced = []
        for env, name in ((self._timed, "step"), (self._env.unwrapped, "reset")):
            replaced.append((env, name, vars(env).get(name)))
            setattr(env, name, partial(_noted, calls, name, getattr(env, name)))
        try:
            result = self._env.step(action)
        finally:
            for env, name, own in replaced:
                delattr(env, name) if own is None else setattr(env, name, own)
        seconds = self._given or (calls.count("step") or 1) * self._each
        self.dt, self.was_reset = max(self.dt, seconds), "reset" in calls  # the last step of an episode may be shorter
        self.now += seconds
        return result

    def stamp(self, info: Mapping[str, Any]) -> Any:
        """Return the stamp in ``info``, otherwise the time that was measured, in seconds."""
        stamp = info.get("stamp")
        if stamp is None and self._unknown and self.now:
            self._unknown = False
            warnings.warn(
                f"{self._env.unwrapped}: it is unknown how long a step is, so 1/30 s is taken: publish dt (seconds), "
                "metadata['render_fps'] or info['stamp'], or give ShapeObservation dt=. This warning is shown once.",
                stacklevel=4,
            )
        return self.now if stamp is None else stamp


def _noted(calls: list[str], name: str, method: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Any:
    """Call a method of an env, and append its name to ``calls``."""
    calls.append(name)
    return method(*args, **kwargs)
