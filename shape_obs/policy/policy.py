"""Load a policy, and run it: on observations, in another environment, or in the deployment loop."""

from __future__ import annotations

import hashlib
import os
import shlex
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt
import onnxruntime
from onnx.helper import tensor_dtype_to_np_dtype

from shape_obs.config.config_file import SCENE_FIELDS, SECTIONS
from shape_obs.config.detector_config import ALGORITHM
from shape_obs.configurations.base import Configuration
from shape_obs.features import Points3D
from shape_obs.features.distribution import hold
from shape_obs.policy import graph_check
from shape_obs.policy.contract import Contract, PolicyError, Tensor, describe, differences
from shape_obs.robot import ActionSpec
from shape_obs.utils.arrays import decode_npz, open_zip
from shape_obs.utils.documents import parse_yaml
from shape_obs.wrappers import ShapeGoal, ShapeObservation, env_protocol

if TYPE_CHECKING:
    import gymnasium as gym

Array = npt.NDArray[Any]
NETWORK, CONTRACT, REPLAY = "policy.onnx", "policy.yaml", "replay.npz"
MASK: Final = "action_mask"
#: Names of the arrays of the replay with the contents of fitted files begin so.
FITTED: Final = "fitted/"
#: Largest size of each file in bytes. PyYAML reads about 60 kB a second.
_MOST_BYTES: Final = {NETWORK: graph_check.MOST_BYTES, CONTRACT: 64 << 10, REPLAY: 32 << 20}
_LEAST_REPLAYED, _MOST_REPLAYED = 32, 1024
#: Work of a replay in multiplications, half a second: of a large network only the first steps are replayed.
_REPLAY_WORK: Final = 1e10
#: Largest difference of a replayed action, as a share of the range of actions: processors round differently.
TOLERANCE: Final = 1e-4
#: Share of replayed discrete actions that may differ: where two actions are nearly equal, rounding decides.
_TIES: Final = 1 / 32

_ROBOT: Final = "shape_obs_envs.robots:SimulatedRobot"
_DEFAULT_ENV: Final = "ShapeObs/Cable-v0"  # of the simulated robot
#: Arguments of an environment that change its actions or goals; others are about its camera and its training.
_SAME_TASK: Final = ("grippers", "rope", "ropes", "step")


