"""A source of frames from any Gymnasium environment with image observations."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import singledispatch
from pathlib import Path
from typing import Any, Literal

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import load_env_creator

from shape_obs.camera import CameraModel
from shape_obs.extrinsics import Extrinsics
from shape_obs.frame import Frame
from shape_obs.recording import RobotInfo, Transition
from shape_obs.recording.format import plain
from shape_obs.source import BadSettings, SourceError
from shape_obs.utils.errors import hint_at_argument
from shape_obs.wrappers import env_protocol
from shape_obs.wrappers.env_images import Images, Key
from shape_obs_envs.arguments import count
from shape_obs_envs.sources.sequence import SequenceSource

Actions = Literal["zero", "random"] | Callable[[Any], Any]


class EnvSource(SequenceSource):
    """Frames of an environment: the first follows its reset, each further one takes a step.

    After the last frame of an episode the next frame is the start of a new episode, also if a wrapper resets the
    environment. Stamps are ``info["stamp"]`` if the environment provides it, otherwise the time of its steps (see
    ``EnvClock``), which continues over resets; the camera is its ``camera_model``.

    Args:
        env: An id, such as ``"shape_obs_envs:ShapeObs/Cable-v0"``, made by ``connect`` and closed by ``disconnect``; or
            an environment, which the caller closes.
        extrinsics: See ``Source``; overrides the environment's own.
        actions: ``"zero"`` for the action nearest to zero, ``"random"``, or a policy: observation -> action.
        seed: Seed of the first reset and of random actions.
        rgb_key: Key of the image in the observation, as ``ShapeObservation`` takes it; default ``"rgb"``.
        depth_key: Key of the depth image, in uint16 millimetres or floating-point metres; default ``"depth"`` if any.
        **options: Arguments of ``gymnasium.make``, for an id.

    Attributes:
        transition: The step that led to the last frame: its action, reward and end; None before the first frame.
        state: ``(S,)`` vectors of the last observation, such as poses of grippers; None if it has none.

    Raises:
        SourceError: By ``connect``: the environment cannot be made, or its observation has no image.
        BadSettings: By ``connect``: the environment does not take one of the options.
        ValueError: ``actions`` or ``seed`` is invalid, or options were given with an existing environment.

    Example:
        >>> with EnvSource("shape_obs_envs:ShapeObs/Cable-v0", actions="random", seed=0) as source:  # doctest: +SKIP
        ...     frame = source.read()
    """

    transition: Transition | None
    state: tuple[float, ...] | None
    kind: str = "env"

    def __init__(
        self,
        env: str | gym.Env[Any, Any],
        extrinsics: Extrinsics | str | Path | None = None,
        *,
        actions: Actions = "zero",
        seed: int | None = None,
        rgb_key: Key | None = None,
        depth_key: Key | None = None,
        **options: Any,
    ) -> None:
        super().__init__(env if isinstance(env, str) else str(env.spec.id if env.spec else env), extrinsics)
        if actions not in ("zero", "random") and not callable(actions):
            raise ValueError(f"actions: expected 'zero', 'random' or a function, got {actions!r}.")
        if seed is not None:
            seed = count("seed", seed, 0)
        if options and not isinstance(env, str):
            raise ValueError(f"{self.name} is an existing environment and does not take {sorted(options)}.")
        self._given, self._options, self._keys = env, options, (rgb_key, depth_key)
        self._actions, self._seed = actions, seed
        self._env: gym.Env[Any, Any] | None = None
        self._episode = 0
        self.transition = None
        self.state = None

    @property
    def has_depth(self) -> bool:
        """Whether observations include depth."""
        self._check_connected()
        return self._images.has_depth

    @property
    def anchors(self) -> Mapping[str, Sequence[float]]:
        """Where the object is held: name -> base-frame point (x, y, z) in metres, or pixel (u, v)."""
        return {name: tuple(point) for name, point in env_protocol.anchors(self._connected_env()).items()}

    @property
    def robot_info(self) -> RobotInfo:
        """Names of the values of actions and states."""
        self._check_connected()
        return self._steps.info

    @property
    def episode(self) -> int:
        """Number of the episode, starting at 0."""
        return self._episode

    def connect(self) -> None:
        """Make the environment if an id was given; the first ``read`` resets it."""
        if self._connected:
            return
        env = self._make()
        try:
            self._images = Images.find(env.observation_space, *self._keys)
        except ValueError as error:
            if env is not self._given:
                env.close()
            raise SourceError(f"{self.name}: {error}") from error
        if self._seed is not None:
            env.action_space.seed(self._seed)
        self._env, self._connected = env, True
        self._steps, self.transition, self.state = EnvSteps(env, self.name), None, None
        self._clock = env_protocol.EnvClock(env)
        self._number, self._episode, self._over = 0, -1, True
        self._observation: Any = None

    def disconnect(self) -> None:
        """Close the environment if an id was given."""
        if self._env is not None and self._env is not self._given:
            self._env.close()
        self._env = None
        super().disconnect()

    def _next(self) -> Frame:
        env = self._connected_env()
        if self._over:
            self._episode += 1
            try:
                self._observation, info = env.reset(seed=self._seed if self._episode == 0 else None)
            except (gym.error.Error, RuntimeError) as error:
                raise SourceError(f"{self.name}: the environment cannot be reset: {error}") from error
            self._over, self.transition = False, Transition(0)
            self._clock.now += self._clock.dt if self._episode else 0.0
        else:
            action = self._action(env)
            self._observation, reward, terminated, truncated, info = self._clock.step(action)
            self._over = bool(terminated or truncated) and not self._clock.was_reset
            last = 0 if self.transition is None else self.transition.step
            self.transition = Transition(
                last + 1, self._steps.action(action), float(reward), bool(terminated), bool(truncated)
            )
            if self._clock.was_reset:
                self._episode, self.transition = self._episode + 1, Transition(0)
        self.state = self._steps.state(self._observation)
        try:
            rgb, depth = self._images.read(self._observation)
        except (KeyError, TypeError, ValueError) as error:
            raise SourceError(f"{self.name}: {error.args[0]}") from error
        frame = Frame(
            np.array(rgb),  # environments may reuse their buffers
            None if depth is None else np.array(depth),
            self.camera,
            stamp=self._clock.stamp(info),
            received=time.monotonic(),
            number=self._number,
        )
        self._number += 1
        return frame

    def _known_camera(self) -> CameraModel | None:
        return env_protocol.camera_model(self._connected_env(), self._images.size)

    def _action(self, env: gym.Env[Any, Any]) -> Any:
        if callable(self._actions):
            return self._actions(self._observation)
        return env.action_space.sample() if self._actions == "random" else zero_action(env.action_space)

    def _make(self) -> gym.Env[Any, Any]:
        if not isinstance(self._given, str):
            return self._given
        try:
            return gym.make(self._given, **self._options)
        except Exception as error:  # environments raise anything about their arguments
            kind = SourceError if not self._options or isinstance(error, (ImportError, RuntimeError)) else BadSettings
            cause = error.__cause__ or error  # Gymnasium's own message repeats all arguments
            name = "" if isinstance(cause, (ValueError, TypeError, gym.error.Error)) else f"{type(cause).__name__}: "
            hint = hint_at_argument(cause, EnvSource, class_of(self._given))
            raise kind(f"{self._given}: the environment cannot be made: {name}{cause}{hint}") from error

    def _connected_env(self) -> gym.Env[Any, Any]:
        self._check_connected()
        assert self._env is not None
        return self._env


def class_of(env_id: str) -> Any:
    """Return the class or function that makes an environment; None if there is none."""
    try:
        entry = gym.spec(env_id).entry_point
        return load_env_creator(entry) if isinstance(entry, str) else entry
    except (gym.error.Error, ImportError, AttributeError):
        return None


@singledispatch
def zero_action(space: spaces.Space[Any]) -> Any:
    """Return zeros, clipped to the space, or the first of discrete actions.

    Raises:
        ValueError: The type of space is not supported.
    """
    raise ValueError(f"no zero action is defined for {space}: give actions='random', or a function as actions=.")


@zero_action.register
def _(space: spaces.Box) -> Any:
    return np.clip(np.zeros(space.shape, space.dtype), space.low, space.high)


@zero_action.register
def _(space: spaces.Discrete) -> Any:
    return space.start


@zero_action.register
def _(space: spaces.MultiDiscrete) -> Any:
    return np.array(space.start)


@zero_action.register
def _(space: spaces.MultiBinary) -> Any:
    return np.zeros(space.shape, space.dtype)


@zero_action.register
def _(space: spaces.Dict) -> Any:
    return {key: zero_action(part) for key, part in space.spaces.items()}


@zero_action.register
def _(space: spaces.Tuple) -> Any:
    return tuple(zero_action(part) for part in space.spaces)


class EnvSteps:
    """Flatten the actions and states of an environment.

    The state consists of the vectors of a Dict observation, such as the poses of grippers or joint angles, in the order
    of the keys. Images and goals are left out: achieved goals hold the true shape, which no robot knows.

    Args:
        env: The environment.
        name: Name of the environment.

    Attributes:
        info: Names of the values. Actions have the names of the environment's ``action_spec`` if it publishes one,
            and so has the entry ``robot`` of an observation.
    """

    def __init__(self, env: gym.Env[Any, Any], name: str) -> None:
        self._space, seen = env.action_space, env.observation_space
        entries = seen.spaces.items() if isinstance(seen, spaces.Dict) else ()
        vectors = {key: space for key, space in entries if isinstance(space, spaces.Box) and len(space.shape) < 2}
        self._keys = {key: spaces.flatdim(box) for key, box in vectors.items() if key not in env_protocol.GOALS}
        spec = env_protocol.published(env, "action_spec")
        if spec is None:
            spec = getattr(env_protocol.published(env, "robot"), "action_spec", None)
        size = 1 if isinstance(self._space, spaces.Discrete) else spaces.flatdim(self._space)
        self.info = RobotInfo(
            name,
            spec.names if spec is not None and len(spec) == size else _names("action", size),
            tuple(
                label
                for key, count in self._keys.items()
                for label in (
                    spec.names if key == "robot" and spec is not None and len(spec) == count else _names(key, count)
                )
            ),
            spec,
        )

    def action(self, action: Any) -> tuple[float, ...]:
        """Return an action as numbers ``(A,)``; that of a discrete space is its index."""
        if isinstance(self._space, spaces.Discrete):
            return (float(action),)
        return plain(np.asarray(spaces.flatten(self._space, action)).ravel())

    def state(self, observation: Any) -> tuple[float, ...] | None:
        """Return the state ``(S,)`` in an observation; None if it has no vectors."""
        if not self._keys:
            return None
        return plain(np.concatenate([np.ravel(observation[key]) for key in self._keys]))


def _names(key: str, count: int) -> tuple[str, ...]:
    return (key,) if count == 1 else tuple(f"{key}/{i}" for i in range(count))
