"""Describe a policy: what it reads, what its actions mean, and where it was trained; the file ``policy.yaml``."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from typing import TYPE_CHECKING, Any, Final

from shape_obs.config.config_file import hashed_values, schema_hash
from shape_obs.config.detector_config import ALGORITHM, DetectorConfig
from shape_obs.features import Feature, read_features
from shape_obs.image.mask_function import MaskFunction
from shape_obs.robot import ActionSpec
from shape_obs.spec import Spec, to_plain, without_plugins
from shape_obs.wrappers import ShapeObservation
from shape_obs.wrappers.env_protocol import camera_model, published, seconds_per_step
from shape_obs.wrappers.recorded_arguments import to_recorded

if TYPE_CHECKING:
    import gymnasium as gym

FORMAT: Final = 1
#: Shortest and longest step in seconds.
_STEPS: Final = (1e-4, 3600.0)
#: Bytes of the largest observation or action, and of all states together.
_MOST_BYTES: Final = 16 << 20
_MOST_TENSORS: Final = 64
_MOST_DIMENSIONS: Final = 5
_MOST_TEXT: Final = 65_536
_DTYPES: Final = (
    "bool",
    "uint8",
    "int8",
    "uint16",
    "int16",
    "uint32",
    "int32",
    "int64",
    "float16",
    "float32",
    "float64",
)
#: Largest numbers of a configuration, so that a detector for it is built in a moment: by name, and all others.
_MOST: Final = {
    "n": 1000, "rows": 100, "cols": 100, "count": 100, "epochs": 100, "harmonics": 64, "degree": 32,
    "coefficients": 200, "open": 255, "close": 255, "n_init": 20, "max_iter": 1000, "steps": 1000,
}  # fmt: skip
_MOST_NUMBER: Final = 1e6
_MOST_SHAPES, _MOST_FEATURES, _MOST_POINTS = 8, 16, 4096


class PolicyError(ValueError):
    """A policy that cannot be saved, read or used here; the message gives the reason."""

    __module__ = "shape_obs.policy"  # its public path, which tracebacks show


@dataclass(frozen=True)
class Tensor(Spec):
    """Describe an input of the network.

    Args:
        shape: Its shape; without the first axis, the batch of 1, unless it is a state.
        dtype: Its type, as NumPy names it.
        key: Of an observation in a dictionary: its key; ``""`` for an observation that is one array.
        output: Of a state: the output that replaces it after each step. States are zeros when an episode starts.
    """

    shape: tuple[int, ...]
    dtype: str
    key: str = ""
    output: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.dtype not in _DTYPES or len(self.shape) > _MOST_DIMENSIONS or any(side < 1 for side in self.shape):
            raise PolicyError(
                f"expected up to {_MOST_DIMENSIONS} sides and a type of {', '.join(_DTYPES)}, got {self}."
            )
        if math.prod(self.shape) * 8 > _MOST_BYTES:
            raise PolicyError(f"expected a tensor of at most {_MOST_BYTES} bytes, got shape {self.shape}.")


@dataclass(frozen=True)
class Contract(Spec):
    """Describe a policy and the environment of its training.

    Args:
        inputs: Observations that the network reads, by the name of its input, as mappings of ``Tensor``.
        action: Action: ``kind`` (``box``, ``discrete``, ``multidiscrete`` or ``multibinary``), ``shape``, ``dtype``,
            and ``low`` and ``high`` (box), ``start`` (discrete).
        dt: Duration of a step in seconds.
        format: Version of the format.
        output: Name of the output with the action.
        states: Inputs that the network computes for its next step, by name.
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

    inputs: Mapping[str, Any]
    action: Mapping[str, Any]
    dt: float
    format: int = FORMAT
    output: str = "action"
    states: Mapping[str, Any] = field(default_factory=dict)
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
        if not _STEPS[0] <= self.dt <= _STEPS[1]:
            raise PolicyError(f"dt: expected {_STEPS[0]} to {_STEPS[1]} seconds, got {self.dt}.")
        reached = self.success_threshold
        if reached is not None and not 0 < reached < math.inf:
            raise PolicyError(f"success_threshold: expected metres above 0, got {reached}.")
        if not 1 <= len(self.inputs) + len(self.states) <= _MOST_TENSORS:
            raise PolicyError(f"expected 1 to {_MOST_TENSORS} inputs, got {len(self.inputs) + len(self.states)}.")
        keys = [tensor.key for tensor in self.tensors.values()]
        if len(set(keys)) < len(keys) or ("" in keys and len(keys) > 1):
            raise PolicyError(f"inputs: expected one without a key, or different keys, got {keys}.")
        if any(not Tensor.from_dict(state).output for state in self.states.values()):
            raise PolicyError("states: expected the output of each.")
        if self.mask is not None and not 1 <= self.mask <= 1_000_000:
            raise PolicyError(f"mask: expected a number of actions, got {self.mask}.")
        action = self.action_tensor
        for name in ("low", "high") if self.action["kind"] == "box" else ():
            bound = self.action[name]
            if len(bound) != math.prod(action.shape) or not all(isinstance(value, (int, float)) for value in bound):
                raise PolicyError(f"action: {name}: expected a number for each of shape {action.shape}.")

    @property
    def tensors(self) -> dict[str, Tensor]:
        """Observations by the name of the input."""
        return {name: Tensor.from_dict(value) for name, value in self.inputs.items()}

    @property
    def action_tensor(self) -> Tensor:
        """Shape and type of the action."""
        if self.action.get("kind") not in ("box", "discrete", "multidiscrete", "multibinary"):
            raise PolicyError(f"action: unknown kind {self.action.get('kind')!r:.40}.")
        return Tensor.from_dict({name: self.action.get(name) for name in ("shape", "dtype")})

    def check_config(self) -> None:
        """Refuse a configuration that names code or files, asks for too much, or has another meaning here.

        Raises:
            PolicyError: The message gives the reason.
            ValueError: A value is invalid.
        """
        unknown = [
            wrapper.get("name") for wrapper in self.wrappers if wrapper.get("name") not in ("ShapeGoal", "PointReward")
        ]
        if unknown:
            raise PolicyError(f"wrappers: expected ShapeGoal and PointReward, got {unknown[0]!r:.40}.")
        _check_values([self.config, *self.wrappers], "config")
        here = None
        if self.config is not None:
            with without_plugins():
                given = {name: value for name, value in self.config.items() if name not in ("features", "workspace")}
                config, features = DetectorConfig.from_dict(given), self.features
            if config.code_paths:
                raise PolicyError(f"config: the segmentation is code to import, {config.code_paths[0]!r:.100}.")
            points = sum(shape.layout.size for shape in config.shapes)
            if len(config.shapes) > _MOST_SHAPES or points > _MOST_POINTS or len(features) > _MOST_FEATURES:
                most = f"{_MOST_SHAPES} shapes, {_MOST_POINTS} points and {_MOST_FEATURES} features"
                raise PolicyError(f"config: expected at most {most}.")
            here = schema_hash(self.config)
        if here != self.schema:
            raise PolicyError(
                f"its features mean something else here: the hash of their schema is {str(here)[:12]}..., recorded was "
                f"{str(self.schema)[:12]}... Use the version of shape-obs that saved it."
            )

    @property
    def features(self) -> list[Feature]:
        """Features of each shape, in the order of the observation; empty if the policy reads no shapes."""
        return read_features((self.config or {}).get("features", ()))

    @property
    def needs_goal(self) -> bool:
        """Whether the policy reads a goal."""
        keys = {tensor.key for tensor in self.tensors.values()}
        return "desired_goal" in keys or any(wrapper["name"] == "ShapeGoal" for wrapper in self.wrappers)

    @property
    def has_goal(self) -> bool:
        """Whether the policy was trained for a single goal, which the file holds."""
        return any((wrapper.get("kwargs") or {}).get("goal") is not None for wrapper in self.wrappers)


