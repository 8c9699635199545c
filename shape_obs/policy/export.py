"""Save a trained policy as a graph of ONNX, a contract, and a replay of the learner's actions."""

from __future__ import annotations

import hashlib
import io
import os
import platform
import re
import secrets
import shutil
import warnings
import zipfile
from collections.abc import Mapping, Sequence
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from shape_obs.policy.contract import Contract, PolicyError, surroundings
from shape_obs.policy.policy import CONTRACT, NETWORK, REPLAY, TOLERANCE, policy_from
from shape_obs.robot import ActionSpec
from shape_obs.spec import to_plain
from shape_obs.training import PointReward
from shape_obs.utils.documents import dump_yaml
from shape_obs.utils.files import write_whole
from shape_obs.wrappers import ShapeGoal, ShapeObservation

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

    from shape_obs.policy.stages import Stage

Array = npt.NDArray[Any]

#: Steps of the replay, in two episodes.
_REPLAYED: Final = 64
#: Largest difference from the learner's actions when a policy without images is saved, as a share of their range.
_TOLERANCE: Final = 2e-5
_PACKAGES: Final = ("shape-obs", "stable-baselines3", "sb3-contrib", "torch", "onnx", "gymnasium", "numpy", "mujoco")
#: Wrappers that leave observations and actions alone.
_TRANSPARENT: Final = (
    "TimeLimit", "OrderEnforcing", "PassiveEnvChecker", "Autoreset", "RecordEpisodeStatistics", "RecordVideo",
    "HumanRendering", "ClipReward", "NormalizeReward", "TransformReward", "Monitor", "Curriculum", "ActionMasker",
)  # fmt: skip
_TRANSPARENT_VECTOR: Final = ("VecMonitor", "VecCheckNan", "VecVideoRecorder")
_SIMULATION_ONLY: Final = {
    "TrueState": "it reads the simulator's state, which no camera can measure",
    "Pixels": "its goals come from the simulator's state, and it reads the images of one camera",
    "Shuffled": "its points are shuffled for comparison",
}
_ROBOT_KEYS: Final = ("rgb", "depth", "robot")
#: Names of attributes in which wrappers keep statistics, such as "obs_rms", "running_mean" and "std".
_STATISTIC: Final = re.compile(r"(^|_)(mean|average|avg|var|variance|std|m2|rms|stats)(_|$)")


def save_policy(
    model: BaseAlgorithm,
    env: Any,
    path: str | os.PathLike[str],
    *,
    summary: Mapping[str, Any] | None = None,
    action_spec: ActionSpec | None = None,
) -> None:
    """Write a trained policy of Stable-Baselines3 or sb3-contrib, completely or not at all.

    The wrappers of the training that change observations or actions become part of the network, with the statistics
    that they have now. Network and learner then act on the same observations, and their actions are compared. What is
    saved can't be trained further; keep the learner's own checkpoint for that.

    Args:
        model: Trained model.
        env: Environment of the training: a vector environment or a Gymnasium environment.
        path: File to write, such as ``"cable.policy"``, a zip file; without a suffix, a folder.
        summary: Further JSON values to record about the training.
        action_spec: Meaning of an action of 1, for an environment that does not publish it.

    Raises:
        PolicyError: A wrapper or the policy cannot be exported, or its network does not compute the learner's actions.
        OSError: The file cannot be written.

    Warns:
        UserWarning: A wrapper is there whose effect on a robot is unknown. The message names it.

    Example:
        >>> save_policy(model, model.get_env(), "cable.policy")  # doctest: +SKIP
    """
    from shape_obs.policy.learners import export, head_of

    outer, stages = _vector_stages(model, env)
    source, inner, changes = _stages(outer, copied=_is_copy(env))
    stages = [*inner, *stages]
    head = head_of(model)
    network, states = export(model, source, stages, head, [graph for graph, _ in changes])
    counts = {"algorithm": type(model).__name__, "steps": int(model.num_timesteps), "seed": model.seed}
    around = surroundings(source)
    spec = {
        **around,
        "action_spec": action_spec or around["action_spec"],
        "states": states,
        "mask": head.mask,
        "wrappers": _own_wrappers(source),
        "obstacle": _obstacle(source),
        "trained": {**counts, "env": _env_of(source), "versions": _versions(), **(summary or {})},
    }
    if unknown := _unknown(source):
        warnings.warn(f"the policy will run in a simulator only: {unknown}.", UserWarning, stacklevel=2)
    replay = _play(model, source, stages, [own for _, own in changes], head.mask)
    _write(Path(path), network, Contract.from_dict(to_plain(spec)), replay)