def load_policy(path: str | os.PathLike[str]) -> Policy:
    """Read a policy that ``save_policy`` wrote; no code from the file runs, now or later.

    The recorded observations are replayed: the network must return the actions that the learner computed for them.

    Args:
        path: The folder, or a zip file of it.

    Raises:
        FileNotFoundError: There is no such file.
        PolicyError: The file is not a policy, is damaged or changed, or too large, its network may do more than
            compute, its features have another meaning here, or its actions are not those of the learner.

    Warns:
        UserWarning: The detector's algorithm has another version than in training.

    Example:
        >>> action = load_policy("cable.policy").act(observation)  # doctest: +SKIP
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such policy")
    with refusing(f"{path}: "):
        policy = policy_from(_read(path))
    trained = policy.spec.detector_version
    if policy.spec.config is not None and trained != ALGORITHM:
        warnings.warn(
            f"{path}: it was trained on the points of version {trained} of the detector's algorithm, this is version "
            f"{ALGORITHM}: equal images may give slightly other points. Evaluate it again before use.",
            UserWarning,
            stacklevel=2,
        )
    return policy


@contextmanager
def refusing(where: str = "") -> Iterator[None]:
    """Raise ``PolicyError`` for all that the readers of zip files, YAML, arrays and ONNX raise on hostile content."""
    try:
        yield
    except PolicyError as error:
        raise PolicyError(f"{where}{error}") from error
    except Exception as error:
        raise PolicyError(f"{where}not a policy, or a damaged one: {type(error).__name__}: {error!s:.500}") from error


def _read(path: Path) -> dict[str, bytes]:
    """Return the content of the three files of a policy, from a folder or a zip file."""
    if path.is_dir():
        files = [file for file in path.iterdir() if file.name in _MOST_BYTES and file.is_file()]
        _check_sizes([(file.name, file.stat().st_size) for file in files])
        return {file.name: file.read_bytes() for file in files}
    if not path.is_file() or path.stat().st_size > sum(_MOST_BYTES.values()):
        raise PolicyError(f"expected a folder, or a file of at most {sum(_MOST_BYTES.values())} bytes.")
    with path.open("rb") as file, open_zip(file) as archive:
        _check_sizes([(info.filename, info.file_size) for info in archive.infolist()])
        return {name: archive.read(name) for name in _MOST_BYTES}


def _check_sizes(found: Sequence[tuple[str, int]]) -> None:
    names = sorted(name for name, _ in found)
    if names != sorted(_MOST_BYTES):
        raise PolicyError(f"expected {', '.join(_MOST_BYTES)}, got {', '.join(names)[:200]!r}.")
    for name, size in found:
        if size > _MOST_BYTES[name]:
            raise PolicyError(f"{name}: expected at most {_MOST_BYTES[name]} bytes, got {size}.")


def policy_from(members: Mapping[str, bytes], tolerance: float = TOLERANCE) -> Policy:
    """Create a policy from the content of its three files, after the checks of ``load_policy``."""
    with refusing():
        _check_sizes([(name, len(data)) for name, data in members.items()])
        spec = Contract.from_dict(parse_yaml(members[CONTRACT], CONTRACT))
        for name in (NETWORK, REPLAY):
            if spec.sha256.get(name) != hashlib.sha256(members[name]).hexdigest():
                raise PolicyError(f"{name} was changed, or is damaged: its content is not that of {CONTRACT}.")
        replay = decode_npz(members[REPLAY], REPLAY, most_bytes=_MOST_BYTES[REPLAY])
        for name, content in replay.items():
            if name.startswith(FITTED):
                hold(content.tobytes())
        spec.check_config()
        policy = Policy(spec, members[NETWORK])
        _check_replay(policy, replay, tolerance)
        return policy


class Policy:
    """A trained policy; ``load_policy`` returns it. It is a ``Controller`` for ``shape_obs.deploy.deploy``.

    It can act but not be trained further: keep the learner's own checkpoint for that.

    Args:
        spec: Description of the policy.
        network: Content of ``policy.onnx``.

    Attributes:
        spec: As given.
        same_rate: Whether ``attach`` refuses a loop whose rate differs from that of the training.
        replayed: Number of recorded steps that are replayed at most, which takes half a second.
    """

    spec: Contract
    same_rate: bool = True
    replayed: int

    def __init__(self, spec: Contract, network: bytes) -> None:
        self.spec = spec
        model, work = graph_check.check_graph(network)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4
        data = model.SerializeToString()
        self._session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
        inputs = {value.name: tuple(value.shape) for value in self._session.get_inputs()}
        outputs = {value.name: tuple(value.shape) for value in self._session.get_outputs()}
        wanted = {name: (1, *tensor.shape) for name, tensor in spec.inputs.items()}
        wanted |= {MASK: (1, spec.mask)} if spec.mask else {}
        wanted |= {name: outputs.get(output) for name, output in spec.states.items()}
        if inputs != wanted:
            raise PolicyError(f"{NETWORK}: expected the inputs {wanted}, got {inputs}.")
        if outputs.get(spec.output) != (1, *spec.action.shape):
            raise PolicyError(f"{NETWORK}: expected the output {spec.output!r} as {spec.action.shape}, got {outputs}.")
        kinds = {value.name: value.type.tensor_type.elem_type for value in model.graph.input}
        self._dtypes = {name: tensor_dtype_to_np_dtype(kind) for name, kind in kinds.items()}
        self.replayed = max(_LEAST_REPLAYED, int(_REPLAY_WORK / max(work, 1)))
        self._zeros = {name: np.zeros(inputs[name], self._dtypes[name]) for name in spec.states}
        self.reset()

    @property
    def action_spec(self) -> ActionSpec | None:
        """Meaning of its actions; ``shape_obs.deploy.deploy`` compares it with the robot's. None if unknown."""
        return self.spec.action_spec

    def reset(self) -> None:
        """Start an episode: forget earlier observations, if the policy remembers any."""
        self._states = self._zeros

    def act(self, observation: Any, action_mask: npt.ArrayLike | None = None) -> Any:
        """Return the deterministic action for an observation.

        Args:
            observation: Observation as in training: an array, or arrays by key.
            action_mask: Of a policy that was trained with masks: True for each action that is allowed.

        Raises:
            PolicyError: The observation has other keys or shapes, a mask is missing, or the action is not finite.
        """
        feed = dict(self._states)
        for name, tensor in self.spec.inputs.items():
            value = observation.get(name) if isinstance(observation, Mapping) else observation
            array = np.asarray(value, self._dtypes[name])
            if array.shape != tensor.shape:
                raise PolicyError(f"{name}: expected shape {tensor.shape} as in training, got {array.shape}.")
            feed[name] = array[None]
        if (action_mask is None) != (self.spec.mask is None):
            raise PolicyError(f"action_mask: expected {self.spec.mask or 'no'} values, as in training.")
        if action_mask is not None:
            feed[MASK] = np.asarray(action_mask, bool).reshape(1, -1)
        names = [self.spec.output, *(self.spec.states[name] for name in self._states)]
        actions, *following = self._session.run(names, feed)
        self._states = dict(zip(self._states, following, strict=True))
        action: Any = np.asarray(actions)[0]
        if not np.isfinite(action).all():
            raise PolicyError("the policy returned an action that is not finite.")
        return action

    # ---- Other environments

    def wrap(
        self, env: gym.Env[Any, Any], goal: Any = None, scene: Mapping[str, Any] | None = None
    ) -> gym.Env[Any, Any]:
        """Wrap an environment, usually a camera and a robot, so that the policy can read its observations.

        If the environment of the training had its own goals, a ``ShapeGoal`` provides them here.

        Args:
            env: Environment with images and a camera, and without goals.
            goal: Goal, as for ``ShapeGoal``; None if the goal is given at each reset, or the policy has no goals.
            scene: Arguments of ``ShapeObservation`` that are specific to this site: ``segmentation``, ``roi``,
                ``workspace``, and the ``runtime`` section.

        Raises:
            PolicyError: The policy cannot run with a camera, or was given a goal but has none.
            ValueError: The environment or the scene do not fit.
        """
        self.check_deployable()
        camera = env_protocol.camera_model(env)
        if camera is None or camera.transform_camera_to_base is None:
            for feature in self.spec.features:
                if getattr(getattr(feature, "coordinates", None), "frame", None) == "base":
                    reads = f"the policy reads {feature.kind!r} in the base frame, but this camera has no extrinsics"
                    raise PolicyError(f"{reads}: give --extrinsics FILE, as `shape-obs calibrate base` writes it.")
        if goal is not None and not self.spec.needs_goal:
            raise PolicyError("the policy was trained without goals, so it cannot be given one.")
        config = dict(self.spec.config or {})
        shape = {name: config[name] for name in SECTIONS["shape"] if name in config}
        running = {name: config[name] for name in SECTIONS["runtime"] if name in config and name != "dt"}
        known = env_protocol.published(env, "shape_obs_defaults", {})
        known = {name: known[name] for name in ("shapes", *SECTIONS["scene"]) if name in known}
        local = {"workspace": config.get("workspace"), **running, **known, **(scene or {})}
        source = ShapeObservation(env, **{**local, **_site_fields(shape, local)})
        wrapped: Any = source
        if self.spec.needs_goal and all(wrapper["name"] != "ShapeGoal" for wrapper in self.spec.wrappers):
            points = next((feature for feature in self.spec.features if isinstance(feature, Points3D)), None)
            if points is None:
                raise PolicyError("the policy has goals of points in metres, but it reads no feature 'points3d'.")
            size = self.spec.inputs["desired_goal"].shape[0]
            names, reached = _first_shapes(source.detector.shapes, size), self.spec.success_threshold or 0.01
            wrapped = ShapeGoal(wrapped, goal, [points], shape=names, reward_type="sparse", threshold=reached)
        for wrapper in self.spec.wrappers:
            arguments = dict(wrapper.get("kwargs") or {})
            if wrapper["name"] == "ShapeGoal":
                wrapped = ShapeGoal(wrapped, **{**arguments, **({} if goal is None else {"goal": goal})})
            else:
                from shape_obs.training.point_reward import PointReward

                wrapped = PointReward(wrapped, **arguments)
        return wrapped

    def check_env(self, env: gym.Env[Any, Any], *, same_rate: bool = True) -> None:
        """Refuse an environment whose observations or actions differ from those of the training.

        Colours, regions of interest, workspaces and the pose of the camera may differ.

        Raises:
            PolicyError: The environment differs. The message names each difference.
        """
        found = differences(self.spec, describe(env), same_rate=same_rate)
        if found:
            named = "; ".join(f"{place}: {one!r} in training, {other!r} here" for place, one, other in found)
            raise PolicyError(f"the policy does not fit this environment: {named}.")

    def check_deployable(self) -> None:
        """Raise ``PolicyError`` if the policy cannot run with a camera and a robot."""
        unknown = "it was saved without action_spec, the meaning of its actions: save it with action_spec="
        reason = self.spec.obstacle or (unknown if self.action_spec is None else "")
        if reason:
            raise PolicyError(f"the policy cannot be deployed: {reason}.")

    def attach(self, env: Any) -> None:
        """Compare the environment with that of the training; raises ``PolicyError`` if they differ."""
        self.check_env(env, same_rate=self.same_rate)


