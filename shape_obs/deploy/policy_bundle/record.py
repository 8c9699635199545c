"""Record: what a bundle tells of a policy, beside its parameters."""

from __future__ import annotations

import math
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import metadata
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Final

from shape_obs.config import schema_hash
from shape_obs.deploy.policy_bundle.errors import BundleError
from shape_obs.deploy.policy_bundle.spaces import space_from_dict, space_to_dict
from shape_obs.robot import ActionSpec
from shape_obs.spec import Spec
from shape_obs.wrappers import ShapeObservation
from shape_obs.wrappers.env_protocol import camera_model, published, seconds_per_step
from shape_obs.wrappers.shape_observation import to_recorded as plain

if TYPE_CHECKING:
    import gymnasium as gym

#: Distributions whose versions are told.
_PACKAGES: Final = ("shape-obs", "stable-baselines3", "sb3-contrib", "torch", "gymnasium", "numpy", "mujoco")
#: Seconds of a step.
_SHORTEST: Final = 1e-4
_LONGEST: Final = 3600.0
_MOST_SIDE: Final = 16_384
#: Of these another major version cannot be trusted to read what was written.
_MAJOR: Final = ("stable-baselines3", "gymnasium", "torch")


@dataclass(frozen=True)
class Surroundings(Spec):
    """What an environment tells of itself that matters to a policy.

    Args:
        dt: Seconds of a step.
        observation_space: As ``space_to_dict`` gives it.
        action_space: So too.
        config: Arguments of its ``ShapeObservation``, defaults filled in; None without one.
        schema: Hash of the feature schema; None without one.
        image: (width, height) of the images in pixels.
        camera: Intrinsics and, where known, ``transform_camera_to_base``, as mappings.
        action_spec: What an action of 1 means; None where it does not tell.
        success_threshold: Metres below which a simulator counts a goal as reached.
    """

    dt: float
    observation_space: Mapping[str, Any]
    action_space: Mapping[str, Any]
    config: Mapping[str, Any] | None = None
    schema: str | None = None
    image: tuple[int, int] | None = None
    camera: Mapping[str, Any] | None = None
    action_spec: ActionSpec | None = None
    success_threshold: float | None = None

    @classmethod
    def of(cls, env: gym.Env[Any, Any]) -> Surroundings:
        """Look at an environment."""
        config, schema, image, camera = None, None, None, camera_model(env)
        shapes = shape_observation(env)
        if shapes is not None:
            view = shapes.contexts[0]
            config = {
                **shapes.detector.config.to_dict(),
                "features": [feature.to_dict() for feature in shapes.features],
            }
            if view.workspace is not None:
                config["workspace"] = plain(view.workspace)
            schema, image = schema_hash(config), (view.width, view.height)
            camera = view.camera or camera
        robot = getattr(env.unwrapped, "robot", None)
        return cls(
            dt=seconds_per_step(env),
            observation_space=space_to_dict(env.observation_space),
            action_space=space_to_dict(env.action_space),
            config=config,
            schema=schema,
            image=image,
            camera=None if camera is None else plain(camera),
            action_spec=published(env, "action_spec", getattr(robot, "action_spec", None)),
            success_threshold=published(env.unwrapped, "success_threshold"),
        )


@dataclass(frozen=True)
class Record(Surroundings):
    """What a policy is, and what it was trained in.

    Args:
        algorithm: Its name, such as ``"SAC"``.
        versions: Of Python and the packages, by name.
        summary: Of the training: algorithm, steps, seed, and what was given.
    """

    algorithm: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    summary: Mapping[str, Any] = field(default_factory=dict)

    def check(self) -> None:
        """Refuse numbers that no environment has, and spaces that are none.

        Raises:
            BundleError: The message names the field.
        """
        reached = self.success_threshold
        if not _SHORTEST <= self.dt <= _LONGEST:
            raise BundleError(f"dt: expected {_SHORTEST} to {_LONGEST} seconds, got {self.dt}.")
        if reached is not None and not 0 < reached < math.inf:
            raise BundleError(f"success_threshold: expected metres above 0, got {reached}.")
        if self.image is not None and not all(0 < side <= _MOST_SIDE for side in self.image):
            raise BundleError(f"image: expected 1 to {_MOST_SIDE} pixels, got {self.image}.")
        space_from_dict(self.observation_space, "the observation space")
        space_from_dict(self.action_space, "the action space")


def shape_observation(env: gym.Env[Any, Any]) -> ShapeObservation | None:
    """The outermost ``ShapeObservation`` of an env."""
    inner: Any = env
    while not isinstance(inner, ShapeObservation):
        if inner is inner.unwrapped:
            return None
        inner = inner.env
    return inner


def versions() -> dict[str, str]:
    """Of Python and of the packages that are installed, by name."""
    installed = {name: find_spec(name.replace("-", "_")) for name in _PACKAGES}
    known = {name: metadata.version(name) for name, spec in installed.items() if spec is not None}
    return {"python": platform.python_version(), **known}


def version_differences(trained: Mapping[str, str], here: Mapping[str, str]) -> tuple[list[str], list[str]]:
    """What cannot work and what may not, one text for each package: another major version, another minor version."""
    fatal, doubtful = [], []
    for name, before in trained.items():
        now = here.get(name)
        if now is None or _parts(before) == _parts(now):
            continue
        text = f"{name} {before} then, {now} here"
        major = name in _MAJOR and _parts(before)[0] != _parts(now)[0]
        (fatal if major else doubtful).append(text)
    return fatal, doubtful


def _parts(version: str) -> list[str]:
    """Major and minor."""
    return version.split("+")[0].split(".")[:2]
