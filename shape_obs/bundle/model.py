"""The model of Stable-Baselines3 in a bundle: written without its replay buffer, read without one."""

from __future__ import annotations

import io
import pickle
from typing import TYPE_CHECKING, Any, Final

from shape_obs.bundle.archive import BundleError
from shape_obs.loading import load_named

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

#: What unpickling raises where a class is missing or another one.
_UNREADABLE: Final = (
    ImportError,
    AttributeError,
    KeyError,
    TypeError,
    ValueError,
    RuntimeError,
    pickle.UnpicklingError,
)


def algorithm_of(model: BaseAlgorithm) -> str:
    """``module:Name`` of a model's class.

    Raises:
        BundleError: Its policy has a memory of its own, which nothing here carries from step to step.
    """
    from stable_baselines3.common.base_class import BaseAlgorithm

    if not isinstance(model, BaseAlgorithm):
        raise BundleError(f"model: expected one of Stable-Baselines3, got {type(model).__name__}.")
    if hasattr(model, "_last_lstm_states"):
        raise BundleError(f"model: {type(model).__name__} has a recurrent policy, which bundles cannot run.")
    return f"{type(model).__module__.split('.')[0]}:{type(model).__name__}"


def write_model(model: BaseAlgorithm) -> bytes:
    """The zip file that ``model.save`` writes."""
    buffer = io.BytesIO()
    model.save(buffer)
    return buffer.getvalue()


def read_model(algorithm: str, data: bytes, device: str) -> BaseAlgorithm:
    """The model, to act with, not to train on.

    Args:
        algorithm: Its class.
        data: What ``write_model`` gave.
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
    # Hindsight replay asks for an environment, and a buffer takes memory; who acts needs neither.
    idle: dict[str, Any] = {"replay_buffer_class": None, "replay_buffer_kwargs": {}, "buffer_size": 1}
    try:
        return kind.load(
            io.BytesIO(data), device=device, custom_objects=idle if issubclass(kind, OffPolicyAlgorithm) else None
        )
    except _UNREADABLE as error:
        raise BundleError(f"the model cannot be read here: {error}") from error