def _check_replay(policy: Policy, replay: Mapping[str, Array], tolerance: float) -> None:
    """Refuse a policy whose actions differ by more than a share of their range from those that the learner computed."""
    inputs = {f"observation/{name}": name for name in policy.spec.inputs}
    needed = [*inputs, "action", "start", *(["mask"] if policy.spec.mask else [])]
    lengths = [len(np.atleast_1d(replay.get(name, ()))) for name in needed]
    if min(lengths) != max(lengths) or not _LEAST_REPLAYED <= lengths[0] <= _MOST_REPLAYED:
        raise PolicyError(f"{REPLAY}: expected {_LEAST_REPLAYED} to {_MOST_REPLAYED} steps of {', '.join(needed)}.")
    found = []
    for i in range(min(lengths[0], policy.replayed)):
        if replay["start"][i]:
            policy.reset()
        seen = {key: replay[name][i] for name, key in inputs.items()}
        action = policy.act(seen, replay["mask"][i] if policy.spec.mask else None)
        found.append(action_difference(policy.spec.action, action, replay["action"][i]))
    policy.reset()
    worst = int(np.argmax(found))
    ties = policy.spec.action.discrete and np.count_nonzero(found) <= _TIES * len(found)
    if not found[worst] <= tolerance and not ties:
        differs = f"action {worst} of {len(found)} differs by {found[worst]:.2g} of its range"
        raise PolicyError(f"the network does not compute what the learner did: {differs}.")