def save_policy_onnx(
    path: str | os.PathLike[str],
    network: bytes | str | os.PathLike[str],
    env: gym.Env[Any, Any],
    observations: Sequence[Any],
    actions: npt.ArrayLike,
    *,
    states: Mapping[str, str] | None = None,
    starts: Sequence[bool] | None = None,
    action_spec: ActionSpec | None = None,
    summary: Mapping[str, Any] | None = None,
) -> None:
    """Write a trained policy of any learner, from its own file of ONNX, completely or not at all.

    The network maps observations with a first axis of 1 to the action, with normalisation, squashing, scaling and
    clipping inside. Its input is the observation, or has the name of a key for each key of it.

    Args:
        path: File to write, such as ``"cable.policy"``, a zip file; without a suffix, a folder.
        network: The file of ONNX, or its content.
        env: Environment of the training, whose observations the network reads and whose actions it returns.
        observations: At least 32 observations, one after the other.
        actions: The actions that the learner itself computed for them.
        states: Of a recurrent network: the output that becomes an input in the next step, by the name of that input.
        starts: Of a recurrent network: whether an episode starts with an observation. Default: with the first one only.
        action_spec: Meaning of an action of 1, for an environment that does not publish it.
        summary: JSON values to record about the training.

    Raises:
        PolicyError: The network is refused, or does not compute these actions.
        OSError: A file cannot be read or written.
    """
    import onnx

    from shape_obs.policy.graph_check import check_graph

    data = network if isinstance(network, bytes) else Path(network).read_bytes()
    graph = onnx.shape_inference.infer_shapes(check_graph(data)).graph
    carried = dict(states or {})
    known = {value.name: value.type.tensor_type for value in graph.input}
    missing = [name for name in carried if name not in known]
    if missing:
        raise PolicyError(f"states: the network has no input {missing[0]!r}; it has {', '.join(known)}.")
    around = surroundings(env)
    inputs, names = around["inputs"], [name for name in known if name not in carried]
    if list(inputs) == ["observation"] and not inputs["observation"]["key"] and len(names) == 1:
        inputs = {names[0]: inputs["observation"]}
    described = {
        name: {
            "shape": [side.dim_value for side in known[name].shape.dim],
            "dtype": str(np.dtype(onnx.helper.tensor_dtype_to_np_dtype(known[name].elem_type))),
            "output": output,
        }
        for name, output in carried.items()
    }
    results = [value.name for value in graph.output if value.name not in carried.values()]
    spec = {
        **around,
        "inputs": inputs,
        "action_spec": action_spec or around["action_spec"],
        "output": results[0] if results else "action",
        "states": described,
        "wrappers": _own_wrappers(env),
        "obstacle": _obstacle(env),
        "trained": {"env": _env_of(env), "versions": _versions(), **(summary or {})},
    }
    start = np.zeros(len(observations), bool) if starts is None else np.asarray(starts, bool)
    start[:1] = True
    replay = _columns(observations) | {"action": np.asarray(actions), "start": start}
    _write(Path(path), data, Contract.from_dict(to_plain(spec)), replay)


# ---- The wrappers of a training


def _vector_stages(model: BaseAlgorithm, env: Any) -> tuple[gym.Env[Any, Any], list[Stage]]:
    """Return the first environment of a vector environment, and the wrappers around it as stages, innermost first."""
    from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

    from shape_obs.policy.stages import stage_of

    stages: list[Stage] = []
    vector: Any = env
    if not isinstance(env, VecEnv):
        normalize = model.get_vec_normalize_env()
        return env, [stage for stage in (stage_of(normalize),) if stage is not None]
    while isinstance(vector, VecEnvWrapper):
        stage = stage_of(vector)
        if stage is not None:
            stages.insert(0, stage)
        elif type(vector).__name__ not in _TRANSPARENT_VECTOR:
            raise PolicyError(
                f"a policy cannot hold how {type(vector).__name__} changes observations; it can hold VecNormalize, "
                "VecFrameStack and VecTransposeImage."
            )
        vector = vector.venv
    if hasattr(vector, "envs"):
        return vector.envs[0], stages
    spec = vector.get_attr("spec")[0]
    if spec is None:
        raise PolicyError("the environment runs in other processes and has no spec: make it with gymnasium.make.")
    return gym.make(spec, disable_env_checker=True), stages


def _is_copy(env: Any) -> bool:
    """Return whether the first environment does not stand for all that were trained in."""
    return getattr(env, "num_envs", 1) > 1


