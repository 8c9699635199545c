"""Record what a policy was trained in, and compare that with the environment in which it is to run."""

from __future__ import annotations

import math
import platform
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from importlib import metadata
from importlib.util import find_spec
from itertools import zip_longest
from typing import TYPE_CHECKING, Any, Final

from shape_obs.config.config_file import hashed_values, schema_hash
from shape_obs.config.detector_config import ALGORITHM
from shape_obs.deploy.policy_bundle.documents import BundleError
from shape_obs.deploy.policy_bundle.spaces import layout_differences, space_from_dict, space_to_dict
from shape_obs.features import Feature, read_features
from shape_obs.robot import ActionSpec
from shape_obs.spec import Spec
from shape_obs.wrappers import ShapeObservation
from shape_obs.wrappers.env_protocol import camera_model, published, seconds_per_step
from shape_obs.wrappers.recorded_arguments import to_recorded

if TYPE_CHECKING:
    import gymnasium as gym

#: Packages whose versions are recorded.
_PACKAGES: Final = ("shape-obs", "stable-baselines3", "sb3-contrib", "torch", "gymnasium", "numpy", "mujoco")
#: Shortest and longest step in seconds.
_SHORTEST: Final = 1e-4
_LONGEST: Final = 3600.0
_MOST_SIDE: Final = 16_384
#: Packages whose next major version may read a bundle differently.
_MAJOR: Final = ("stable-baselines3", "gymnasium", "torch")


@dataclass(frozen=True)
class Surroundings(Spec):
    """Describe the properties of an environment that matter to a policy.

    Args:
        dt: Duration of a step in seconds.
        observation_space: Observation space, as ``space_to_dict`` returns it.
        action_space: Action space, as ``space_to_dict`` returns it.
        config: Arguments of its ``ShapeObservation`` with defaults filled in; None if it has none.
        schema: Hash of the feature schema; None without a ``ShapeObservation``.
        image: Width and height of the images in pixels.
        camera: Intrinsics and, if known, ``transform_camera_to_base``, as mappings.
        action_spec: Meaning of an action of 1; None if the environment does not publish it.
        success_threshold: Distance in metres below which a simulator counts a goal as reached.
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
        """Collect the properties of an environment."""
        config, schema, image = None, None, None
        shapes = shape_observation(env)
        if shapes is not None:
            view = shapes.contexts[0]
            config = {
                **shapes.detector.config.to_dict(),
                "features": [feature.to_dict() for feature in shapes.features],
            }
            if view.workspace is not None:
                config["workspace"] = to_recorded(view.workspace)
            schema, image = schema_hash(config), (view.width, view.height)
        camera = camera_model(env) if shapes is None else shapes.contexts[0].camera
        robot = getattr(env.unwrapped, "robot", None)
        return cls(
            dt=seconds_per_step(env),
            observation_space=space_to_dict(env.observation_space),
            action_space=space_to_dict(env.action_space),
            config=config,
            schema=schema,
            image=image,
            camera=None if camera is None else to_recorded(camera),
            action_spec=published(env, "action_spec", getattr(robot, "action_spec", None)),
            success_threshold=published(env.unwrapped, "success_threshold"),
        )


@dataclass(frozen=True)
class Record(Surroundings):
    """Describe a policy and the environment in which it was trained.

    Args:
        algorithm: Name of the algorithm, such as ``"SAC"``.
        versions: Versions of Python and the packages, by name.
        summary: Summary of the training: algorithm, steps, seed, and what ``save_bundle`` was given.
        detector_version: Version of the detector's algorithm, ``ALGORITHM``; 1 in bundles that do not record it.
    """

    algorithm: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    summary: Mapping[str, Any] = field(default_factory=dict)
    detector_version: int = 1

    def check(self) -> None:
        """Refuse numbers outside of their ranges, and invalid spaces.

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

    def check_versions(self) -> None:
        """Refuse packages of another major version than in training.

        Raises:
            BundleError: The message names the packages.
        """
        fatal = version_differences(self.versions, versions())[0]
        if fatal:
            raise BundleError(f"it may not run correctly with other major versions: {', '.join(fatal)}.")

    def check_schema(self) -> None:
        """Refuse features that have another meaning in this version of the library.

        Raises:
            BundleError: The hashes of the feature schema differ.
        """
        here = None if self.config is None else schema_hash(self.config)
        if here != self.schema:
            raise BundleError(
                f"its features mean something else here: the hash of their schema is {str(here)[:12]}..., recorded was "
                f"{str(self.schema)[:12]}... Use the version of shape-obs that saved it: "
                f"{self.versions.get('shape-obs')}"
            )

    def other_points(self) -> str:
        """Return why the points may differ from those of the training though the schema is equal; empty if not."""
        if self.config is None or self.detector_version == ALGORITHM:
            return ""
        return (
            f"it was trained on the points of version {self.detector_version} of the detector's algorithm, this is "
            f"version {ALGORITHM}: equal images may give slightly other points. Evaluate it again before use."
        )


