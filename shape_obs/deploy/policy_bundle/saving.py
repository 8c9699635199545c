"""save_bundle: a trained policy with all that it takes to run it elsewhere, in one file."""

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
from shape_obs.deploy.policy_bundle.chain import training_spec
from shape_obs.deploy.policy_bundle.documents import write_json, write_yaml
from shape_obs.deploy.policy_bundle.errors import BundleError
from shape_obs.deploy.policy_bundle.fitted import pack
from shape_obs.deploy.policy_bundle.loading import check_members
from shape_obs.deploy.policy_bundle.network import Network
from shape_obs.deploy.policy_bundle.record import Record, Surroundings, versions
from shape_obs.deploy.policy_bundle.spaces import channels_first, layout_differences, space_to_dict
from shape_obs.deploy.policy_bundle.statistics import Statistics
from shape_obs.deploy.policy_bundle.tensors import write_weights
from shape_obs.robot import ActionSpec
from shape_obs.spec import to_plain as plain

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