def _stages(env: gym.Env[Any, Any], copied: bool) -> tuple[gym.Env[Any, Any], list[Stage], list[Any]]:
    """Return the environment whose observations the network reads, the stages around it, and the changes of actions.

    Raises:
        PolicyError: A wrapper has a state, or changes actions, in a way that a policy cannot hold.
    """
    from shape_obs.policy.stages import action_stage, stage_of

    stages: list[Stage] = []
    changes: list[Any] = []
    source: gym.Env[Any, Any] | None = None
    inner: Any = env
    while isinstance(inner, gym.Wrapper):
        name = type(inner).__name__
        change = action_stage(inner)
        stage = stage_of(inner) if source is None and change is None else None
        if stage is not None:
            if copied and stage.moments:
                raise PolicyError(
                    f"{name}: each of several environments has its own statistics: normalise with VecNormalize."
                )
            stages.insert(0, stage)
        elif change is not None:
            own: Any = inner
            changes.insert(0, (change, own.action))
        elif isinstance(inner, gym.ActionWrapper):
            raise PolicyError(
                f"a policy cannot hold how {name} changes actions; it can hold RescaleAction and ClipAction."
            )
        elif name not in _TRANSPARENT:
            source = source or inner
            _refuse_statistics(inner)
        inner = inner.env
    return source or inner, stages, changes


def _refuse_statistics(wrapper: Any) -> None:
    for name, value in vars(wrapper).items():
        counted = all(hasattr(value, part) for part in ("mean", "var", "count"))
        numbers = isinstance(value, (float, np.ndarray)) and _STATISTIC.search(name.lower()) is not None
        if (counted or numbers) and not isinstance(wrapper, gym.RewardWrapper):
            raise PolicyError(
                f"a policy cannot hold the statistics that the wrapper {type(wrapper).__name__} keeps in {name!r}: "
                "normalise with VecNormalize of Stable-Baselines3 or NormalizeObservation of Gymnasium, outermost."
            )


def _chain(env: gym.Env[Any, Any]) -> list[gym.Wrapper[Any, Any, Any, Any]]:
    """Return the wrappers of an environment, the innermost first, without those that leave observations alone."""
    found: list[Any] = []
    inner: Any = env
    while isinstance(inner, gym.Wrapper):
        if type(inner).__name__ not in _TRANSPARENT and not isinstance(inner, gym.ActionWrapper):
            found.insert(0, inner)
        inner = inner.env
    return found


def _around_shapes(env: gym.Env[Any, Any]) -> list[Any] | None:
    """Return the wrappers around the outermost ``ShapeObservation``; None if there is none."""
    chain = _chain(env)
    at = [i for i, wrapper in enumerate(chain) if isinstance(wrapper, ShapeObservation)]
    return chain[at[-1] + 1 :] if at else None


def _own_wrappers(env: gym.Env[Any, Any]) -> list[dict[str, Any]]:
    """Describe the wrappers ``ShapeGoal`` and ``PointReward``."""
    own = [wrapper for wrapper in _around_shapes(env) or () if isinstance(wrapper, (ShapeGoal, PointReward))]
    return [{"name": type(wrapper).__name__, "kwargs": to_plain(wrapper._saved_kwargs)} for wrapper in own]


def _unknown(env: gym.Env[Any, Any]) -> str:
    """Return which wrapper around the ``ShapeObservation`` has an unknown effect on a robot; ``""`` if none has."""
    names = [type(wrapper).__name__ for wrapper in _around_shapes(env) or ()]
    unknown = [name for name in names if name not in ("ShapeGoal", "PointReward", *_SIMULATION_ONLY)]
    return f"it is not known what the wrapper {unknown[0]} does on a robot" if unknown else ""


def _obstacle(env: gym.Env[Any, Any]) -> str:
    """Return why a policy that was trained in this environment cannot run with a camera; ``""`` if it can."""
    chain = _chain(env)
    for wrapper in chain:
        name = type(wrapper).__name__
        if name in _SIMULATION_ONLY:
            return f"{_SIMULATION_ONLY[name]} ({name})"
    shapes = next((wrapper for wrapper in reversed(chain) if isinstance(wrapper, ShapeObservation)), None)
    if shapes is None:
        return "it does not read shapes: there is no ShapeObservation in its environment"
    missing = [key for key in (shapes._saved_kwargs.get("keep") or ()) if key not in _ROBOT_KEYS]
    if missing:
        return f"it also reads {', '.join(missing)}, which only its simulator provides (keep)"
    return _unknown(env)


def _env_of(env: gym.Env[Any, Any]) -> dict[str, Any] | None:
    """Return id, arguments and length of episodes of an environment, for the record."""
    spec = env.spec
    if spec is None:
        return None
    plain = {
        name: value for name, value in spec.kwargs.items() if isinstance(value, (str, int, float, bool, list, tuple))
    }
    return {"id": spec.id, "kwargs": to_plain(plain), "max_episode_steps": spec.max_episode_steps}


