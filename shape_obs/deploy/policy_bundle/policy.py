"""Run a trained policy: in the environment of its training, in another one, or in the deployment loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from shape_obs.config.config_file import SCENE_FIELDS, SECTIONS
from shape_obs.configurations.base import Configuration
from shape_obs.deploy.policy_bundle import environment
from shape_obs.deploy.policy_bundle.documents import MALFORMED, BundleError
from shape_obs.deploy.policy_bundle.environment import obstacle, reading_wrappers
from shape_obs.deploy.policy_bundle.limits import check_wrapper
from shape_obs.deploy.policy_bundle.record import Difference, Record, Surroundings, differences, format_differences
from shape_obs.deploy.policy_bundle.spaces import Statistics, space_from_dict, zeros
from shape_obs.features import Feature, Points3D, read_features
from shape_obs.robot import ActionSpec
from shape_obs.utils.documents import load_named
from shape_obs.wrappers import ShapeGoal, ShapeObservation, env_protocol
from shape_obs.wrappers.env_protocol import GOALS

if TYPE_CHECKING:
    import gymnasium as gym
    from gymnasium.envs.registration import EnvSpec, WrapperSpec
    from stable_baselines3.common.policies import BasePolicy


class Bundle:
    """A trained policy with the description of its training; ``load_bundle`` returns it.

    Args:
        record: Description of the policy and of the environment of its training.
        spec: Spec of the environment.
        policy: Policy of Stable-Baselines3.
        statistics: Statistics that normalise observations; None if they are not normalised.
        trusted: Whether code that the file names may run.

    Attributes:
        record: As given.
        spec: As given; its entry points are followed only if the bundle is trusted.
        policy: As given. It has no optimizer, so it can act but not be trained further.
        statistics: As given.
        trusted: As given.
    """

    record: Record
    spec: EnvSpec
    policy: BasePolicy
    statistics: Statistics | None
    trusted: bool

    def __init__(
        self, record: Record, spec: EnvSpec, policy: BasePolicy, statistics: Statistics | None, *, trusted: bool = False
    ) -> None:
        self.record, self.spec, self.policy, self.statistics = record, spec, policy, statistics
        self.trusted = trusted

    def act(self, observation: Any) -> npt.NDArray[Any]:
        """Return the deterministic action for an observation, of shape ``(A,)``, usually in -1 ... 1."""
        normalized = observation if self.statistics is None else self.statistics.normalize(observation)
        return np.asarray(self.policy.predict(normalized, deterministic=True)[0])

    def check_action(self) -> None:
        """Refuse a policy that returns no valid action for an observation of zeros.

        Raises:
            BundleError: The action has another shape, or is not finite.
        """
        action = self.act(zeros(space_from_dict(self.record.observation_space, "the observation space")))
        shape = self.policy.action_space.shape
        if action.shape != shape or not np.isfinite(action).all():
            raise BundleError(f"the policy returns no finite action of shape {shape}: {action!r:.100}.")

    def make_env(self, **arguments: Any) -> gym.Env[Any, Any]:
        """Rebuild the environment of the training, without wrappers that only observe it, such as ``Monitor``.

        Args:
            arguments: Arguments of the environment that replace those of the training, such as
                ``render_mode="human"``.

        Raises:
            BundleError: The environment is not registered here, cannot be made, or needs the bundle to be trusted: it
                names code or files, has a wrapper that is in no closed list, or asks for too much.
            ImportError: A simulator is not installed.
        """
        return environment.rebuild(self.spec, trust=self.trusted, arguments=arguments)

    def wrap(
        self, env: gym.Env[Any, Any], goal: Any = None, scene: Mapping[str, Any] | None = None
    ) -> gym.Env[Any, Any]:
        """Wrap another environment, usually a camera and a robot, so that the policy can read its observations.

        Wrappers that are needed only in training are left out. If the environment of the training had its own goals,
        a ``ShapeGoal`` provides them here.

        Args:
            env: Environment with images and a camera, and without goals.
            goal: Goal, as for ``ShapeGoal``; None if the goal is given at each reset, or the policy has no goals.
            scene: Arguments of ``ShapeObservation`` that are specific to this site: ``segmentation``, ``roi``,
                ``workspace``, and the ``runtime`` section.

        Raises:
            BundleError: The policy cannot run with a camera, was given a goal but has no goals, or one of its wrappers
                needs the bundle to be trusted; the message gives the reason.
            ValueError: The environment or the scene do not fit.
        """
        self.check_deployable()
        self._check_place(env)
        config = dict(self.record.config or {})
        shape = {name: config[name] for name in SECTIONS["shape"] if name in config}
        running = {name: config[name] for name in SECTIONS["runtime"] if name in config and name != "dt"}
        published = env_protocol.published(env, "shape_obs_defaults", {})
        known = {name: published[name] for name in ("shapes", *SECTIONS["scene"]) if name in published}
        local = {"workspace": config.get("workspace"), **running, **known, **(scene or {})}
        source = ShapeObservation(env, **{**local, **_site_fields(shape, local)})
        wrapped: gym.Env[Any, Any] = source
        wrappers = reading_wrappers(self.spec)
        if goal is not None and not self.needs_goal:
            raise BundleError("the policy was trained without goals, so it cannot be given one.")
        if self.needs_goal and all(wrapper.name != ShapeGoal.__name__ for wrapper in wrappers):
            points = next((feature for feature in self.features if isinstance(feature, Points3D)), None)
            if points is None:
                raise BundleError("the policy has goals of points in metres, but it reads no feature 'points3d'.")
            space: Any = space_from_dict(self.record.observation_space, "the observation space")
            names = _first_shapes(source.detector.shapes, space["desired_goal"].shape[0])
            wrapped = ShapeGoal(
                wrapped, goal, [points], shape=names, reward_type="sparse", threshold=self.success_threshold
            )
        for wrapper in wrappers:
            kwargs = dict(wrapper.kwargs or {})
            if wrapper.name == ShapeGoal.__name__ and goal is not None:
                kwargs["goal"] = goal
            wrapped = self._wrapped(wrapped, wrapper, kwargs)
        return wrapped

    def check_env(self, env: gym.Env[Any, Any], *, same_rate: bool = True) -> None:
        """Refuse an environment whose observations or actions differ from those of the training.

        Colours, regions of interest, workspaces and the pose of the camera may differ.

        Args:
            env: Environment, wrapped by ``wrap``.
            same_rate: Whether a step must take as long as in training.

        Raises:
            BundleError: The environment differs. The message names each difference: features, number of points,
                configuration, units and frames, layout of the observation, meaning of actions, duration of a step.
        """
        found = self.differences(env, same_rate=same_rate)
        if found:
            raise BundleError(f"the policy does not fit this environment: {format_differences(found)}.")

    def differences(self, env: gym.Env[Any, Any], *, same_rate: bool = True) -> list[Difference]:
        """Return the differences that ``check_env`` refuses, as (place, trained, here)."""
        return differences(self.record, Surroundings.of(env), same_rate=same_rate)

    def check_deployable(self) -> None:
        """Refuse a policy that cannot run with a camera.

        Raises:
            BundleError: The policy reads values that only a simulator has, or was saved without ``action_spec``.
        """
        reason = obstacle(self.spec)
        if not reason and self.action_spec is None:
            reason = "it was saved without action_spec, the meaning of its actions: save it with action_spec="
        if reason:
            raise BundleError(f"the policy cannot be deployed: {reason}.")

    def controller(self, *, same_rate: bool = True) -> PolicyController:
        """Return the policy as a controller for ``shape_obs.deploy.deploy``.

        Args:
            same_rate: Whether to refuse a loop whose rate differs from that of the training.

        Raises:
            BundleError: The policy cannot run with a camera; the message gives the reason.
        """
        self.check_deployable()
        return PolicyController(self, same_rate=same_rate)

    @property
    def action_spec(self) -> ActionSpec | None:
        """Meaning of its actions; None if unknown."""
        return self.record.action_spec

    @property
    def features(self) -> list[Feature]:
        """Features of each shape, in the order of the observation; empty if the policy reads no shapes."""
        return read_features((self.record.config or {}).get("features", ()))

    @property
    def dt(self) -> float:
        """Duration of a step in training, in seconds."""
        return self.record.dt

    @property
    def needs_goal(self) -> bool:
        """Whether the policy needs a goal."""
        keys = self.record.observation_space.get("spaces", {})
        return all(key in keys for key in GOALS) or any(
            wrapper.name == ShapeGoal.__name__ for wrapper in self.spec.additional_wrappers
        )

    @property
    def has_goal(self) -> bool:
        """Whether the policy was trained for a single goal, which the bundle holds."""
        goals = [(wrapper.kwargs or {}).get("goal") for wrapper in self.spec.additional_wrappers]
        return any(goal is not None for goal in goals)

    @property
    def success_threshold(self) -> float:
        """Distance in metres below which a goal counts as reached."""
        return self.record.success_threshold or 0.01

    def _wrapped(self, env: gym.Env[Any, Any], wrapper: WrapperSpec, kwargs: Mapping[str, Any]) -> gym.Env[Any, Any]:
        if not self.trusted:
            wrapper = check_wrapper(wrapper)
        kind = load_named(wrapper.entry_point, f"wrapper {wrapper.name}")
        try:
            return kind(env, **kwargs)
        except MALFORMED as error:
            raise BundleError(f"the policy's wrapper {wrapper.name} does not fit this environment: {error}") from error

    def _check_place(self, env: gym.Env[Any, Any]) -> None:
        """Refuse features in the base frame if the camera has no extrinsics."""
        for feature in self.features:
            in_base = getattr(getattr(feature, "coordinates", None), "frame", None) == "base"
            camera = env_protocol.camera_model(env) if in_base else None
            if in_base and (camera is None or camera.transform_camera_to_base is None):
                raise BundleError(
                    f"the policy reads {feature.kind!r} in the base frame, but this camera has no extrinsics: give "
                    "--extrinsics FILE, as `shape-obs calibrate base` writes it."
                )


def _first_shapes(shapes: Sequence[Configuration], size: int) -> list[str]:
    """Return the names of as many shapes, from the first on, as have ``size`` coordinates together; at least one."""
    ends = np.cumsum([3 * shape.layout.size for shape in shapes]).tolist()
    return [shape.name for shape, end in zip(shapes, ends, strict=True) if end <= size] or [shapes[0].name]


def _site_fields(shape: Mapping[str, Any], scene: Mapping[str, Any]) -> dict[str, Any]:
    """Return the ``shape`` section with this site's segmentation and length of each shape, found by its name."""
    here = [item for item in scene.get("shapes") or () if isinstance(item, Mapping)]
    local = {item.get("name") or item.get("kind"): item for item in here}
    shapes = [
        {**item, **{name: local.get(item["name"], {}).get(name) for name in SCENE_FIELDS if name in item}}
        for item in shape["shapes"]
    ]
    return {**shape, "shapes": shapes}


class PolicyController:
    """Control a robot with a policy's deterministic actions.

    Args:
        bundle: The policy.
        same_rate: Whether to refuse a loop whose rate differs from that of the training.

    Attributes:
        same_rate: As given.
        action_spec: Meaning of its actions; ``shape_obs.deploy.deploy`` compares it with the robot's.
    """

    same_rate: bool
    action_spec: ActionSpec | None

    def __init__(self, bundle: Bundle, *, same_rate: bool = True) -> None:
        self._bundle, self.same_rate = bundle, same_rate
        self.action_spec = bundle.action_spec

    def attach(self, env: Any) -> None:
        """Compare the environment with that of the training.

        Raises:
            BundleError: They differ; the message names each difference.
        """
        self._bundle.check_env(env, same_rate=self.same_rate)
        self._bundle.act(zeros(env.observation_space))  # warm up: the first call is slower, and the loop has deadlines

    def bind(self, spec: ActionSpec) -> None:
        """Do nothing: the actions have the size of the training."""

    def reset(self) -> None:
        """Do nothing: the policy is not recurrent."""

    def act(self, observation: Any) -> npt.NDArray[Any]:
        """Return the action, of shape ``(A,)``, in -1 ... 1."""
        return self._bundle.act(observation)
