"""save_bundle: a trained policy with all that it takes to run it elsewhere, in one file.

load_bundle: read a trained policy, and refuse what cannot be trusted.
"""

from __future__ import annotations
import json
import os
import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any
import yaml
from shape_obs.config import dump_config
from shape_obs.deploy.policy_bundle import environment
from shape_obs.deploy.policy_bundle.archive import CONFIG, ENV, RECORD, STATISTICS, WEIGHTS, write_archive
from shape_obs.deploy.policy_bundle.environment import training_spec
from shape_obs.deploy.policy_bundle.documents import write_json, write_yaml
from shape_obs.deploy.policy_bundle.documents import BundleError
from shape_obs.deploy.policy_bundle.archive import pack
from shape_obs.deploy.policy_bundle.network import Network
from shape_obs.deploy.policy_bundle.record import Record, Surroundings, versions
from shape_obs.deploy.policy_bundle.spaces import channels_first, layout_differences, space_to_dict
from shape_obs.deploy.policy_bundle.spaces import Statistics
from shape_obs.deploy.policy_bundle.documents import write_weights
from shape_obs.robot import ActionSpec
from shape_obs.spec import to_plain
if TYPE_CHECKING:
    from gymnasium.envs.registration import EnvSpec
    from stable_baselines3.common.base_class import BaseAlgorithm
import shutil
import tempfile
import weakref
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any
import numpy as np
from shape_obs.config import SECTIONS, DetectorConfig, detector_arguments, schema_hash
from shape_obs.deploy.policy_bundle import environment, legacy
from shape_obs.deploy.policy_bundle.archive import (
    CONFIG,  # fmt: skip
    ENV,  # fmt: skip
    PICKLED,  # fmt: skip
    RECORD,  # fmt: skip
    STATISTICS,  # fmt: skip
    VERSION,  # fmt: skip
    WEIGHTS,  # fmt: skip
    Archive,  # fmt: skip
    read_archive,  # fmt: skip
)
from shape_obs.deploy.policy_bundle.documents import read_json, read_yaml
from shape_obs.deploy.policy_bundle.documents import MALFORMED
from shape_obs.deploy.policy_bundle.archive import FOLDER
from shape_obs.deploy.policy_bundle.archive import extract
from shape_obs.deploy.policy_bundle.archive import unpack
from shape_obs.deploy.policy_bundle.limits import check_configuration
from shape_obs.deploy.policy_bundle.policy import Bundle
from shape_obs.deploy.policy_bundle.record import Record, version_differences, versions
from shape_obs.deploy.policy_bundle.spaces import channels_first, space_from_dict, space_to_dict, zeros



def save_bundle(
    model: BaseAlgorithm,
    env: Any,
    path: str | os.PathLike[str],
    *,
    summary: Mapping[str, Any] | None = None,
    action_spec: ActionSpec | None = None,
) -> None:
    """Write a trained policy with all that it takes to run it elsewhere: whole or not at all.

    The file holds data, no code: the weights of the policy, what its network is, what ``VecNormalize`` has learnt, the
    environment's spec, the configuration of its ``ShapeObservation``, the camera, the hash of the feature schema, what
    an action means, the duration of a step, the spaces, package versions, and a summary of the training. The
    environment and the policy are rebuilt once, so that what is saved is known to work.

    Args:
        model: Of Stable-Baselines3.
        env: What it was trained in: a vector environment, in ``VecNormalize`` or not, or a Gymnasium environment.
        path: Where to, such as ``"cable.policy"``.
        summary: What else is to be recorded of the training, as JSON values.
        action_spec: What an action of 1 means, for an environment that does not publish it.

    Raises:
        BundleError: The environment cannot be rebuilt from its spec, is another one than the model was trained in, or
            the policy has an argument that is neither a plain value nor a class.
        OSError: The file cannot be written.

    Warns:
        UserWarning: The policy has a class, or the environment a wrapper or an argument, that ``load_bundle`` or
            ``make_env`` reads only with ``trust=True``. The message names it.

    Example:
        >>> save_bundle(model, model.get_env(), "cable.policy")  # doctest: +SKIP
    """
    network, spec = Network.of(model), training_spec(env)
    counts = {"algorithm": type(model).__name__, "steps": int(model.num_timesteps), "seed": model.seed}
    try:
        given = json.loads(json.dumps(plain(summary or {})))
    except (TypeError, ValueError) as error:
        raise BundleError(f"summary: expected JSON values, {error}.") from error
    rebuilt = environment.rebuild(spec, trust=True, arguments={})
    try:
        seen = Surroundings.of(rebuilt)
    finally:
        rebuilt.close()
    record = Record(
        algorithm=network.algorithm,
        summary={**counts, **given},
        versions=versions(),
        **{**vars(seen), "config": None, "action_spec": action_spec or seen.action_spec},
    )
    _check_spaces(model, record)
    files: dict[str, bytes] = {}
    weights = write_weights(model.policy.state_dict())
    members = {WEIGHTS: weights, ENV: write_json(pack(environment.to_dict(spec), files))}
    if seen.config is not None:
        sections = pack(yaml.safe_load(dump_config(seen.config)), files)
        members[CONFIG] = write_yaml(sections)
    statistics = Statistics.of(_normalize(env) or model.get_vec_normalize_env())
    if statistics is not None:
        statistics.check(record.observation_space)
        members[STATISTICS] = statistics.to_bytes()
    described = {name: value for name, value in record.to_dict().items() if name != "config"}
    members[RECORD] = write_json({**described, "network": vars(network)})
    check_members({**members, **files})
    _warn_of_trust(network, spec)
    write_archive(path, {**members, **files})



