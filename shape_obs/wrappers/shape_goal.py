"""ShapeGoal: goals in the feature space of a ``ShapeObservation``, from a given target or from the env."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, Literal

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs

from shape_obs.configurations.base import Configuration
from shape_obs.features import Feature, FeatureContext, read_features
from shape_obs.shape import Shape
from shape_obs.spec import did_you_mean
from shape_obs.wrappers.env_protocol import GOALS, has_goals
from shape_obs.wrappers.goals import STATUS, GoalVector
from shape_obs.wrappers.observation_layout import ObservationLayout
from shape_obs.wrappers.shape_observation import ShapeObservation, to_recorded
from shape_obs.wrappers.target import GoalFrame, Target

GoalLike = Target | Mapping[str, Any] | npt.ArrayLike
RewardType = Literal["dense", "sparse"]

_REWARDS: Final = ("dense", "sparse")
_CENTIMETRE: Final = 0.01


class ShapeGoal(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Make an env goal-conditioned: the features of the detected shape are to become those of a target.

    The observation is a Dict of ``observation`` (the vector of ``ShapeObservation`` and the vectors it keeps),
    ``achieved_goal`` and ``desired_goal``, flat finite float32. Both goals come from the same feature code, applied to
    the detected shape and to the target as the camera would see it. The reward is computed from them alone, so
    hindsight replay can substitute other goals; the env's own reward is in ``info["truth/reward"]``.

    ``info`` gains ``goal/distance`` and ``is_success``: the shape is ok and the distance below the threshold. The env's
    own ``is_success``, which may come from the simulator's state, moves to ``truth/is_success``.

    Args:
        env: An env that contains a ``ShapeObservation``.
        goal: A ``Target``, its mapping, or points ``(K, 3)`` in metres, base frame. With None a goal-conditioned env
            provides the goal of each episode; for other envs each reset needs ``options={"goal": ...}``.
        features: The features of goals: features, or kinds of those of the ``ShapeObservation``. Default: all that
            describe the position of the shape, that is all except ``ok``, ``age`` and ``valid``.
        shape: The name of the shape that has the goal; default the first.
        reward_type: ``"dense"``: minus the distance. ``"sparse"``: 0 below the threshold, else -1.
        threshold: Distance below which a goal is reached, in ``unit``; default 0.01 m, and required in other units.

    Attributes:
        unit: The unit of distances: ``"m"``, ``"px"``, ``"of half the image"`` or ``"of the range"``.
        target: The goal of this episode as a shape; None before the first reset.

    Raises:
        ValueError: There is no ``ShapeObservation``, the goal or the features do not fit it, or the threshold is
            missing.

    Example:
        >>> env = ShapeGoal(ShapeObservation(gym.make("shape_obs_envs:ShapeObs/Cable-v0")))  # doctest: +SKIP
        >>> env.reset(options={"goal": points})  # doctest: +SKIP
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        goal: GoalLike | None = None,
        features: Iterable[Feature | Mapping[str, Any] | str] | None = None,
        *,
        shape: str | None = None,
        reward_type: RewardType = "dense",
        threshold: float | None = None,
    ) -> None:
        self._goal = None if goal is None else Target.read(goal)
        given = {"goal": self._goal, "features": features, "shape": shape, "threshold": threshold}
        recorded = {name: to_recorded(value) for name, value in given.items() if value is not None}
        RecordConstructorArgs.__init__(self, **recorded, reward_type=reward_type)
        gym.Wrapper.__init__(self, env)

        self._source = _observing(env)
        self._at = _index(self._source, shape)
        self._spec = self._source.detector.shapes[self._at]
        if reward_type not in _REWARDS:
            raise ValueError(f"reward_type: unknown value {reward_type!r}{did_you_mean(reward_type, _REWARDS)}")
        self.reward_type = reward_type
        chosen = _chosen(self._source.features, recorded.get("features"))
        self._vector = GoalVector(chosen, self._spec, self.goal_context)
        self.unit = self._vector.unit
        self.threshold = _checked(threshold, self.unit)
        self._envs_goals = has_goals(self._source.observation_space)
        if self._goal is not None:
            self._as_seen(self._goal)
        elif self._envs_goals and self._at:
            first = self._source.detector.shapes[0].name
            raise ValueError(f"the env's goals are those of shape {first!r}: pass a goal= for shape {shape!r}.")
        self._main, box, kept = _parts(env.observation_space, "observation" if self._envs_goals else "shape")
        self._layout = ObservationLayout(env.observation_space, kept, box, self._vector)
        self.observation_space = self._layout.space
        self.target: Shape | None = None
        self._given: Shape | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the env.

        Args:
            seed: Passed on to the env.
            options: ``"goal"`` is the goal of this episode, as the wrapper's argument; the others are passed on.

        Raises:
            ValueError: There is no goal, or it does not fit.
        """
        options = None if options is None else dict(options)
        given = None if options is None else options.pop("goal", None)
        goal = self._goal if given is None else Target.read(given)
        if goal is None and not self._envs_goals:
            raise ValueError(
                "ShapeGoal: there is no goal, and the env provides none. Pass goal=Target(points) to the wrapper or "
                'options={"goal": points} to reset; shape_obs.record_goal(env) records the current shape as a goal.'
            )
        observation, info = self.env.reset(seed=seed, options=options)
        self._given = None if goal is None else self._as_seen(goal)
        return self._observe(observation, info)[0], info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the env; the reward is ``compute_reward`` of the achieved and the desired goal."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        info.setdefault("truth/reward", reward)
        seen, distance = self._observe(observation, info)
        return seen, self._reward(distance), terminated, truncated, info

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """Return the reward for goals ``(..., D)`` of this wrapper: a float for single goals, else an array ``(...,)``.

        The dense reward is minus the distance; the sparse reward is 0 below the threshold, else -1. If goals are points
        of one kind, the distance is the mean distance of corresponding points, ``mean_i |a_i - d_i|``; else it is the
        root mean square of the differences divided by their range, ``sqrt(mean_j ((a_j - d_j) / (high_j - low_j))^2)``.
        ``info`` is not used.

        Raises:
            ValueError: The goals have another size.
        """
        return self._reward(self._vector.distance(achieved_goal, desired_goal))

    def record_goal(self, frame: GoalFrame | None = None, *, unmeasured: bool = False) -> Target:
        """Return the shape in the last observation as a goal; see ``shape_obs.record_goal``."""
        return record_goal(self, self._spec.name, frame, unmeasured=unmeasured)

    @property
    def goal_features(self) -> tuple[Feature, ...]:
        """The features of goals, in the order of their values."""
        return self._vector.features

    @property
    def goal_configuration(self) -> Configuration:
        """The configuration of the shape that has the goal."""
        return self._spec

    @property
    def goal_context(self) -> FeatureContext:
        """The context, with camera and anchors, of the current goal's values."""
        return self._source.contexts[self._at]

    @property
    def goal_measured(self) -> npt.NDArray[np.bool_]:
        """Which values of the current ``achieved_goal`` were measured and not filled in, of shape ``(D,)``."""
        assert self.goal_shape is not None
        return self._vector.measured(self.goal_shape)

    @property
    def goal_shape(self) -> Shape | None:
        """The shape that has the goal, as detected in the last observation; None before the first."""
        return None if self._source.detection is None else self._source.detection.shapes[self._at]

    def _reward(self, distance: npt.NDArray[np.float64]) -> Any:
        reward = -distance if self.reward_type == "dense" else np.where(distance < self.threshold, 0.0, -1.0)
        return float(reward) if reward.ndim == 0 else reward

    def _as_seen(self, goal: Target) -> Shape:
        """Return the goal as the shape that the camera at its current pose would see."""
        target = goal.shape_for(self._spec, self.goal_context)
        needing = [feature.kind for feature in self._vector.features if feature.needs_depth]
        if needing and target.points3d is None:
            raise ValueError(
                f"goal: its points are pixels, but {needing[0]!r} needs metres; give points in metres, or use "
                "features=['points2d']."
            )
        return target

    def _observe(self, observation: Any, info: dict[str, Any]) -> tuple[Any, npt.NDArray[np.float64]]:
        """Return the observation and its distance from the goal."""
        detection = self._source.detection
        target = self._source.target if self._given is None else self._given
        assert detection is not None
        assert target is not None
        self.target, shape = target, detection.shapes[self._at]
        goals = self._vector.pair(shape, target, self.goal_context)
        distance = self._vector.distance(*goals)
        if "is_success" in info:
            info["truth/is_success"] = info["is_success"]
        info["goal/distance"] = float(distance)
        info["is_success"] = bool(distance < self.threshold) and shape.ok
        values = observation if self._main is None else observation[self._main]
        return self._layout.compose(values, observation, goals), distance