def _versions() -> dict[str, str]:
    known = {name: metadata.version(name) for name in _PACKAGES if find_spec(name.replace("-", "_")) is not None}
    return {"python": platform.python_version(), **known}


# ---- The replay


def _play(
    model: BaseAlgorithm, source: Any, stages: Sequence[Stage], changes: Sequence[Any], mask: int | None
) -> dict[str, Array]:
    """Return observations, and the actions that the learner itself computes for them behind its own wrappers."""
    random = np.random.default_rng(0)
    moments = stages[0].moments if stages else {}
    from shape_obs.policy.stages import spaces_by_key

    spaces = spaces_by_key(source.observation_space)
    observations, actions, masks, state = [], [], [], None
    starts = np.arange(_REPLAYED) % (_REPLAYED // 2) == 0
    for start in starts:
        values = {key: _drawn(space, random, moments.get(key)) for key, space in spaces.items()}
        seen = observation = values.get("", values)
        for stage in stages:
            seen = stage.own(seen, bool(start))
        options: dict[str, Any] = {}
        if mask is not None:
            masks.append(np.append(random.random(mask - 1) < 0.7, True))  # at least one action is allowed
            options["action_masks"] = masks[-1]
        action, state = model.predict(seen, state=state, episode_start=np.array([start]), deterministic=True, **options)
        for change in reversed(changes):
            action = change(action)
        observations.append(observation)
        actions.append(action)
    return (
        _columns(observations)
        | {"action": np.asarray(actions), "start": starts}
        | ({"mask": np.asarray(masks)} if masks else {})
    )


def _drawn(space: Any, random: np.random.Generator, moments: Any) -> Array:
    """Draw a sample of a space: around the mean of the training if it is known, else around the middle."""
    if not isinstance(space, gym.spaces.Box):
        space.seed(int(random.integers(2**31)))
        return np.asarray(space.sample())
    if space.dtype.kind in "iub":
        return random.integers(space.low, space.high, endpoint=True, dtype=space.dtype)
    low, high = space.low.astype(np.float64), space.high.astype(np.float64)
    bounded = np.isfinite(low) & np.isfinite(high)
    middle = np.where(bounded, (low + high) / 2, np.clip(0, low, high))
    spread = np.where(bounded, (high - low) / 2, 1.0) * random.uniform(0.02, 1)
    if moments is not None and np.shape(moments[0]) == space.shape:
        middle, spread = moments
    return np.clip(middle + spread * np.clip(random.standard_normal(space.shape), -1, 1), low, high).astype(space.dtype)


def _columns(observations: Sequence[Any]) -> dict[str, Array]:
    """Return the arrays of a replay for observations."""
    if isinstance(observations[0], Mapping):
        return {f"observation/{key}": np.stack([seen[key] for seen in observations]) for key in observations[0]}
    return {"observation": np.stack(observations)}


# ---- The files


def _write(path: Path, network: bytes, spec: Contract, replay: Mapping[str, Array]) -> None:
    """Check a policy and write it: a folder if the path has no suffix, else a zip file."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **replay)  # type: ignore[arg-type]
    members = {NETWORK: network, REPLAY: buffer.getvalue()}
    hashes = {name: hashlib.sha256(data).hexdigest() for name, data in members.items()}
    members[CONTRACT] = dump_yaml({**spec.to_dict(), "sha256": hashes}).encode()
    images = any(tensor.dtype == "uint8" for tensor in spec.tensors.values())
    policy_from(members, TOLERANCE if images else _TOLERANCE)
    if path.suffix:
        write_whole(path, lambda temporary: _zip(temporary, members))
    else:
        _write_folder(path, members)


def _zip(path: Path, members: Mapping[str, bytes]) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            # A constant date, so that equal content gives equal files.
            archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), data, zipfile.ZIP_DEFLATED)


def _write_folder(path: Path, members: Mapping[str, bytes]) -> None:
    if path.exists() and (not path.is_dir() or {item.name for item in path.iterdir()} - members.keys()):
        raise FileExistsError(f"{path}: expected a new folder, or one that holds a policy.")
    temporary, old = (path.with_name(f".{path.name}.{secrets.token_hex(8)}") for _ in range(2))
    temporary.mkdir(parents=True)
    try:
        for name, data in members.items():
            write_whole(temporary / name, lambda file, data=data: file.write_bytes(data))
        if path.exists():
            path.rename(old)
        temporary.rename(path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)
