"""save_bundle: a trained policy with all that it takes to run it elsewhere, in one file."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import yaml

from shape_obs.bundle.archive import BundleError, write_archive
from shape_obs.bundle.chain import training_spec
from shape_obs.bundle.fitted import pack
from shape_obs.bundle.model import algorithm_of, write_model
from shape_obs.bundle.record import Record, Surroundings, versions
from shape_obs.bundle.spaces import channels_first, layout_differences, space_to_dict
from shape_obs.bundle.statistics import Statistics
from shape_obs.config import dump_config
from shape_obs.robot import ActionSpec
from shape_obs.spec import plain

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

MODEL: Final = "model.zip"
STATISTICS: Final = "statistics.npz"
ENV: Final = "env.json"
CONFIG: Final = "config.yaml"
RECORD: Final = "policy.json"


def save_bundle(
    model: BaseAlgorithm,
    env: Any,
    path: str | os.PathLike[str],
    *,
    summary: Mapping[str, Any] | None = None,
    action_spec: ActionSpec | None = None,
) -> None:
    """Write a trained policy with all that it takes to run it elsewhere: whole or not at all.

    The file holds the model without its replay buffer, what ``VecNormalize`` has learnt, the environment's spec, the
    configuration of its ``ShapeObservation``, the camera, the hash of the feature schema, what an action means, the
    duration of a step, the spaces, package versions, and a summary of the training. The environment is made anew from
    its spec once, so that what is saved is known to work.

    Args:
        model: Of Stable-Baselines3.
        env: What it was trained in: a vector environment, in ``VecNormalize`` or not, or a Gymnasium environment.
        path: Where to, such as ``"cable.policy"``.
        summary: What else is to be told of the training, as JSON values.
        action_spec: What an action of 1 means, for an environment that does not publish it.

    Raises:
        BundleError: The environment cannot be rebuilt from its spec, or is another one than the model was trained in.
        OSError: The file cannot be written.

    Example:
        >>> save_bundle(model, model.get_env(), "cable.policy")  # doctest: +SKIP
    """
    import gymnasium as gym

    algorithm, spec = algorithm_of(model), training_spec(env)
    told = {"algorithm": type(model).__name__, "steps": int(model.num_timesteps), "seed": model.seed}
    try:
        given = json.loads(json.dumps(plain(summary or {})))
    except (TypeError, ValueError) as error:
        raise BundleError(f"summary: expected JSON values, {error}.") from error
    rebuilt = gym.make(spec, disable_env_checker=True)
    try:
        seen = Surroundings.of(rebuilt)
    finally:
        rebuilt.close()
    record = Record(
        algorithm=algorithm,
        summary={**told, **given},
        versions=versions(),
        **{**vars(seen), "config": None, "action_spec": action_spec or seen.action_spec},
    )
    _check_spaces(model, record)
    files: dict[str, bytes] = {}
    members = {MODEL: write_model(model), ENV: _json(pack(json.loads(spec.to_json()), files))}
    if seen.config is not None:
        sections = pack(yaml.safe_load(dump_config(seen.config)), files)
        members[CONFIG] = yaml.safe_dump(sections, sort_keys=False).encode()
    statistics = Statistics.of(_normalize(env) or model.get_vec_normalize_env())
    if statistics is not None:
        members[STATISTICS] = statistics.to_bytes()
    members[RECORD] = _json(record.to_dict())
    write_archive(path, {**members, **files})


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


def _json(value: Any) -> bytes:
    return json.dumps(value, indent=2).encode()