def record_goal(
    env: gym.Env[Any, Any], shape: str | None = None, frame: GoalFrame | None = None, *, unmeasured: bool = False
) -> Target:
    """Return the shape in the last observation as a goal for ``ShapeGoal``, with the same points index for index.

    Args:
        env: An env that contains a ``ShapeObservation``, after ``reset``.
        shape: The name of the shape; default the first.
        frame: ``"base"``, ``"camera"`` or ``"pixels"``; default the first of these that is available.
        unmeasured: Also record points that were hidden or had no depth, at their estimated positions.

    Raises:
        ValueError: There is no observation yet, the shape or some of its points were not found, or the frame is not
            available.

    Example:
        >>> record_goal(env).to_dict()  # doctest: +SKIP
    """
    source = _observing(env)
    at = _index(source, shape)
    if source.detection is None:
        raise ValueError("record_goal: nothing has been seen yet; call reset first.")
    spec, context = source.detector.shapes[at], source.contexts[at]
    return Target.of(source.detection.shapes[at], spec, context, frame, unmeasured=unmeasured)


def _observing(env: gym.Env[Any, Any]) -> ShapeObservation:
    """Return the outermost ``ShapeObservation`` in an env."""
    inner: Any = env
    while not isinstance(inner, ShapeObservation):
        if not isinstance(inner, gym.Wrapper):
            raise ValueError(f"expected an env with a ShapeObservation inside, got {env}: wrap it in ShapeObservation.")
        inner = inner.env
    return inner


