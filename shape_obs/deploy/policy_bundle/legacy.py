"""Bundles of version 1: their model is a pickle, so they are read with trust alone."""

from __future__ import annotations

import io
import pickle
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from shape_obs.deploy.policy_bundle.documents import BundleError
from shape_obs.deploy.policy_bundle.spaces import Statistics
from shape_obs.utils.arrays import decode_npz
from shape_obs.utils.documents import load_named

if TYPE_CHECKING:
    from gymnasium.envs.registration import EnvSpec
    from stable_baselines3.common.policies import BasePolicy

MODEL: Final = "model.zip"
STATISTICS: Final = "statistics.npz"
#: What unpickling raises where a class is missing or another one.
_UNREADABLE: Final = (
    ImportError, AttributeError, KeyError, TypeError, ValueError, RuntimeError, EOFError, pickle.UnpicklingError,
)  # fmt: skip


def read_policy(algorithm: str, data: bytes, device: str) -> BasePolicy:
    """Read the policy of a model that Stable-Baselines3 saved. This runs code from the file.

    Args:
        algorithm: Its class, ``module:Name``.
        data: The zip file that ``model.save`` wrote.
        device: Where its network runs.

    Raises:
        BundleError: The class is none of Stable-Baselines3's, or something that the model needs is not here.
    """
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

    try:
        kind = load_named(algorithm, "the policy's algorithm")
    except (ImportError, ValueError) as error:
        raise BundleError(f"{error} The policy needs it.") from error
    if not (isinstance(kind, type) and issubclass(kind, BaseAlgorithm)):
        raise BundleError(f"the policy's algorithm: expected a class of Stable-Baselines3, got {algorithm!r}.")
    # Hindsight replay asks for an environment, and a buffer takes memory; a policy that acts needs neither.
    idle: dict[str, Any] = {"replay_buffer_class": None, "replay_buffer_kwargs": {}, "buffer_size": 1}
    try:
        custom = idle if issubclass(kind, OffPolicyAlgorithm) else None
        return kind.load(io.BytesIO(data), device=device, custom_objects=custom).policy
    except _UNREADABLE as error:
        raise BundleError(f"the model cannot be read here: {error}") from error


def read_statistics(data: bytes) -> Statistics:
    """Read the statistics of the observations.

    Raises:
        ValueError: The member is no ``.npz`` file of them.
    """
    return Statistics.from_arrays(decode_npz(data, STATISTICS))


def read_spec(value: Mapping[str, Any]) -> EnvSpec:
    """Read the environment's spec, which Gymnasium wrote.

    Raises:
        ValueError: It is something else.
    """
    import json

    from gymnasium.envs.registration import EnvSpec

    return EnvSpec.from_json(json.dumps(value))
