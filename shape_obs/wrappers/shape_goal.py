"""ShapeGoal: goals in the feature space of a ``ShapeObservation``, from a target of one's own or the env's."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, Literal

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs

from shape_obs.configurations import Configuration
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
    """Makes an env goal-conditioned in features: those of the seen shape are to become those of a target.

    The observation is a Dict of ``observation`` (the vector of ``ShapeObservation`` and the vectors it keeps),
    ``achieved_goal`` and ``desired_goal``, flat finite float32. Both goals come from the same feature code, applied to
    what the camera sees and to the target as the camera would see it. The reward is computed from them alone, so
    hindsight replay may put other goals in; the env's own reward stays in ``info["truth/reward"]``.

    ``info`` gains ``goal/distance`` and ``is_success``: the shape is ok and the distance below the threshold. An
    ``is_success`` of the env's own, which may come from the simulator's state, moves to ``truth/is_success``.

    Args:
        env: With a ``ShapeObservation`` inside.
        goal: A ``Target``, its mapping, or points (K,3), metres, base frame. None over a goal-conditioned env takes the
            env's goal in each episode; over any other env each reset needs ``options={"goal": ...}``.
        features: What goals are given in: features, or the kinds of those of the ``ShapeObservation``. Default all of
            those that tell where the shape is, which ``ok``, ``age`` and ``valid`` do not.
        shape: The name of the shape that has the goal; default the first.
        reward_type: ``"dense"``: minus the distance. ``"sparse"``: 0 below the threshold, else -1.
        threshold: Distance below which a goal is reached, in ``unit``; default 0.01 m. No default in other units.

    Attributes:
        unit: Of distances: ``"m"``, ``"px"``, ``"of half the image"`` or ``"of the range"``.
        target: The goal of this episode as a shape; None before the first reset.

    Raises:
        ValueError: No ``ShapeObservation``, a goal or features that do not fit it, or a threshold that is missing.

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
            seed: Passed on.
            options: ``"goal"``: as the wrapper's own argument, for this episode; all others are passed on.

        Raises:
            ValueError: There is no goal, or one that does not fit.
        """
        options = None if options is None else dict(options)
        given = None if options is None else options.pop("goal", None)
        goal = self._goal if given is None else Target.read(given)
        if goal is None and not self._envs_goals:
            raise ValueError(
                "ShapeGoal: there is no goal, and the env has none of its own. Pass goal=Target(points) to the wrapper "
                'or options={"goal": points} to reset; shape_obs.record_goal(env) makes a goal of what is seen now.'
            )
        observation, info = self.env.reset(seed=seed, options=options)
        self._given = None if goal is None else self._as_seen(goal)
        return self._observe(observation, info)[0], info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the env; the reward is ``compute_reward`` of what was achieved and what is desired."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        info.setdefault("truth/reward", reward)
        seen, distance = self._observe(observation, info)
        return seen, self._reward(distance), terminated, truncated, info

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """The reward of goals (..., D) as this wrapper gives them: a float for single ones, else (...,).

        Dense: minus the distance. Sparse: 0 where that is below the threshold, else -1. The distance is the mean
        distance of corresponding points, ``mean_i |a_i - d_i|``, where goals are points of one kind; else the root mean
        square of differences as shares of their range, ``sqrt(mean_j ((a_j - d_j) / (high_j - low_j))^2)``. ``info`` is
        not used.

        Raises:
            ValueError: Goals of another size.
        """
        return self._reward(self._vector.distance(achieved_goal, desired_goal))

    def record_goal(self, frame: GoalFrame | None = None, *, unmeasured: bool = False) -> Target:
        """What is seen of the shape now, as a goal; see ``shape_obs.record_goal``."""
        return record_goal(self, self._spec.name, frame, unmeasured=unmeasured)

    @property
    def goal_features(self) -> tuple[Feature, ...]:
        """What goals are given in, in the order of their numbers."""
        return self._vector.features

    @property
    def goal_configuration(self) -> Configuration:
        """What the shape that has the goal is found as."""
        return self._spec

    @property
    def goal_context(self) -> FeatureContext:
        """Camera and anchors by which the present goal's numbers were computed."""
        return self._source.contexts[self._at]

    @property
    def goal_measured(self) -> npt.NDArray[np.bool_]:
        """(D,) which numbers of the present ``achieved_goal`` were measured, not filled in."""
        assert self.goal_shape is not None
        return self._vector.measured(self.goal_shape)

    @property
    def goal_shape(self) -> Shape | None:
        """The shape that has the goal, as it was found in the present observation; None before the first."""
        return None if self._source.detection is None else self._source.detection.shapes[self._at]

    def _reward(self, distance: npt.NDArray[np.float64]) -> Any:
        reward = -distance if self.reward_type == "dense" else np.where(distance < self.threshold, 0.0, -1.0)
        return float(reward) if reward.ndim == 0 else reward

    def _as_seen(self, goal: Target) -> Shape:
        """The goal as the shape that the camera, where it is now, would see."""
        target = goal.shape_for(self._spec, self.goal_context)
        needing = [feature.kind for feature in self._vector.features if feature.needs_depth]
        if needing and target.points3d is None:
            raise ValueError(
                f"goal: its points are pixels, but {needing[0]!r} of it is wanted; give points in metres, or goals in "
                "features=['points2d']."
            )
        return target

    def _observe(self, observation: Any, info: dict[str, Any]) -> tuple[Any, npt.NDArray[np.float64]]:
        """The observation and its distance from the goal."""
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
    """What is seen of a shape now, as a goal for ``ShapeGoal``: index for index the points that were found.

    Args:
        env: With a ``ShapeObservation`` inside, after ``reset``.
        shape: Its name; default the first.
        frame: ``"base"``, ``"camera"`` or ``"pixels"``; default the first of these that can be had.
        unmeasured: Record points that were hidden or had no depth too, where they were taken to be.

    Raises:
        ValueError: Nothing was seen yet, the shape was not found, or not all of it, or the frame cannot be had.

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
    """The outermost ``ShapeObservation`` in an env."""
    inner: Any = env
    while not isinstance(inner, ShapeObservation):
        if not isinstance(inner, gym.Wrapper):
            raise ValueError(f"expected an env with a ShapeObservation inside, got {env}: wrap it in ShapeObservation.")
        inner = inner.env
    return inner


def _index(source: ShapeObservation, shape: str | None) -> int:
    """Which of the shapes has a name; the first without one."""
    names = [spec.name for spec in source.detector.shapes]
    if shape is not None and shape not in names:
        raise ValueError(f"no shape named {shape!r}{did_you_mean(shape, names)}")
    return 0 if shape is None else names.index(shape)


def _chosen(known: Sequence[Feature], asked: Any) -> list[Feature]:
    """The features that goals are given in: those asked for, as plain values, or all that tell where a shape is."""
    features = [feature for feature in known if not isinstance(feature, STATUS)]
    if asked is not None:
        given: list[Any] = [asked] if isinstance(asked, (str, Mapping)) else asked
        named = {item: [feature for feature in features if feature.kind == item] for item in given if type(item) is str}
        features = [feature for item in given for feature in named.get(str(item)) or read_features(item)]
    status = [feature.kind for feature in features if isinstance(feature, STATUS)]
    if status or not features:
        got = f"got {status[0]!r}" if status else f"the observation has {[feature.kind for feature in known]}"
        raise ValueError(
            f"goals need features that tell where the shape is, such as 'points3d', {got}; pass features=."
        )
    return features


def _checked(threshold: float | None, unit: str) -> float:
    if threshold is None and unit != "m":
        raise ValueError(f"threshold: goals in these features have distances in the unit '{unit}'; pass threshold=.")
    value = _CENTIMETRE if threshold is None else threshold
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < float("inf"):
        raise ValueError(f"threshold: expected a distance above 0, got {value!r}; the default is 0.01 m.")
    return float(value)


def _parts(space: spaces.Space[Any], main: str) -> tuple[str | None, spaces.Box, list[str]]:
    """Under which key the vector of ``ShapeObservation`` is (None: it is all), its box, and the other keys to keep."""
    keys = list(space.spaces) if isinstance(space, spaces.Dict) else None
    box = space[main] if isinstance(space, spaces.Dict) and main in space.spaces else space
    if not isinstance(box, spaces.Box):
        raise ValueError(f"ShapeGoal: expected a Box, or a Dict with a Box as {main!r}, got {space}.")
    if keys is None:
        return None, box, []
    return main, box, [key for key in keys if key not in (main, *GOALS)]
