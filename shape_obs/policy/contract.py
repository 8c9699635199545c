"""Describe a policy: what it reads, what its actions mean, and where it was trained; the file ``policy.yaml``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import gymnasium as gym
import numpy as np

from shape_obs.config.config_file import detector_arguments, hashed_values, schema_hash
from shape_obs.config.detector_config import ALGORITHM, DetectorConfig
from shape_obs.features import Feature, PrincipalComponents, read_features
from shape_obs.features.distribution import hold, read_bytes
from shape_obs.image.mask_function import MaskFunction
from shape_obs.robot import ActionSpec
from shape_obs.spec import Spec, to_plain, without_plugins
from shape_obs.wrappers import ShapeObservation
from shape_obs.wrappers.env_protocol import camera_model, published, seconds_per_step
from shape_obs.wrappers.recorded_arguments import to_recorded

FORMAT: Final = 1  # of policy.yaml, higher with each change that older versions of the library cannot read
#: Largest numbers of a configuration, so that a detector for it is built in a moment: by name, and all others.
_MOST: Final = {"n": 1000, "rows": 100, "cols": 100, "count": 100, "harmonics": 64, "coefficients": 200,
                "open": 255, "close": 255, "epochs": 100, "n_init": 20, "max_iter": 1000, "steps": 1000}  # fmt: skip
_MOST_NUMBER: Final = 1e6  # pixels, metres and steps of any use are below
_MOST_VALUES: Final = 5000  # some twenty times those of twenty shapes
#: Wrappers that leave observations and actions alone.
TRANSPARENT: Final = (
    "TimeLimit", "OrderEnforcing", "PassiveEnvChecker", "Autoreset", "RecordEpisodeStatistics", "RecordVideo",
    "HumanRendering", "ClipReward", "NormalizeReward", "TransformReward", "Monitor", "Curriculum", "ActionMasker",
    "VecMonitor", "VecCheckNan", "VecVideoRecorder", "VecTransposeImage",
)  # fmt: skip
_OWN: Final = ("ShapeGoal", "PointReward")
_ROBOT_KEYS: Final = ("rgb", "depth", "robot")
#: Name of the input for observations that are one array.
ARRAY: Final = "observation"


class PolicyError(ValueError):
    """A policy that cannot be saved, read or used here; the message gives the reason."""

    __module__ = "shape_obs.policy"  # its public path, which tracebacks show


@dataclass(frozen=True)
class Tensor(Spec):
    """Describe an observation or an action.

    Args:
        shape: Its shape, without the batch of 1, the first axis of the network's inputs.
        dtype: Its type, as NumPy names it; actions of integers are discrete.
        low: Of an action: the least value of each number.
        high: Of an action: the largest value of each number.
    """

    shape: tuple[int, ...]
    dtype: str
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()

    @property
    def discrete(self) -> bool:
        """Whether it consists of integers."""
        return not self.dtype.startswith("float")


@dataclass(frozen=True)
class Contract(Spec):
    """Describe a policy and the environment of its training.

    Args:
        inputs: Observations that the network reads, by key; one with any name if the observation is an array.
        action: Action space.
        dt: Duration of a step in seconds.
        format: Version of the format.
        output: Name of the output with the action.
        states: Of a network that remembers: the output that becomes an input in the next step, by the name of that
            input. States are zeros when an episode starts.
        mask: Number of actions that the input ``action_mask`` allows or forbids; None without such an input.
        action_spec: Meaning of an action of 1; None if unknown.
        config: Arguments of the ``ShapeObservation`` with defaults filled in; None if the policy reads no shapes.
        schema: Hash of the feature schema; None without ``config``.
        image: Width and height of the images in pixels.
        camera: Intrinsics and, if known, ``transform_camera_to_base``.
        wrappers: ``ShapeGoal`` and ``PointReward`` around the ``ShapeObservation``, as names and arguments.
        success_threshold: Distance in metres below which a simulator counts a goal as reached.
        detector_version: Version of the detector's algorithm.
        obstacle: Reason why the policy cannot run with a camera; ``""`` if it can.
        trained: Summary of the training: algorithm, steps, seed, environment, versions.
        sha256: SHA-256 of ``policy.onnx`` and ``replay.npz``, by name.
    """

    inputs: Mapping[str, Tensor]
    action: Tensor
    dt: float
    format: int = FORMAT
    output: str = "action"
    states: Mapping[str, str] = field(default_factory=dict)
    mask: int | None = None
    action_spec: ActionSpec | None = None
    config: Mapping[str, Any] | None = None
    schema: str | None = None
    image: tuple[int, int] | None = None
    camera: Mapping[str, Any] | None = None
    wrappers: tuple[Mapping[str, Any], ...] = ()
    success_threshold: float | None = None
    detector_version: int = ALGORITHM
    obstacle: str = ""
    trained: Mapping[str, Any] = field(default_factory=dict)
    sha256: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.format != FORMAT:
            raise PolicyError(f"expected a policy of format {FORMAT}, got {self.format}: save it again.")
        if not 1e-4 <= self.dt <= 3600:
            raise PolicyError(f"dt: expected 0.0001 to 3600 seconds, got {self.dt}.")

    @property
    def features(self) -> list[Feature]:
        """Features of each shape, in the order of the observation; empty if the policy reads no shapes."""
        return read_features((self.config or {}).get("features", ()))

    @property
    def fitted(self) -> list[str]:
        """Names of the contents of fitted files that features read."""
        places = _leaves([self.config, *self.wrappers])
        return sorted({str(value) for place, value in places if place.endswith(".file") and value is not None})

    @property
    def needs_goal(self) -> bool:
        """Whether the policy reads a goal."""
        return "desired_goal" in self.inputs or any(wrapper["name"] == "ShapeGoal" for wrapper in self.wrappers)

    @property
    def has_goal(self) -> bool:
        """Whether the policy was trained for a single goal, which the file holds."""
        return any((wrapper.get("kwargs") or {}).get("goal") is not None for wrapper in self.wrappers)

    def check_config(self) -> None:
        """Refuse a configuration that names code or files, asks for too much, or has another meaning here."""
        for wrapper in self.wrappers:
            if wrapper.get("name") not in _OWN:
                raise PolicyError(f"wrappers: expected ShapeGoal and PointReward, got {wrapper.get('name')!r:.40}.")
        values = list(_leaves([self.config, *self.wrappers]))
        if len(values) > _MOST_VALUES:
            raise PolicyError(f"config: expected at most {_MOST_VALUES} values, got {len(values)}.")
        for place, value in values:
            name = place.rpartition(".")[2].partition("[")[0]
            most = _MOST.get(name, _MOST_NUMBER)
            if name == "file" and value is not None and not str(value).startswith("sha256:"):
                raise PolicyError(f"config: a feature reads the file {value!r:.100}, which a policy cannot hold.")
            if isinstance(value, (int, float)) and not abs(value) <= most:
                raise PolicyError(f"config: {name} is {value!r:.40}, expected a finite number up to {most:g}.")
        here = None
        if self.config is not None:
            with without_plugins():
                code = DetectorConfig.from_dict(detector_arguments(self.config)).code_paths
                here = schema_hash(self.config)
            if code:
                raise PolicyError(f"config: the segmentation is code to import, {code[0]!r:.100}.")
        if here != self.schema:
            raise PolicyError("its features mean something else here: use the version of shape-obs that saved it.")


def describe(env: gym.Env[Any, Any]) -> Contract:
    """Return the part of a contract that describes an environment; refuse observations without a fixed shape."""
    own, unknown, inner = [], [], env  # wrappers, the outermost first
    while isinstance(inner, gym.Wrapper) and not isinstance(inner, ShapeObservation):
        if type(inner).__name__ in _OWN:
            given = _with_contents(to_plain(getattr(inner, "_saved_kwargs", {})))
            own.insert(0, {"name": type(inner).__name__, "kwargs": given})
        elif type(inner).__name__ not in TRANSPARENT and not isinstance(inner, gym.ActionWrapper):
            unknown.append(type(inner).__name__)
        inner = inner.env
    seen: dict[str, Any] = {"camera": camera_model(env)}
    obstacle = "it does not read shapes: there is no ShapeObservation in its environment"
    if isinstance(inner, ShapeObservation):
        view, detector = inner.contexts[0], inner.detector.config
        config = replace(detector, shapes=tuple(map(_without_function, detector.shapes)))
        config = {
            **_without_function(config).to_dict(),
            "features": _with_contents([one.to_dict() for one in inner.features]),
        }
        if view.workspace is not None:
            config["workspace"] = to_recorded(view.workspace)
        seen = {"config": config, "schema": schema_hash(config), "image": (view.width, view.height)}
        seen |= {"camera": view.camera, "wrappers": tuple(own)}
        kept = [key for key in inner._saved_kwargs.get("keep") or () if key not in _ROBOT_KEYS]
        obstacle = f"it also reads {', '.join(kept)}, which only its simulator provides (keep)" if kept else ""
    if unknown:
        obstacle = f"it is not known what the wrapper {unknown[-1]} does on a robot"
    seen["camera"] = None if seen["camera"] is None else to_recorded(seen["camera"])
    space = env.observation_space
    spaces = space.spaces if isinstance(space, gym.spaces.Dict) else {ARRAY: space}
    robot = getattr(env.unwrapped, "robot", None)
    return Contract(
        inputs={name: _tensor(space, f"observations of {name}") for name, space in spaces.items()},
        action=_action(env.unwrapped.action_space),
        dt=seconds_per_step(env),
        action_spec=published(env, "action_spec", getattr(robot, "action_spec", None)),
        success_threshold=published(env.unwrapped, "success_threshold"),
        obstacle=obstacle,
        **seen,
    )


def _with_contents(values: Any) -> Any:
    """Return plain values with the contents of the files to which features were fitted in place of their paths."""
    if isinstance(values, list):
        return [_with_contents(each) for each in values]
    if not isinstance(values, Mapping):
        return values
    if values.get("kind") == PrincipalComponents.kind and values.get("file"):
        return {**values, "file": hold(read_bytes(Path(values["file"])))}
    return {name: _with_contents(each) for name, each in values.items()}


def _without_function(config: Any) -> Any:
    """Leave out a segmentation that is a function: each site has its own segmentation."""
    return replace(config, segmentation=None) if isinstance(config.segmentation, MaskFunction) else config


def _tensor(space: Any, what: str) -> Tensor:
    if space.shape is None or space.dtype is None or space.dtype.kind not in "biuf":
        raise PolicyError(f"expected arrays of fixed shape, got {what}: {space}.")
    return Tensor(tuple(space.shape), str(space.dtype))


def _action(space: Any) -> Tensor:
    action = _tensor(space, "actions")
    if isinstance(space, gym.spaces.Box):
        low, high = space.low, space.high
    elif isinstance(space, gym.spaces.MultiBinary):
        low, high = np.zeros(space.shape), np.ones(space.shape)
    else:  # Discrete, MultiDiscrete
        low, high = space.start, space.start + getattr(space, "nvec", getattr(space, "n", None)) - 1
    return replace(action, low=tuple(np.ravel(low)), high=tuple(np.ravel(high)))


def differences(trained: Contract, here: Contract, *, same_rate: bool = True) -> list[tuple[str, Any, Any]]:
    """Return where an environment differs for a policy from that of its training, as (place, trained, here).

    Colours, regions of interest, workspaces and the pose of the camera may differ from site to site.
    """
    pixels = any(feature.unit == "px" for feature in trained.features)
    one, other = (dict(_places(side, pixels, same_rate)) for side in (trained, here))
    places = {**one, **other}
    return [(place, one.get(place), other.get(place)) for place in places if one.get(place) != other.get(place)]


def _places(contract: Contract, pixels: bool, same_rate: bool) -> Iterator[tuple[str, Any]]:
    """Yield what must be equal in training and here, with its place."""
    yield "ShapeObservation", contract.config is not None
    yield from _leaves({} if contract.config is None else hashed_values(contract.config))
    if pixels:
        yield "image size [px]", contract.image
    for name, tensor in contract.inputs.items():
        where = "observation" if len(contract.inputs) == 1 else f"observation {name!r}"
        yield from ((f"{where} shape", list(tensor.shape)), (f"{where} dtype", tensor.dtype))
    action = contract.action_spec.to_dict() if contract.action_spec else {}
    yield "known action_spec", bool(action)
    yield from ((f"action {name}", action.get(name)) for name in ("names", "units", "scale", "mode", "frame"))
    if same_rate:
        yield "dt [s]", float(f"{contract.dt:.3g}")


def _leaves(value: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the numbers and texts in JSON values with their place, such as ``shapes[0].n``."""
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from _leaves(inner, f"{place}.{name}" if place else str(name))
    elif isinstance(value, (list, tuple)):
        for i, inner in enumerate(value):
            yield from _leaves(inner, f"{place}[{i}]")
    else:
        yield place, value
