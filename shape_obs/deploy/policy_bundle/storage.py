"""Save a trained policy with everything needed to run it elsewhere, and load it again."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
import warnings
import weakref
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from shape_obs.config.config_file import SECTIONS, detector_arguments, dump_config
from shape_obs.config.detector_config import ALGORITHM, DetectorConfig
from shape_obs.deploy.policy_bundle import environment
from shape_obs.deploy.policy_bundle.archive import (
    CONFIG,
    ENV,
    FOLDER,
    PICKLED,
    PICKLED_MODEL,
    PICKLED_STATISTICS,
    RECORD,
    STATISTICS,
    VERSION,
    WEIGHTS,
    Archive,
    extract,
    pack,
    read_archive,
    unpack,
    write_archive,
)  # fmt: skip
from shape_obs.deploy.policy_bundle.documents import (
    MALFORMED,
    BundleError,
    read_json,
    read_yaml,
    write_json,
    write_weights,
    write_yaml,
)  # fmt: skip
from shape_obs.deploy.policy_bundle.limits import check_configuration, check_rebuildable
from shape_obs.deploy.policy_bundle.network import Network, read_pickled_policy
from shape_obs.deploy.policy_bundle.policy import Bundle
from shape_obs.deploy.policy_bundle.record import Record, Surroundings, version_differences, versions
from shape_obs.deploy.policy_bundle.spaces import Statistics, channels_first, layout_differences, space_to_dict
from shape_obs.robot import ActionSpec
from shape_obs.spec import to_plain
from shape_obs.utils.arrays import decode_npz
from shape_obs.utils.documents import parse_yaml
from shape_obs.wrappers.env_protocol import seconds_per_step

if TYPE_CHECKING:
    from gymnasium.envs.registration import EnvSpec
    from stable_baselines3.common.base_class import BaseAlgorithm


def save_bundle(
    model: BaseAlgorithm,
    env: Any,
    path: str | os.PathLike[str],
    *,
    summary: Mapping[str, Any] | None = None,
    action_spec: ActionSpec | None = None,
) -> None:
    """Write a trained policy with everything needed to run it elsewhere, completely or not at all.

    The file holds data and no code: weights and description of the network, the statistics of ``VecNormalize``, the
    spec of the environment, the configuration of its ``ShapeObservation``, the camera, the hash of the feature schema,
    the meaning of actions, the duration of a step, the spaces, package versions, and a summary of the training.
    Environment and policy are rebuilt once, to verify that the bundle works.

    Args:
        model: Model of Stable-Baselines3.
        env: Environment of the training: a vector environment, in ``VecNormalize`` or not, or a Gymnasium environment.
        path: File to write, such as ``"cable.policy"``.
        summary: Further JSON values to record about the training.
        action_spec: Meaning of an action of 1, for an environment that does not publish it.

    Raises:
        BundleError: The environment cannot be rebuilt from its spec, a wrapper keeps statistics of the training, the
            environment is not the one in which the model was trained, or the policy has an argument that is neither a
            JSON value nor a class.
        OSError: The file cannot be written.

    Warns:
        UserWarning: The policy has a class, or the environment a wrapper or an argument, that ``load_bundle`` or
            ``make_env`` reads only with ``trust=True``, or a wrapper is there whose effect on a robot is unknown. The
            message names it.

    Example:
        >>> save_bundle(model, model.get_env(), "cable.policy")  # doctest: +SKIP
    """
    network, spec = Network.of(model), environment.training_spec(env)
    counts = {"algorithm": type(model).__name__, "steps": int(model.num_timesteps), "seed": model.seed}
    try:
        given = json.loads(json.dumps(to_plain(summary or {})))
    except (TypeError, ValueError) as error:
        raise BundleError(f"summary: expected JSON values, {error}.") from error
    rebuilt = environment.rebuild(spec, trust=True, arguments={})
    try:
        environment.check_statistics(rebuilt, [each for each in (env, model.get_env()) if each is not None])
        surroundings = Surroundings.of(rebuilt)
    finally:
        rebuilt.close()
    if surroundings.config is not None:
        surroundings = replace(surroundings, dt=_step_of(env))
    record = Record(
        algorithm=network.algorithm,
        summary={**counts, **given},
        versions=versions(),
        detector_version=ALGORITHM,
        **{**vars(surroundings), "config": None, "action_spec": action_spec or surroundings.action_spec},
    )
    _check_trained_in(model, record)
    files: dict[str, bytes] = {}
    weights = write_weights(model.policy.state_dict())
    members = {WEIGHTS: weights, ENV: write_json(pack(environment.to_dict(spec), files))}
    if surroundings.config is not None:
        sections = pack(parse_yaml(dump_config(surroundings.config), CONFIG), files)
        members[CONFIG] = write_yaml(sections)
    statistics = Statistics.of(_normalize(env) or model.get_vec_normalize_env())
    if statistics is not None:
        statistics.check(record.observation_space)
        members[STATISTICS] = statistics.to_bytes()
    described = {name: value for name, value in record.to_dict().items() if name != "config"}
    members[RECORD] = write_json({**described, "network": vars(network)})
    check_members({**members, **files})
    _warn(network, spec)
    write_archive(path, {**members, **files})


def _warn(network: Network, spec: EnvSpec) -> None:
    """Warn about parts that are read only with ``trust=True``, and wrappers that keep the policy from a robot."""
    if reason := environment.unknown_wrapper(spec):
        warnings.warn(f"the policy will run in a simulator only: {reason}.", UserWarning, stacklevel=3)
    try:
        network.check_known()
        environment.from_dict(environment.to_dict(spec), trust=False)
        check_rebuildable(spec)
    except BundleError as error:
        warnings.warn(f"parts of the bundle are read only with trust: {error}", UserWarning, stacklevel=3)


def _check_trained_in(model: BaseAlgorithm, record: Record) -> None:
    """Refuse an environment whose spaces are not those of the model."""
    for what, recorded, own in (
        ("observation", channels_first(record.observation_space), model.observation_space),
        ("action", record.action_space, model.action_space),
    ):
        different = list(layout_differences(channels_first(space_to_dict(own)), recorded, f"{what} space"))
        if different:
            place, trained, here = different[0]
            raise BundleError(f"the model was trained in another environment: {place}: {trained} then, {here} in this.")


def _step_of(env: Any) -> float:
    """Return the duration of a step in seconds, as the ``ShapeObservation`` of a training measured it."""
    from stable_baselines3.common.vec_env import VecEnv

    return float(env.get_attr("dt")[0]) if isinstance(env, VecEnv) else seconds_per_step(env)


def _normalize(env: Any) -> Any:
    """Return the ``VecNormalize`` around an environment; None if there is none."""
    from stable_baselines3.common.vec_env import VecEnv, unwrap_vec_normalize

    return unwrap_vec_normalize(env) if isinstance(env, VecEnv) else None


def load_bundle(path: str | os.PathLike[str], *, device: str = "cpu", trust: bool = False) -> Bundle:
    """Read a policy that ``save_bundle`` wrote. Without ``trust``, no code from the file runs, now or later.

    The documentation lists what a file may hold and how large it may be, under "Deploy a trained policy".

    Args:
        path: The file.
        device: Device of the network: ``"cpu"`` or ``"cuda"``.
        trust: Whether to read parts that run code: classes and environments that the file names by import path, and
            bundles of version 1, whose models are pickles. Whoever made such a file can do anything that you can.

    Raises:
        FileNotFoundError: There is no such file.
        BundleError: The file is not a bundle, is truncated or changed, has another version, or needs ``trust``; the
            spaces of its network are not the recorded ones, its features have another meaning here, or a package has
            another major version.

    Warns:
        UserWarning: A package has another minor version than in training, or the detector's algorithm another version.

    Example:
        >>> action = load_bundle("cable.policy").act(observation)  # doctest: +SKIP
    """
    try:
        archive = read_archive(path, trust=trust)
        with _fitted_files(archive.members) as folder:
            bundle = _assemble(archive, folder, device, trust)
            if folder is not None:  # a rebuilt environment reads the files of its features again
                weakref.finalize(bundle, shutil.rmtree, folder, ignore_errors=True)
    except BundleError as error:
        raise BundleError(f"{path}: {error}") from error
    doubtful = version_differences(bundle.record.versions, versions())[1]
    if doubtful:
        warnings.warn(f"{path}: saved with other versions: {', '.join(doubtful)}.", UserWarning, stacklevel=2)
    if bundle.record.other_points():
        warnings.warn(f"{path}: {bundle.record.other_points()}", UserWarning, stacklevel=2)
    return bundle


def check_members(members: Mapping[str, bytes]) -> None:
    """Refuse members that ``load_bundle`` would refuse even with ``trust=True``.

    Raises:
        BundleError: The message gives the reason.
    """
    with _fitted_files(members) as folder:
        try:
            _assemble(Archive(VERSION, dict(members)), folder, "cpu", trust=True)
        finally:
            if folder is not None:
                shutil.rmtree(folder, ignore_errors=True)


def _assemble(archive: Archive, folder: Path | None, device: str, trust: bool) -> Bundle:
    """Create the bundle from its members, checking each before it is used."""
    from gymnasium.error import Error

    members = archive.members
    old = archive.version == PICKLED
    missing = [name for name in (PICKLED_MODEL if old else WEIGHTS, ENV, RECORD) if name not in members]
    if missing:
        raise BundleError(f"the bundle has no {missing[0]!r}: save the policy again.")
    try:
        described = read_json(members[RECORD], RECORD)
        network = None if old else Network.from_dict(described.pop("network", None))
        if network is not None and not trust:
            network.check_known()
        config = _config(members, folder, trust)
        record = Record.from_dict({**described, "config": config})
        record.check()
        record.check_versions()
        record.check_schema()
        env = unpack(read_json(members[ENV], ENV), members, folder, trust=trust)
        spec = environment.from_gymnasium(env) if old else environment.from_dict(env, trust=trust)
        if network is None:
            policy = read_pickled_policy(record.algorithm, members[PICKLED_MODEL], device)
        else:
            policy = network.build(members.pop(WEIGHTS), device)
        _check_spaces(policy, record)
        bundle = Bundle(record, spec, policy, _statistics(members, record), trusted=trust)
        bundle.check_action()
        return bundle
    except BundleError:
        raise
    except (*MALFORMED, Error) as error:
        raise BundleError(f"the bundle cannot be understood: {error}") from error


def _config(members: Mapping[str, bytes], folder: Path | None, trust: bool) -> dict[str, Any] | None:
    """Return the arguments of ``ShapeObservation`` from the three sections, with defaults filled in."""
    if CONFIG not in members:
        return None
    sections = unpack(read_yaml(members[CONFIG], CONFIG), members, folder, trust=trust)
    config = {name: value for section in SECTIONS for name, value in sections.get(section, {}).items()}
    if "features" not in config:
        raise BundleError(f"{CONFIG}: the section 'shape' has no features.")
    if not trust:
        check_configuration(config, CONFIG)
    rest = {name: config[name] for name in ("features", "workspace") if name in config}
    return {**rest, **DetectorConfig.from_dict(detector_arguments(config)).to_dict()}


def _statistics(members: Mapping[str, bytes], record: Record) -> Statistics | None:
    if PICKLED_STATISTICS in members:
        statistics = Statistics.from_arrays(decode_npz(members[PICKLED_STATISTICS], PICKLED_STATISTICS))
    elif STATISTICS in members:
        statistics = Statistics.from_bytes(members[STATISTICS])
    else:
        return None
    statistics.check(record.observation_space)
    return statistics


def _check_spaces(policy: Any, record: Record) -> None:
    """Refuse a network whose spaces are not the recorded ones."""
    for what, own, recorded in (
        ("observation", policy.observation_space, record.observation_space),
        ("action", policy.action_space, record.action_space),
    ):
        if channels_first(space_to_dict(own)) != channels_first(recorded):
            raise BundleError(
                f"its network has another {what} space than was recorded: {space_to_dict(own)}, recorded is "
                f"{dict(recorded)}. Save the policy again."
            )


@contextmanager
def _fitted_files(members: Mapping[str, bytes]) -> Iterator[Path | None]:
    """Extract the fitted files, if any, into a temporary folder, which is removed on an error."""
    if not any(name.startswith(FOLDER) for name in members):
        yield None
        return
    folder = Path(tempfile.mkdtemp(prefix="shape_obs-"))
    try:
        extract(members, folder)
        yield folder
    except BaseException:  # also on Ctrl-C: no folder may be left behind; raised again below
        shutil.rmtree(folder, ignore_errors=True)
        raise