def shape_observation(env: gym.Env[Any, Any]) -> ShapeObservation | None:
    """Return the outermost ``ShapeObservation`` of an environment; None if it has none."""
    inner: Any = env
    while not isinstance(inner, ShapeObservation):
        if inner is inner.unwrapped:
            return None
        inner = inner.env
    return inner


def versions() -> dict[str, str]:
    """Return the versions of Python and of the installed packages, by name."""
    installed = {name: find_spec(name.replace("-", "_")) for name in _PACKAGES}
    known = {name: metadata.version(name) for name, spec in installed.items() if spec is not None}
    return {"python": platform.python_version(), **known}


def version_differences(trained: Mapping[str, str], here: Mapping[str, str]) -> tuple[list[str], list[str]]:
    """Return two lists of differences: major versions, which are errors, and minor versions, which are warnings."""
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
    """Return major and minor version."""
    return version.split("+")[0].split(".")[:2]


# ---- Differences

Difference = tuple[str, Any, Any]
_ACTION: Final = ("names", "units", "scale", "mode", "frame")


def differences(trained: Surroundings, here: Surroundings, *, same_rate: bool = True) -> list[Difference]:
    """Return where two environments differ for a policy, as (place, trained, here).

    Colours, regions of interest, workspaces and the pose of the camera may differ from site to site.

    Args:
        trained: The environment of the training.
        here: The environment in which the policy is to run.
        same_rate: Whether the duration of a step must be the same.
    """
    found = [*_of_schema(trained.config, here.config), *_of_camera(trained, here)]
    found += layout_differences(trained.observation_space, here.observation_space, "observation")
    found += _of_actions(trained.action_spec, here.action_spec)
    if same_rate and abs(trained.dt - here.dt) > 1e-3 * trained.dt:
        found.append(("dt [s]", round(trained.dt, 6), round(here.dt, 6)))
    return found


def format_differences(found: list[Difference]) -> str:
    """Return all differences in one line."""
    return "; ".join(f"{place}: {one!r} in training, {other!r} here" for place, one, other in found)


def _of_schema(trained: Mapping[str, Any] | None, here: Mapping[str, Any] | None) -> Iterator[Difference]:
    """Yield the differences of the ``shape`` sections."""
    if trained is None or here is None:
        if trained is not here:
            yield "ShapeObservation", trained is not None, here is not None
        return
    yield from _walk(hashed_values(trained), hashed_values(here), "")


def _of_camera(trained: Surroundings, here: Surroundings) -> Iterator[Difference]:
    """Yield a different size of images, which matters for features in pixels."""
    features = [] if trained.config is None else _features(trained.config)
    if any(feature.unit == "px" for feature in features) and trained.image != here.image:
        yield "image size [px]", trained.image, here.image


def _of_actions(trained: ActionSpec | None, here: ActionSpec | None) -> Iterator[Difference]:
    if trained is None or here is None:
        if trained is not here:
            yield "known action_spec", trained is not None, here is not None
        return
    one, other = trained.to_dict(), here.to_dict()
    for name in _ACTION:
        if one[name] != other[name]:
            yield f"action {name}", one[name], other[name]


def _features(config: Mapping[str, Any]) -> list[Feature]:
    return read_features(config["features"])


def _walk(trained: Any, here: Any, where: str) -> Iterator[Difference]:
    """Yield the leaves in which two JSON values differ."""
    if isinstance(trained, Mapping) and isinstance(here, Mapping):
        if trained.get("kind") != here.get("kind"):
            yield f"{where} kind", trained.get("kind"), here.get("kind")
            return
        for name in {**trained, **here}:
            yield from _walk(trained.get(name), here.get(name), f"{where}.{name}" if where else name)
    elif isinstance(trained, list) and isinstance(here, list):
        if len(trained) != len(here) and not all(isinstance(item, Mapping) for item in trained + here):
            yield where, trained, here
            return
        for i, (one, other) in enumerate(zip_longest(trained, here)):
            yield from _walk(one, other, f"{where}[{i}]")
    elif trained != here:
        yield where, trained, here
