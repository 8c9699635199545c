"""Save a trained policy as a graph of ONNX, a contract, and a replay of the learner's actions."""

from __future__ import annotations

import hashlib
import io
import os
import platform
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from shape_obs.features.distribution import read_bytes
from shape_obs.policy.contract import ARRAY, Contract, describe
from shape_obs.policy.graph_check import check_graph
from shape_obs.policy.policy import CONTRACT, FITTED, MASK, NETWORK, REPLAY, TOLERANCE, policy_from, refusing
from shape_obs.robot import ActionSpec
from shape_obs.spec import to_plain
from shape_obs.utils.documents import dump_yaml
from shape_obs.utils.files import write_whole

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

#: Largest difference from the learner's actions when a policy without images is saved, as a share of their range:
#: twice what the tests of all algorithms allow, since these round on one kind of processor.
_TOLERANCE: Final = 2e-5
_PACKAGES: Final = ("shape-obs", "stable-baselines3", "sb3-contrib", "torch", "onnx", "gymnasium", "numpy", "mujoco")


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
        path: File to write, such as ``"cable.policy"``, a zip file.
        summary: Further JSON values to record about the training.
        action_spec: Meaning of an action of 1, for an environment that does not publish it.

    Raises:
        PolicyError: A wrapper or the policy cannot be exported, or its network does not compute the learner's actions.
        OSError: The file cannot be written.

    Example:
        >>> save_policy(model, model.get_env(), "cable.policy")  # doctest: +SKIP
    """
    from shape_obs.policy import learner

    source, network, played = learner.export(model, env)
    counts = {"algorithm": type(model).__name__, "steps": int(model.num_timesteps), "seed": model.seed}
    save_policy_onnx(path, network, source, **played, action_spec=action_spec, summary={**counts, **(summary or {})})


def save_policy_onnx(
    path: str | os.PathLike[str],
    network: bytes | str | os.PathLike[str],
    env: gym.Env[Any, Any],
    observations: Sequence[Any],
    actions: npt.ArrayLike,
    *,
    states: Mapping[str, str] | None = None,
    starts: npt.ArrayLike | None = None,
    masks: npt.ArrayLike | None = None,
    action_spec: ActionSpec | None = None,
    summary: Mapping[str, Any] | None = None,
) -> None:
    """Write a trained policy of any learner, from its own file of ONNX, completely or not at all.

    The network maps observations with a first axis of 1 to the action, with normalisation, squashing, scaling and
    clipping inside. Its input is the observation, or has the name of a key for each key of it.

    Args:
        path: File to write, such as ``"cable.policy"``, a zip file.
        network: The file of ONNX, or its content.
        env: Environment of the training, whose observations the network reads and whose actions it returns.
        observations: At least 32 observations, one after the other.
        actions: The actions that the learner itself computed for them.
        states: Of a recurrent network: the output that becomes an input in the next step, by the name of that input.
        starts: Of a recurrent network: whether an episode starts with an observation. Default: with the first one only.
        masks: Of a network with an input ``action_mask``: which actions are allowed, for each observation.
        action_spec: Meaning of an action of 1, for an environment that does not publish it.
        summary: JSON values to record about the training.

    Raises:
        PolicyError: The network is refused, or does not compute these actions.
        OSError: A file cannot be read or written.
    """
    data = network if isinstance(network, bytes) else Path(network).read_bytes()
    with refusing():
        graph = check_graph(data)[0].graph
    spec, known, carried = describe(env), [value.name for value in graph.input], dict(states or {})
    read = [name for name in known if name not in (*carried, MASK)]
    inputs = {read[0]: spec.inputs[ARRAY]} if list(spec.inputs) == [ARRAY] and len(read) == 1 else spec.inputs
    results = [value.name for value in graph.output if value.name not in carried.values()]
    start = np.arange(len(observations)) == 0 if starts is None else np.asarray(starts, bool)
    replay = {"action": np.asarray(actions), "start": start}
    for name in inputs:
        values = [one[name] if isinstance(one, Mapping) else one for one in observations]
        replay[f"observation/{name}"] = np.asarray(values)
    if masks is not None:
        replay["mask"] = np.asarray(masks, bool)
    made, kinds = env.spec, (str, int, float, bool, list, tuple)
    versions = {name: metadata.version(name) for name in _PACKAGES if find_spec(name.replace("-", "_")) is not None}
    record: dict[str, Any] = {"versions": {"python": platform.python_version(), **versions}, **(summary or {})}
    if made is not None:
        plain = {name: value for name, value in made.kwargs.items() if isinstance(value, kinds)}
        record["env"] = {"id": made.id, "kwargs": plain, "max_episode_steps": made.max_episode_steps}
    spec = replace(
        spec,
        inputs=inputs,
        output=results[0] if results else "action",
        states=carried,
        mask=replay["mask"].shape[1] if masks is not None else None,
        action_spec=action_spec or spec.action_spec,
        trained=to_plain(record),
    )
    _write(Path(path), data, spec, replay)


def _write(path: Path, network: bytes, spec: Contract, replay: Mapping[str, npt.NDArray[Any]]) -> None:
    """Check a policy and write it as a zip file."""
    buffer = io.BytesIO()
    fitted = {f"{FITTED}{i}": np.frombuffer(read_bytes(Path(name)), np.uint8) for i, name in enumerate(spec.fitted)}
    np.savez_compressed(buffer, allow_pickle=False, **replay, **fitted)  # type: ignore[arg-type]
    members = {NETWORK: network, REPLAY: buffer.getvalue()}
    hashes = {name: hashlib.sha256(data).hexdigest() for name, data in members.items()}
    members[CONTRACT] = dump_yaml({**spec.to_dict(), "sha256": hashes}).encode()
    images = any(tensor.dtype == "uint8" for tensor in spec.inputs.values())
    policy_from(members, TOLERANCE if images else _TOLERANCE)

    def write(temporary: Path) -> None:
        with zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in members.items():
                # A constant date, so that equal content gives equal files.
                archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), data, zipfile.ZIP_DEFLATED)

    write_whole(path, write)