def _check_values(value: Any, name: str) -> None:
    """Refuse numbers beyond their limits, long texts, and files, in JSON values."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            if key == "file" and inner is not None:
                raise PolicyError(f"config: a feature reads the file {inner!r:.100}, which a policy cannot hold.")
            _check_values(inner, str(key))
    elif isinstance(value, (list, tuple)):
        for inner in value:
            _check_values(inner, name)
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        most = _MOST.get(name, _MOST_NUMBER)
        if not abs(value) <= most:
            raise PolicyError(f"config: {name} is {value!r:.40}, expected a finite number up to {most:g}.")
    elif isinstance(value, str) and len(value) > _MOST_TEXT:
        raise PolicyError(f"config: {name}: expected a text of at most {_MOST_TEXT} characters.")


# ---- The environment of a training, and its differences from another one


def surroundings(env: gym.Env[Any, Any]) -> dict[str, Any]:
    """Return the fields of a ``Contract`` that describe an environment."""
    config = schema = image = None
    shapes = shape_observation(env)
    if shapes is not None:
        view = shapes.contexts[0]
        detector = _without_functions(shapes.detector.config)
        config = {**detector.to_dict(), "features": [feature.to_dict() for feature in shapes.features]}
        if view.workspace is not None:
            config["workspace"] = to_recorded(view.workspace)
        schema, image = schema_hash(config), (view.width, view.height)
    camera = camera_model(env) if shapes is None else shapes.contexts[0].camera
    robot = getattr(env.unwrapped, "robot", None)
    return {
        "dt": seconds_per_step(env),
        "inputs": observation_inputs(env.observation_space),
        "action": action_description(env.unwrapped.action_space),
        "config": config,
        "schema": schema,
        "image": image,
        "camera": None if camera is None else to_recorded(camera),
        "action_spec": published(env, "action_spec", getattr(robot, "action_spec", None)),
        "success_threshold": published(env.unwrapped, "success_threshold"),
    }


def _without_functions(config: DetectorConfig) -> DetectorConfig:
    """Leave out segmentations that are functions: each site has its own segmentation."""
    shapes = [
        replace(shape, segmentation=None) if isinstance(shape.segmentation, MaskFunction) else shape
        for shape in config.shapes
    ]
    own = None if isinstance(config.segmentation, MaskFunction) else config.segmentation
    return replace(config, shapes=tuple(shapes), segmentation=own)


def shape_observation(env: gym.Env[Any, Any]) -> ShapeObservation | None:
    """Return the outermost ``ShapeObservation`` of an environment; None if it has none."""
    inner: Any = env
    while not isinstance(inner, ShapeObservation):
        if inner is inner.unwrapped:
            return None
        inner = inner.env
    return inner


def observation_inputs(space: Any) -> dict[str, Any]:
    """Describe an observation space as the inputs of a network.

    Raises:
        PolicyError: A part is no array of fixed shape.
    """
    inner = getattr(space, "spaces", None)
    parts = inner if isinstance(inner, Mapping) else {"": space}
    described = {}
    for key, part in parts.items():
        if part.shape is None or part.dtype is None or str(part.dtype) not in _DTYPES:
            raise PolicyError(f"expected observations of arrays, got {key or 'an observation'} of {part}.")
        name = re.sub(r"\W", "_", key) or "observation"
        described[name] = Tensor(tuple(part.shape), str(part.dtype), key).to_dict()
    if len(described) < len(parts):
        raise PolicyError(f"expected keys that differ in letters and numbers, got {list(parts)}.")
    return described


def action_description(space: Any) -> dict[str, Any]:
    """Describe an action space as JSON values.

    Raises:
        PolicyError: It is neither of ``Box``, ``Discrete``, ``MultiDiscrete`` and ``MultiBinary``.
    """
    kind = type(space).__name__.lower()
    if kind not in ("box", "discrete", "multidiscrete", "multibinary"):
        raise PolicyError(f"expected an action space of Box, Discrete, MultiDiscrete or MultiBinary, got {space}.")
    bounds = {name: to_plain(getattr(space, name).ravel()) for name in ("low", "high")} if kind == "box" else {}
    start = {"n": int(space.n), "start": int(space.start)} if kind == "discrete" else {}
    return {"kind": kind, "shape": list(space.shape), "dtype": str(space.dtype), **bounds, **start}


Difference = tuple[str, Any, Any]
_ACTION: Final = ("names", "units", "scale", "mode", "frame")


def differences(trained: Contract, here: Mapping[str, Any], *, same_rate: bool = True) -> list[Difference]:
    """Return where an environment differs for a policy from that of its training, as (place, trained, here).

    Colours, regions of interest, workspaces and the pose of the camera may differ from site to site.

    Args:
        trained: The policy.
        here: The environment, as ``surroundings`` describes it.
        same_rate: Whether the duration of a step must be the same.
    """
    found: list[Difference] = []
    if trained.config is not None and here["config"] is not None:
        found += _walk(hashed_values(trained.config), hashed_values(here["config"]), "")
    elif (trained.config is None) != (here["config"] is None):
        found.append(("ShapeObservation", trained.config is not None, here["config"] is not None))
    if any(feature.unit == "px" for feature in trained.features) and trained.image != here["image"]:
        found.append(("image size [px]", trained.image, here["image"]))
    found += _of_inputs(trained.inputs, here["inputs"])
    found += _of_actions(trained.action_spec, here["action_spec"])
    if same_rate and abs(trained.dt - here["dt"]) > 1e-3 * trained.dt:
        found.append(("dt [s]", round(trained.dt, 6), round(here["dt"], 6)))
    return found


def format_differences(found: Sequence[Difference]) -> str:
    """Return all differences in one line."""
    return "; ".join(f"{place}: {one!r} in training, {other!r} here" for place, one, other in found)


def _of_inputs(trained: Mapping[str, Any], here: Mapping[str, Any]) -> Iterator[Difference]:
    one, other = ({value["key"]: value for value in side.values()} for side in (trained, here))
    if one.keys() != other.keys():
        yield "observation keys", sorted(one), sorted(other)
        return
    for key, value in one.items():
        for name in ("shape", "dtype"):
            if to_plain(value[name]) != to_plain(other[key][name]):
                where = f"observation {key!r}" if key else "observation"
                yield f"{where} {name}", to_plain(value[name]), to_plain(other[key][name])


def _of_actions(trained: ActionSpec | None, here: ActionSpec | None) -> Iterator[Difference]:
    if trained is None or here is None:
        if trained is not here:
            yield "known action_spec", trained is not None, here is not None
        return
    one, other = trained.to_dict(), here.to_dict()
    yield from ((f"action {name}", one[name], other[name]) for name in _ACTION if one[name] != other[name])


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