def _index(source: ShapeObservation, shape: str | None) -> int:
    """Return the index of the shape with a name; 0 without a name."""
    names = [spec.name for spec in source.detector.shapes]
    if shape is not None and shape not in names:
        raise ValueError(f"no shape named {shape!r}{did_you_mean(shape, names)}")
    return 0 if shape is None else names.index(shape)


def _chosen(known: Sequence[Feature], asked: Any) -> list[Feature]:
    """Return the features of goals: the given ones, or all known ones that describe the position of a shape."""
    features = [feature for feature in known if not isinstance(feature, STATUS)]
    if asked is not None:
        given: list[Any] = [asked] if isinstance(asked, (str, Mapping)) else asked
        named = {item: [feature for feature in features if feature.kind == item] for item in given if type(item) is str}
        features = [feature for item in given for feature in named.get(str(item)) or read_features(item)]
    status = [feature.kind for feature in features if isinstance(feature, STATUS)]
    if status or not features:
        got = f"got {status[0]!r}" if status else f"the observation has {[feature.kind for feature in known]}"
        raise ValueError(f"goals need features of the shape's position, such as 'points3d', {got}; pass features=.")
    return features


def _checked(threshold: float | None, unit: str) -> float:
    if threshold is None and unit != "m":
        raise ValueError(f"threshold: goals in these features have distances in the unit '{unit}'; pass threshold=.")
    value = _CENTIMETRE if threshold is None else threshold
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < float("inf"):
        raise ValueError(f"threshold: expected a distance above 0, got {value!r}; the default is 0.01 m.")
    return float(value)


def _parts(space: spaces.Space[Any], main: str) -> tuple[str | None, spaces.Box, list[str]]:
    """Return the key of the vector of ``ShapeObservation`` (None without keys), its box, and the other keys."""
    keys = list(space.spaces) if isinstance(space, spaces.Dict) else None
    box = space[main] if isinstance(space, spaces.Dict) and main in space.spaces else space
    if not isinstance(box, spaces.Box):
        raise ValueError(f"ShapeGoal: expected a Box, or a Dict with a Box as {main!r}, got {space}.")
    if keys is None:
        return None, box, []
    return main, box, [key for key in keys if key not in (main, *GOALS)]
