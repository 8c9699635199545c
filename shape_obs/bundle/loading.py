"""load_bundle: read a trained policy, and refuse what cannot be trusted."""

from __future__ import annotations

import json
import os
import tempfile
import warnings
import weakref
from pathlib import Path
from typing import Any

import yaml

from shape_obs.bundle.archive import BundleError, read_archive
from shape_obs.bundle.fitted import extract, unpack
from shape_obs.bundle.model import read_model
from shape_obs.bundle.policy import Bundle
from shape_obs.bundle.record import Record, version_differences, versions
from shape_obs.bundle.saving import CONFIG, ENV, MODEL, RECORD, STATISTICS
from shape_obs.bundle.spaces import channels_first, space_to_dict
from shape_obs.bundle.statistics import Statistics
from shape_obs.config import SECTIONS, schema_hash


def load_bundle(path: str | os.PathLike[str], *, device: str = "cpu") -> Bundle:
    """Read what ``save_bundle`` wrote. A model may run code when it is read: load only what you trust.

    Args:
        path: The file.
        device: Where the network runs: ``"cpu"``, ``"cuda"``.

    Raises:
        FileNotFoundError: There is no such file.
        BundleError: It is no bundle, truncated or changed, or of another version; its model has other spaces than were
            recorded, its features mean something else here, or a package has another major version.

    Warns:
        UserWarning: A package has another minor version than in training.

    Example:
        >>> action = load_bundle("cable.policy").act(observation)  # doctest: +SKIP
    """
    from gymnasium.envs.registration import EnvSpec

    members = read_archive(path)
    missing = [name for name in (MODEL, ENV, RECORD) if name not in members]
    if missing:
        raise BundleError(f"{path}: the bundle has no {missing[0]!r}: save the policy again.")
    folder = Path(tempfile.mkdtemp(prefix="shape_obs-"))
    try:
        extract(members, folder)
        told: dict[str, Any] = json.loads(members[RECORD])
        config = None
        if CONFIG in members:
            sections = unpack(yaml.safe_load(members[CONFIG]), folder)
            config = {name: value for section in SECTIONS for name, value in sections.get(section, {}).items()}
        record = Record.from_dict({**told, "config": config})
        _check_versions(path, record)
        _check_schema(path, record)
        spec = EnvSpec.from_json(json.dumps(unpack(json.loads(members[ENV]), folder)))
        model = read_model(record.algorithm, members[MODEL], device)
        _check_spaces(path, model, record)
        statistics = Statistics.from_bytes(members[STATISTICS]) if STATISTICS in members else None
    except BundleError:
        _remove(folder)
        raise
    except (ValueError, KeyError, TypeError) as error:
        _remove(folder)
        raise BundleError(f"{path}: the bundle cannot be understood: {error}") from error
    bundle = Bundle(record, spec, model, statistics)
    weakref.finalize(bundle, _remove, folder)  # features read their files once, but a rebuilt env reads them again
    return bundle


def _check_versions(path: str | os.PathLike[str], record: Record) -> None:
    fatal, doubtful = version_differences(record.versions, versions())
    if fatal:
        raise BundleError(f"{path}: cannot be trusted to run with other major versions: {', '.join(fatal)}.")
    if doubtful:
        warnings.warn(f"{path}: saved with other versions: {', '.join(doubtful)}.", UserWarning, stacklevel=3)


def _check_schema(path: str | os.PathLike[str], record: Record) -> None:
    """Refuse features that another version of this library takes to be others."""
    here = None if record.config is None else schema_hash(record.config)
    if here != record.schema:
        raise BundleError(
            f"{path}: its features mean something else here: the hash of their schema is {str(here)[:12]}..., recorded "
            f"was {str(record.schema)[:12]}... Use the shape-obs that it was saved with, "
            f"{record.versions.get('shape-obs')}."
        )


def _check_spaces(path: str | os.PathLike[str], model: Any, record: Record) -> None:
    """Refuse a model that is not the recorded one."""
    for what, own, recorded in (
        ("observation", model.observation_space, record.observation_space),
        ("action", model.action_space, record.action_space),
    ):
        if channels_first(space_to_dict(own)) != channels_first(recorded):
            raise BundleError(
                f"{path}: its model has another {what} space than was recorded: {space_to_dict(own)}, recorded is "
                f"{dict(recorded)}. Save the policy again."
            )


def _remove(folder: Path) -> None:
    for file in folder.iterdir():
        file.unlink()
    folder.rmdir()