def action_difference(space: Tensor, action: npt.ArrayLike, other: npt.ArrayLike) -> float:
    """Return the largest difference of two actions, as a share of the range; 1 if discrete actions differ."""
    one, two = np.asarray(action), np.asarray(other)
    if one.shape != two.shape:
        return np.inf
    if space.discrete:
        return float(np.any(one != two))
    low, high = (np.reshape(np.asarray(side, np.float64), one.shape) for side in (space.low, space.high))
    span = np.where(np.isfinite(high - low), high - low, 2 * np.maximum(1, np.abs(two)))
    return float(np.max(np.abs(one.astype(np.float64) - two) / span, initial=0))


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


def deploy_command(path: str | os.PathLike[str]) -> str:
    """Return the ``shape-obs deploy`` command that tries a policy on a simulated robot, for a shell.

    Args:
        path: A policy, as ``save_policy`` writes it.

    Raises:
        PolicyError: The policy cannot run with a camera; the message gives the reason.
    """
    policy = load_policy(path)
    policy.check_deployable()
    trained = policy.spec.trained.get("env") or {}
    env = str(trained.get("id", "")).rpartition(":")[2]
    if not env.startswith("ShapeObs/"):
        raise PolicyError(f"{env} has no simulated robot here: run `shape-obs deploy {path} --robot module:Class`.")
    words = ["shape-obs", "deploy", str(path), "--source", "robot", "--robot", _ROBOT]
    task = {name: value for name, value in trained["kwargs"].items() if name in _SAME_TASK}
    settings = [f"{name}={value}" for name, value in ({"env": env} | task).items() if value != _DEFAULT_ENV]
    if settings:
        words += ["--robot-set", *settings]
    if policy.spec.needs_goal and not policy.spec.has_goal:
        words += ["--goal", "robot"]
    return shlex.join([*words, "--episodes", "20"])
