"""Bundle: a trained policy, ready to act, to be rebuilt, and to be held against where it is to run.

PolicyController: a trained policy as a controller of the deployment loop.
"""

from __future__ import annotations
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any
import numpy as np
import numpy.typing as npt
from shape_obs.config import SECTIONS
from shape_obs.deploy.policy_bundle import environment
from shape_obs.deploy.policy_bundle.environment import obstacle
from shape_obs.deploy.policy_bundle.environment import reading_wrappers
from shape_obs.deploy.policy_bundle.documents import MALFORMED
from shape_obs.deploy.policy_bundle.documents import BundleError
from shape_obs.deploy.policy_bundle.record import Difference
from shape_obs.deploy.policy_bundle.record import differences
from shape_obs.deploy.policy_bundle.record import told
from shape_obs.deploy.policy_bundle.record import Record, Surroundings
from shape_obs.deploy.policy_bundle.spaces import Statistics
from shape_obs.features import Feature, Points3D, read_features
from shape_obs.robot import ActionSpec
from shape_obs.utils.documents import load_named
from shape_obs.wrappers import ShapeGoal, ShapeObservation, env_protocol
from shape_obs.wrappers.env_protocol import GOALS
if TYPE_CHECKING:
    import gymnasium as gym
    from gymnasium.envs.registration import EnvSpec, WrapperSpec
    from stable_baselines3.common.policies import BasePolicy

    from shape_obs.deploy.policy_bundle.policy import PolicyController
from shape_obs.deploy.policy_bundle.spaces import zeros
if TYPE_CHECKING:
    from shape_obs.deploy.policy_bundle.policy import Bundle



class Bundle:
    """What ``load_bundle`` reads.

    Args:
        record: What the policy is, and what it was trained in.
        spec: Of the environment.
        policy: Of Stable-Baselines3.
        statistics: By which observations are normalised; None for not at all.
        trusted: Whether code that the file names may run.

    Attributes:
        record: As given.
        spec: As given; its entry points count only where the bundle is trusted.
        policy: As given; to act with, not to train on: it has no optimizer.
        statistics: As given.
        trusted: As given.
    """

    def __init__(
        self, record: Record, spec: EnvSpec, policy: BasePolicy, statistics: Statistics | None, *, trusted: bool = False
    ) -> None:
        self.record, self.spec, self.policy, self.statistics = record, spec, policy, statistics
        self.trusted = trusted

    def act(self, observation: Any) -> npt.NDArray[Any]:
        """Return the action for an observation of the environment, without exploring: (A,) in -1 ... 1 as a rule."""
        seen = observation if self.statistics is None else self.statistics.normalize(observation)
        return np.asarray(self.policy.predict(seen, deterministic=True)[0])

    def make_env(self, **arguments: Any) -> gym.Env[Any, Any]:
        """Rebuild the environment that it was trained in, without what only watches a training, as ``Monitor``.

        Args:
            arguments: Of the environment, over those that it was trained with, such as ``render_mode="human"``.

        Raises:
            BundleError: The environment is not registered here, cannot be made, or needs the bundle to be trusted: it
                names code or files, has a wrapper that is in no closed list, or asks for too much.
            ImportError: A simulator is not installed.
        """
        return environment.rebuild(self.spec, trust=self.trusted, arguments=arguments)

    def wrap(
        self, env: gym.Env[Any, Any], goal: Any = None, scene: Mapping[str, Any] | None = None
    ) -> gym.Env[Any, Any]:
        """Wrap another environment with images, a camera and a robot as a rule, so that the policy can read it.

        Wrappers that only a training has are left out. A policy that was trained over an environment with goals of its
        own gets a ``ShapeGoal``.

        Args:
            env: With images and a camera; without goals of its own.
            goal: As ``ShapeGoal`` takes it; None where each reset is told one, and for a policy without goals.
            scene: Arguments of ``ShapeObservation`` that are this site's own: ``segmentation``, ``roi``, ``workspace``,
                and how to behave while running.

        Raises:
            BundleError: The policy cannot run before a camera, has no goals but is given one, or a wrapper of its own
                needs the bundle to be trusted; the message says why.
            ValueError: The environment or the scene do not fit.
        """
        self.check_deployable()
        self._check_place(env)
        config = dict(self.record.config or {})
        shape = {name: config[name] for name in SECTIONS["shape"] if name in config}
        running = {name: config[name] for name in ("on_missing", "on_invalid", "max_age") if name in config}
        published = env_protocol.published(env, "shape_obs_defaults", {})
        known = {name: published[name] for name in ("shapes", *SECTIONS["scene"]) if name in published}
        local = {"workspace": config.get("workspace"), **running, **known, **(scene or {})}
        wrapped: gym.Env[Any, Any] = ShapeObservation(env, **{**local, **_site_colours(shape, local)})
        wrappers = reading_wrappers(self.spec)
        if goal is not None and not self.needs_goal:
            raise BundleError("the policy was trained without goals, so it cannot be told one.")
        if self.needs_goal and all(wrapper.name != ShapeGoal.__name__ for wrapper in wrappers):
            points = next((feature for feature in self.features if isinstance(feature, Points3D)), None)
            if points is None:
                raise BundleError("the policy has goals of points in metres, but it reads no feature 'points3d'.")
            wrapped = ShapeGoal(wrapped, goal, [points], reward_type="sparse", threshold=self.success_threshold)
        for wrapper in wrappers:
            kwargs = dict(wrapper.kwargs or {})
            if wrapper.name == ShapeGoal.__name__ and goal is not None:
                kwargs["goal"] = goal
            wrapped = self._wrapped(wrapped, wrapper, kwargs)
        return wrapped

    def check_env(self, env: gym.Env[Any, Any], *, same_rate: bool = True) -> None:
        """Refuse an environment in which the policy would read or do something else than it was trained for.

        Colours, regions, workspaces and where the camera stands may differ.

        Args:
            env: Wrapped as ``wrap`` does it.
            same_rate: Whether steps must take as long as in training.

        Raises:
            BundleError: It is another one; the message names each difference: features, number of points,
                configuration, units and frames, the observation's layout, what actions mean, the duration of a step.
        """
        found = self.differences(env, same_rate=same_rate)
        if found:
            raise BundleError(f"the policy does not fit this environment: {told(found)}.")

    def differences(self, env: gym.Env[Any, Any], *, same_rate: bool = True) -> list[Difference]:
        """What ``check_env`` refuses: (place, trained, here)."""
        return differences(self.record, Surroundings.of(env), same_rate=same_rate)

    def check_deployable(self) -> None:
        """Refuse what cannot run before a camera.

        Raises:
            BundleError: It reads what only a simulator tells, or nobody told what its actions mean.
        """
        reason = obstacle(self.spec)
        if not reason and self.action_spec is None:
            reason = "nobody told what its actions mean: save it with action_spec="
        if reason:
            raise BundleError(f"the policy cannot be deployed: {reason}.")

    def controller(self, *, same_rate: bool = True) -> PolicyController:
        """The policy for ``shape_obs.deploy``.

        Args:
            same_rate: Whether it refuses a loop at another rate than it was trained at.

        Raises:
            BundleError: It cannot run before a camera; the message says why.
        """
        from shape_obs.deploy.policy_bundle.policy import PolicyController

        self.check_deployable()
        return PolicyController(self, same_rate=same_rate)

    @property
    def action_spec(self) -> ActionSpec | None:
        """What its actions mean."""
        return self.record.action_spec

    @property
    def features(self) -> list[Feature]:
        """What it reads of each shape, in the order of the vector; none where it reads no shapes."""
        return read_features((self.record.config or {}).get("features", ()))

    @property
    def dt(self) -> float:
        """Seconds of a step in training."""
        return self.record.dt

    @property
    def needs_goal(self) -> bool:
        """Whether it brings the shape into a goal."""
        keys = self.record.observation_space.get("spaces", {})
        return all(key in keys for key in GOALS) or any(
            wrapper.name == ShapeGoal.__name__ for wrapper in self.spec.additional_wrappers
        )

    @property
    def has_goal(self) -> bool:
        """Whether it was trained for one goal, which it brings with it."""
        goals = [(wrapper.kwargs or {}).get("goal") for wrapper in self.spec.additional_wrappers]
        return any(goal is not None for goal in goals)

    @property
    def success_threshold(self) -> float:
        """Metres below which a goal counts as reached."""
        return self.record.success_threshold or 0.01

    def _wrapped(self, env: gym.Env[Any, Any], wrapper: WrapperSpec, kwargs: Mapping[str, Any]) -> gym.Env[Any, Any]:
        if not self.trusted:
            wrapper = environment.check_wrapper(wrapper)
        kind = load_named(wrapper.entry_point, f"wrapper {wrapper.name}")
        try:
            return kind(env, **kwargs)
        except MALFORMED as error:
            raise BundleError(f"the policy's wrapper {wrapper.name} does not fit this environment: {error}") from error

    def _check_place(self, env: gym.Env[Any, Any]) -> None:
        """Refuse features in the base frame where nobody knows where the camera stands in it."""
        camera = env_protocol.camera_model(env)
        for feature in self.features:
            in_base = getattr(getattr(feature, "coordinates", None), "frame", None) == "base"
            if in_base and (camera is None or camera.transform_camera_to_base is None):
                raise BundleError(
                    f"the policy reads {feature.kind!r} in the base frame, and nobody knows where this camera stands "
                    "in it: give --extrinsics FILE, as `shape-obs calibrate base` writes it."
                )