def _warn_of_trust(network: Network, spec: EnvSpec) -> None:
    """Warn of what is read only with ``trust=True``."""
    try:
        network.check_known()
        environment.from_dict(environment.to_dict(spec), trust=False)
        environment.check_rebuildable(spec)
    except BundleError as error:
        warnings.warn(f"the bundle is not read whole without trust: {error}", UserWarning, stacklevel=3)



def _check_spaces(model: BaseAlgorithm, record: Record) -> None:
    """Refuse an env that is another one than the model was trained in."""
    for what, told, own in (
        ("observation", channels_first(record.observation_space), model.observation_space),
        ("action", record.action_space, model.action_space),
    ):
        different = list(layout_differences(channels_first(space_to_dict(own)), told, f"{what} space"))
        if different:
            place, trained, here = different[0]
            raise BundleError(f"the model was trained in another environment: {place}: {trained} then, {here} in this.")



def _normalize(env: Any) -> Any:
    """The ``VecNormalize`` around an env; None without."""
    from stable_baselines3.common.vec_env import VecEnv, unwrap_vec_normalize

    return unwrap_vec_normalize(env) if isinstance(env, VecEnv) else None




def load_bundle(path: str | os.PathLike[str], *, device: str = "cpu", trust: bool = False) -> Bundle:
    """Read what ``save_bundle`` wrote. Without ``trust`` no code from the file runs, now or later.

    What a file may hold and how large it may be stands in the documentation, "Deploy what you trained".

    Args:
        path: The file.
        device: Where the network runs: ``"cpu"``, ``"cuda"``.
        trust: Read what runs code: classes and environments that the file names by import path, and bundles of
            version 1, whose models are pickles. Whoever made such a file can do anything that you can.

    Raises:
        FileNotFoundError: There is no such file.
        BundleError: It is no bundle, truncated or changed, of another version, or needs ``trust``; its network has
            other spaces than were recorded, its features mean something else here, or a package has another major
            version.

    Warns:
        UserWarning: A package has another minor version than in training.

    Example:
        >>> action = load_bundle("cable.policy").act(observation)  # doctest: +SKIP
    """
    try:
        archive = read_archive(path, trust=trust)
        with _folder(archive.members) as folder:
            bundle = _assemble(archive, folder, device, trust)
            if folder is not None:  # features read their files once, but a rebuilt environment reads them again
                weakref.finalize(bundle, shutil.rmtree, folder, ignore_errors=True)
    except BundleError as error:
        raise BundleError(f"{path}: {error}") from error
    _warn_of_versions(path, bundle.record)
    return bundle



def check_members(members: Mapping[str, bytes]) -> None:
    """Refuse members that ``load_bundle`` would refuse, however much it trusted them.

    Raises:
        BundleError: The message says why.
    """
    with _folder(members) as folder:
        try:
            _assemble(Archive(VERSION, dict(members)), folder, "cpu", trust=True)
        finally:
            if folder is not None:
                shutil.rmtree(folder, ignore_errors=True)



