"""ShapeGoal: goals in the feature space of a ``ShapeObservation``, from given targets or from the env."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, Literal

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.utils import RecordConstructorArgs

from shape_obs.configurations.base import Configuration
from shape_obs.features import Feature, FeatureContext, read_features
from shape_obs.shape import Shape
from shape_obs.spec import did_you_mean
from shape_obs.utils.lengths import warn_unless_metres
from shape_obs.wrappers.env_protocol import has_goals
from shape_obs.wrappers.goals import STATUS, GoalVector, find_shapes
from shape_obs.wrappers.observation_layout import ObservationLayout, main_part
from shape_obs.wrappers.recorded_arguments import to_recorded
from shape_obs.wrappers.target import GoalFrame, Target, observing, record_goals

GoalLike = Target | Mapping[str, Any] | npt.ArrayLike
RewardType = Literal["dense", "sparse"]

_REWARDS: Final = ("dense", "sparse")
_CENTIMETRE: Final = 0.01


class ShapeGoal(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Make an env goal-conditioned: the features of one or several detected shapes are to become those of targets.

    The observation is a Dict of ``observation`` (the vector of ``ShapeObservation`` and the vectors it keeps),
    ``achieved_goal`` and ``desired_goal``, flat finite float32. Both goals come from the same feature code, applied to
    the detected shapes and to the targets as the camera would see them. The reward is computed from them alone, so
    hindsight replay can substitute other goals; the env's own reward is in ``info["truth/reward"]``.

    ``info`` gains ``goal/distance`` and ``is_success``: all shapes with a goal are ok and the distance is below the
    threshold. The env's own ``is_success``, which may come from the simulator's state, moves to ``truth/is_success``.

    Args:
        env: An env that contains a ``ShapeObservation``.
        goal: A ``Target``, its mapping, or points ``(K, 3)`` in metres, base frame; for several shapes a mapping from
            their names to these, or points ``(S, K, 3)``. With None a goal-conditioned env provides the goal of each
            episode; for other envs each reset needs ``options={"goal": ...}``.
        features: The features of goals: features, or kinds of those of the ``ShapeObservation``. Default: all that
            describe the position of the shape, that is all except ``ok``, ``age`` and ``valid``.
        shape: The name of the shape that has the goal, the name of a shape with a ``count`` for all of its slots, or
            several names. Default: the shapes that a mapping ``goal`` names; without ``goal`` all that have goals of
            the env; else the first.
        reward_type: ``"dense"``: minus the distance. ``"sparse"``: 0 below the threshold, else -1.
        threshold: Distance below which a goal is reached, in ``unit``; default 0.01 m, and required in other units.

    Attributes:
        unit: The unit of distances: ``"m"``, ``"px"``, ``"of half the image"`` or ``"of the range"``.
        names: The names of the shapes that have a goal, in the order of their values.
        targets: The goals of this episode, a shape for each name; empty before the first reset.

    Raises:
        ValueError: There is no ``ShapeObservation``, the goal, the shapes or the features do not fit it, or the
            threshold is missing.

    Example:
        >>> env = ShapeGoal(ShapeObservation(gym.make("shape_obs_envs:ShapeObs/Cable-v0")))  # doctest: +SKIP
        >>> env.reset(options={"goal": points})  # doctest: +SKIP
    """

    unit: str
    names: tuple[str, ...]
    targets: tuple[Shape, ...]

    def __init__(
        self,
        env: gym.Env[Any, Any],
        goal: GoalLike | Mapping[str, GoalLike] | None = None,
        features: Iterable[Feature | Mapping[str, Any] | str] | None = None,
        *,
        shape: str | Sequence[str] | None = None,
        reward_type: RewardType = "dense",
        threshold: float | None = None,
    ) -> None:
        self._source = observing(env)
        known = self._source.detector.shapes
        if shape is None and isinstance(goal, Mapping) and _is_by_name(goal, [spec.name for spec in known]):
            shape = list(goal)
        self._at = self._find(shape, goal is not None)
        self._specs = [known[at] for at in self._at]
        self.names = tuple(spec.name for spec in self._specs)
        self._goal = None if goal is None else _read_targets(goal, self.names)
        (record,) = self._goal.values() if self._goal and len(self._goal) == 1 else (self._goal,)
        given = {"goal": record, "features": features, "shape": shape, "threshold": threshold}
        recorded = {name: to_recorded(value) for name, value in given.items() if value is not None}
        RecordConstructorArgs.__init__(self, **recorded, reward_type=reward_type)
        gym.Wrapper.__init__(self, env)

        if reward_type not in _REWARDS:
            raise ValueError(f"reward_type: unknown value {reward_type!r}{did_you_mean(reward_type, _REWARDS)}")
        self.reward_type = reward_type
        chosen = _chosen(self._source.features, recorded.get("features"))
        self._vector = GoalVector(chosen, self._specs, self.goal_contexts[0])
        self.unit = self._vector.unit
        self.threshold = _checked(threshold, self.unit)
        self._envs_goals = has_goals(self._source.observation_space)
        if self._goal is not None:
            self._as_seen(self._goal)
        elif self._envs_goals and max(self._at) >= self._source.goal_count:
            own = [spec.name for spec in known[: self._source.goal_count]]
            whose, without = own[0] if len(own) == 1 else own, self.names[0] if len(self.names) == 1 else self.names
            raise ValueError(f"the env's goals are those of shape {whose!r}: pass a goal= for shape {without!r}.")
        self._main, box, kept = main_part(env.observation_space, "observation" if self._envs_goals else "shape")
        self._layout = ObservationLayout(env.observation_space, kept, box, self._vector)
        self.observation_space = self._layout.space
        self.targets = ()
        self._given: tuple[Shape, ...] | None = None

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
        goal = self._goal if given is None else _read_targets(given, self.names)
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
        of one kind, the distance is the mean distance of corresponding points, ``mean_i |a_i - d_i|``, over the points
        of all shapes that have a goal; else it is the root mean square of the differences divided by their range,
        ``sqrt(mean_j ((a_j - d_j) / (high_j - low_j))^2)``. ``info`` is not used.

        Raises:
            ValueError: The goals have another size.
        """
        return self._reward(self._vector.distance(achieved_goal, desired_goal))

    def record_goal(self, frame: GoalFrame | None = None, *, unmeasured: bool = False) -> Target:
        """Return the shape in the last observation as a goal, the first of several; see ``shape_obs.record_goal``."""
        return self.record_goals(frame, unmeasured=unmeasured)[self.names[0]]

    def record_goals(self, frame: GoalFrame | None = None, *, unmeasured: bool = False) -> dict[str, Target]:
        """Return all shapes that have a goal, as seen in the last observation; see ``shape_obs.record_goals``."""
        return record_goals(self, self.names, frame, unmeasured=unmeasured)

    @property
    def target(self) -> Shape | None:
        """The first of ``targets``; None before the first reset."""
        return self.targets[0] if self.targets else None

    @property
    def goal_features(self) -> tuple[Feature, ...]:
        """The features of the goal of a shape, in the order of their values."""
        return self._vector.features

    @property
    def goal_configurations(self) -> tuple[Configuration, ...]:
        """The configurations of the shapes that have a goal."""
        return tuple(self._specs)

    @property
    def goal_contexts(self) -> list[FeatureContext]:
        """The context, with camera and anchors, of the current values of each goal."""
        contexts = self._source.contexts
        return [contexts[at] for at in self._at]

    @property
    def goal_configuration(self) -> Configuration:
        """The first of ``goal_configurations``."""
        return self._specs[0]

    @property
    def goal_context(self) -> FeatureContext:
        """The first of ``goal_contexts``."""
        return self.goal_contexts[0]

    @property
    def goal_measured(self) -> npt.NDArray[np.bool_]:
        """Which values of the current ``achieved_goal`` were measured and not filled in, of shape ``(D,)``."""
        return self._vector.measured(self.goal_shapes)

    @property
    def goal_shapes(self) -> tuple[Shape, ...]:
        """The shapes that have a goal, as detected in the last observation; empty before the first."""
        detection = self._source.detection
        return () if detection is None else tuple(detection.shapes[at] for at in self._at)

    @property
    def goal_shape(self) -> Shape | None:
        """The first of ``goal_shapes``; None before the first observation."""
        return self.goal_shapes[0] if self.goal_shapes else None

    def _find(self, shape: str | Sequence[str] | None, is_given: bool) -> tuple[int, ...]:
        """Return the indices of the shapes that have a goal."""
        if shape is not None:
            return find_shapes(self._source.detector.config, shape)
        return tuple(range(1 if is_given else max(self._source.goal_count, 1)))

    def _reward(self, distance: npt.NDArray[np.float64]) -> Any:
        reward = -distance if self.reward_type == "dense" else np.where(distance < self.threshold, 0.0, -1.0)
        return float(reward) if reward.ndim == 0 else reward

    def _as_seen(self, goal: Mapping[str, Target]) -> tuple[Shape, ...]:
        """Return the goals as the shapes that the camera at its current pose would see."""
        pairs = zip(self._specs, self.goal_contexts, strict=True)
        targets = tuple(goal[spec.name].shape_for(spec, context) for spec, context in pairs)
        needing = [feature.kind for feature in self._vector.features if feature.needs_depth]
        if needing and any(target.points3d is None for target in targets):
            raise ValueError(
                f"goal: its points are pixels, but {needing[0]!r} needs metres; give points in metres, or use "
                "features=['points2d']."
            )
        return targets

    def _observe(self, observation: Any, info: dict[str, Any]) -> tuple[Any, npt.NDArray[np.float64]]:
        """Return the observation and its distance from the goal."""
        own, shapes = self._source.targets, self.goal_shapes
        self.targets = tuple(own[at] for at in self._at) if self._given is None else self._given
        goals = self._vector.pair(shapes, self.targets, self.goal_contexts)
        distance = self._vector.distance(*goals)
        if "is_success" in info:
            info["truth/is_success"] = info["is_success"]
        info["goal/distance"] = float(distance)
        info["is_success"] = bool(distance < self.threshold) and all(shape.ok for shape in shapes)
        values = observation if self._main is None else observation[self._main]
        return self._layout.compose(values, observation, goals), distance


def _is_by_name(goal: Any, names: Sequence[str]) -> bool:
    """Return whether a goal is a mapping from names of shapes to their goals, and not that of one target."""
    return isinstance(goal, Mapping) and "points" not in goal and any(name in names for name in goal)


def _read_targets(goal: Any, names: Sequence[str]) -> dict[str, Target]:
    """Return the target of each shape.

    Args:
        goal: For one shape all that ``Target.read`` takes. For any number a mapping from each name to that, for several
            also a sequence with as many of these as names, such as points ``(S, K, 3)``.
        names: The names of the shapes.

    Raises:
        ValueError: The goal is none of these, or has not one target for each name.
    """
    if _is_by_name(goal, names):
        if set(goal) != set(names):
            raise ValueError(f"goal: expected a target for each of the shapes {list(names)}, got {list(goal)}.")
        return {name: Target.read(goal[name]) for name in names}
    if len(names) == 1:
        return {names[0]: Target.read(goal)}
    given: list[Any] = [goal] if isinstance(goal, (Target, Mapping)) or not isinstance(goal, Iterable) else list(goal)
    if len(given) != len(names):
        raise ValueError(
            f"goal: expected goals of {len(names)} shapes, a mapping {{{names[0]!r}: points, ...}} of {list(names)} or "
            f"points ({len(names)}, K, 3) in metres, got {len(given)}."
        )
    return {name: Target.read(each) for name, each in zip(names, given, strict=True)}


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
    if unit == "m":
        warn_unless_metres("threshold", value, most=1.0, stacklevel=4)
    return float(value)