def _site_colours(shape: Mapping[str, Any], scene: Mapping[str, Any]) -> dict[str, Any]:
    """The ``shape`` section; where a shape has colours of its own, this site's, by its name."""
    here = [item for item in scene.get("shapes") or () if isinstance(item, Mapping)]
    local = {item.get("name") or item.get("kind"): item.get("segmentation") for item in here}
    shapes = [{**item, "segmentation": local.get(item["name"])} for item in shape["shapes"]]
    return {**shape, "shapes": shapes}




class PolicyController:
    """Acts as the policy does, without exploring.

    Args:
        bundle: The policy.
        same_rate: Whether it refuses a loop at another rate than it was trained at.

    Attributes:
        same_rate: As given.
        action_spec: What its actions mean; ``shape_obs.deploy.deploy`` holds it against the robot's.
    """

    def __init__(self, bundle: Bundle, *, same_rate: bool = True) -> None:
        self._bundle, self.same_rate = bundle, same_rate
        self.action_spec: ActionSpec | None = bundle.action_spec

    def attach(self, env: Any) -> None:
        """Hold the environment against that of the training.

        Raises:
            BundleError: It is another one; the message names each difference.
        """
        self._bundle.check_env(env, same_rate=self.same_rate)
        self._bundle.act(zeros(env.observation_space))  # the first time takes longer, and the loop has a deadline

    def bind(self, spec: ActionSpec) -> None:
        """Nothing to size: actions are those of the training."""

    def reset(self) -> None:
        """Nothing to forget: the policy has no memory."""

    def act(self, observation: Any) -> npt.NDArray[Any]:
        """The action (A,) in -1 ... 1."""
        return self._bundle.act(observation)