def _assemble(archive: Archive, folder: Path | None, device: str, trust: bool) -> Bundle:
    """Make the bundle of its members, checking each before it is used."""
    from gymnasium.error import Error

    members = archive.members
    old = archive.version == PICKLED
    missing = [name for name in (legacy.MODEL if old else WEIGHTS, ENV, RECORD) if name not in members]
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
        _check_versions(record)
        _check_schema(record)
        env = unpack(read_json(members[ENV], ENV), members, folder, trust=trust)
        spec = legacy.read_spec(env) if old else environment.from_dict(env, trust=trust)
        if network is None:
            policy = legacy.read_policy(record.algorithm, members[legacy.MODEL], device)
        else:
            policy = network.build(members.pop(WEIGHTS), device)
        _check_spaces(policy, record)
        bundle = Bundle(record, spec, policy, _statistics(members, record), trusted=trust)
        _check_acting(bundle)
        return bundle
    except BundleError:
        raise
    except (*MALFORMED, Error) as error:
        raise BundleError(f"the bundle cannot be understood: {error}") from error



def _config(members: Mapping[str, bytes], folder: Path | None, trust: bool) -> dict[str, Any] | None:
    """The arguments of ``ShapeObservation`` from the three sections, defaults filled in."""
    if CONFIG not in members:
        return None
    sections = unpack(read_yaml(members[CONFIG], CONFIG), members, folder, trust=trust)
    config = {name: value for section in SECTIONS for name, value in sections.get(section, {}).items()}
    if "features" not in config:
        raise BundleError(f"{CONFIG}: the section 'shape' has no features.")
    if not trust:
        check_configuration(config, CONFIG)
    return {**config, **DetectorConfig.from_dict(detector_arguments(config)).to_dict()}



def _statistics(members: Mapping[str, bytes], record: Record) -> Statistics | None:
    if legacy.STATISTICS in members:
        statistics = legacy.read_statistics(members[legacy.STATISTICS])
    elif STATISTICS in members:
        statistics = Statistics.from_bytes(members[STATISTICS])
    else:
        return None
    statistics.check(record.observation_space)
    return statistics



def _check_versions(record: Record) -> None:
    fatal = version_differences(record.versions, versions())[0]
    if fatal:
        raise BundleError(f"cannot be trusted to run with other major versions: {', '.join(fatal)}.")



def _warn_of_versions(path: str | os.PathLike[str], record: Record) -> None:
    doubtful = version_differences(record.versions, versions())[1]
    if doubtful:
        warnings.warn(f"{path}: saved with other versions: {', '.join(doubtful)}.", UserWarning, stacklevel=3)



def _check_schema(record: Record) -> None:
    """Refuse features that another version of this library takes to be others."""
    here = None if record.config is None else schema_hash(record.config)
    if here != record.schema:
        raise BundleError(
            f"its features mean something else here: the hash of their schema is {str(here)[:12]}..., recorded was "
            f"{str(record.schema)[:12]}... Use the shape-obs that it was saved with: {record.versions.get('shape-obs')}"
        )



def _check_spaces(policy: Any, record: Record) -> None:
    """Refuse a network that is not the recorded one."""
    for what, own, recorded in (
        ("observation", policy.observation_space, record.observation_space),
        ("action", policy.action_space, record.action_space),
    ):
        if channels_first(space_to_dict(own)) != channels_first(recorded):
            raise BundleError(
                f"its network has another {what} space than was recorded: {space_to_dict(own)}, recorded is "
                f"{dict(recorded)}. Save the policy again."
            )



def _check_acting(bundle: Bundle) -> None:
    """Refuse a policy that does not give an action for an observation of zeros."""
    action = bundle.act(zeros(space_from_dict(bundle.record.observation_space, "the observation space")))
    shape = bundle.policy.action_space.shape
    if action.shape != shape or not np.isfinite(action).all():
        raise BundleError(f"the policy gives no action of shape {shape}: {action!r:.100}.")



@contextmanager
def _folder(members: Mapping[str, bytes]) -> Iterator[Path | None]:
    """A temporary folder with the fitted files, where there are any; it goes if anything fails."""
    if not any(name.startswith(FOLDER) for name in members):
        yield None
        return
    folder = Path(tempfile.mkdtemp(prefix="shape_obs-"))
    try:
        extract(members, folder)
        yield folder
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise

