"""Describe a policy's network as JSON, and build it from that and its weights."""

from __future__ import annotations

import io
import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from inspect import Parameter, signature
from typing import TYPE_CHECKING, Any, Final

from shape_obs.deploy.policy_bundle import network_arguments
from shape_obs.deploy.policy_bundle.archive import WEIGHTS
from shape_obs.deploy.policy_bundle.documents import (
    MALFORMED,
    BundleError,
    TensorType,
    needs_trust,
    read_header,
    read_weights,
)
from shape_obs.deploy.policy_bundle.spaces import space_from_dict, space_to_dict
from shape_obs.utils.documents import load_named

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.policies import BasePolicy

_SB3, _CONTRIB = "stable_baselines3", "sb3_contrib"
#: Algorithms whose ``policy_aliases`` name the known policies, and the package of each.
ALGORITHMS: Final = {
    **dict.fromkeys(("A2C", "DDPG", "DQN", "PPO", "SAC", "TD3"), _SB3),
    **dict.fromkeys(("ARS", "CrossQ", "MaskablePPO", "QRDQN", "TQC", "TRPO"), _CONTRIB),
}
POLICIES: Final = ("MlpPolicy", "CnnPolicy", "MultiInputPolicy", "LinearPolicy")
#: Policies of this library, by algorithm and alias.
_OURS: Final = {("SAC", "PixelPolicy"): "shape_obs.training.pixel_policy:PixelPolicy"}
#: Names of PyTorch's types in safetensors.
_DTYPES: Final = {
    "torch.float64": "F64", "torch.float32": "F32", "torch.float16": "F16", "torch.bfloat16": "BF16",
    "torch.int64": "I64", "torch.int32": "I32", "torch.int16": "I16", "torch.int8": "I8", "torch.uint8": "U8",
    "torch.bool": "BOOL",
}  # fmt: skip
#: Exceptions that unpickling raises where a class is missing or differs.
_UNPICKLING: Final = (
    ImportError, AttributeError, KeyError, TypeError, ValueError, RuntimeError, EOFError, pickle.UnpicklingError,
)  # fmt: skip


@dataclass(frozen=True)
class Network:
    """Describe a policy without its weights.

    Args:
        algorithm: Name of the algorithm in ``ALGORITHMS``; for any other algorithm, the name of its class.
        policy: Alias of the policy's class, or ``module:Name``.
        arguments: Arguments of that class, as ``network_arguments.to_json`` returns them.
        observation_space: Observation space, as ``space_to_dict`` returns it; images have shape ``(C, H, W)``.
        action_space: Action space, in the same form.
    """

    algorithm: str
    policy: str
    arguments: Mapping[str, Any]
    observation_space: Mapping[str, Any]
    action_space: Mapping[str, Any]

    @classmethod
    def of(cls, model: BaseAlgorithm) -> Network:
        """Describe the policy of a model.

        Raises:
            BundleError: It is not a model of Stable-Baselines3, it is recurrent, or it cannot be described.
        """
        from stable_baselines3.common.base_class import BaseAlgorithm

        if not isinstance(model, BaseAlgorithm):
            raise BundleError(f"model: expected a model of Stable-Baselines3, got {type(model).__name__}.")
        if hasattr(model, "_last_lstm_states"):
            raise BundleError(f"model: {type(model).__name__} has a recurrent policy, which bundles cannot run.")
        algorithm, policy = _known_names(model)
        arguments = network_arguments.to_json(_accepted(type(model.policy), model.policy._get_constructor_parameters()))
        spaces = space_to_dict(model.observation_space), space_to_dict(model.action_space)
        return cls(algorithm, policy, arguments, *spaces)

    @classmethod
    def from_dict(cls, value: Any) -> Network:
        """Create a description from a mapping of its fields.

        Raises:
            BundleError: The value is something else.
        """
        names = tuple(cls.__dataclass_fields__)
        if not isinstance(value, Mapping) or set(value) != set(names):
            raise BundleError(f"the policy: expected an object of {', '.join(names)}.")
        network = cls(**value)
        if not isinstance(network.algorithm, str) or not isinstance(network.policy, str):
            raise BundleError("the policy: expected the names of an algorithm and of a policy.")
        return network

    def check_known(self) -> None:
        """Refuse a network that needs trust to be built.

        Raises:
            BundleError: A class is in no closed list, or an argument exceeds its limits.
        """
        if self.algorithm not in ALGORITHMS or self.policy not in (*POLICIES, *(name for _, name in _OURS)):
            raise needs_trust(
                f"the policy {self.policy!r} of {self.algorithm!r} is not in the list of those that are read"
            )
        network_arguments.check(self.arguments)

    @property
    def known(self) -> bool:
        """Whether the network can be built without trust."""
        try:
            self.check_known()
        except BundleError:
            return False
        return True

    def build(self, weights: bytes, device: str) -> BasePolicy:
        """Build the policy and load its weights.

        The shapes of its tensors are first compared with those in the file on a device without memory, so that a few
        bytes cannot ask for a large network. A policy whose class is in no closed list is built directly, since its
        code was trusted.

        Args:
            weights: The member with the weights.
            device: Device of the network, such as ``"cpu"``.

        Raises:
            BundleError: The class is not installed or cannot be built, or the weights belong to another network.
        """
        import torch

        kind, stored = self._class(), read_header(weights, WEIGHTS)
        spaces = [
            space_from_dict(value, f"the policy's {what} space")
            for what, value in (("observation", self.observation_space), ("action", self.action_space))
        ]
        idle = {"lr_schedule": _no_learning, "optimizer_class": _NoOptimizer}
        arguments = network_arguments.from_json(self.arguments) | _accepted(kind, idle)
        if "ortho_init" in arguments:
            arguments["ortho_init"] = False  # takes seconds for wide layers, and all weights are replaced anyway
        try:
            if self.known:
                _check_tensors(kind, spaces, arguments, stored)
            state = read_weights(weights, WEIGHTS)
            del weights  # the largest part of a bundle, and the policy gets a copy
            with torch.random.fork_rng(devices=[]):
                policy = kind(*spaces, **arguments)
            policy.load_state_dict(state, strict=True)
            policy.set_training_mode(False)
            return policy.to(device)
        except BundleError:
            raise
        except MALFORMED as error:
            raise BundleError(f"the policy {self.policy} of {self.algorithm} cannot be built: {error}") from error

    def _class(self) -> Any:
        if ":" in self.policy:
            return network_arguments.named(self.policy, {}, "class")
        own = _OURS.get((self.algorithm, self.policy))
        try:
            if own is not None:
                return load_named(own, "policy")
            aliases = load_named(f"{ALGORITHMS[self.algorithm]}:{self.algorithm}", "algorithm").policy_aliases
            return aliases[self.policy]
        except (ImportError, ValueError, KeyError) as error:
            raise BundleError(f"the policy {self.policy} of {self.algorithm} is not installed here: {error}") from error


def _known_names(model: BaseAlgorithm) -> tuple[str, str]:
    """Return the names of algorithm and policy in the closed lists, else those of the classes themselves."""
    kind = type(model.policy)
    for ancestor in type(model).__mro__:
        name = ancestor.__name__
        if ancestor.__module__.split(".")[0] != ALGORITHMS.get(name):
            continue
        aliases = {alias: known for alias, known in ancestor.policy_aliases.items() if alias in POLICIES}
        for alias, known in aliases.items():
            if known is kind:
                return name, alias
        for (algorithm, alias), path in _OURS.items():
            if algorithm == name and load_named(path, "policy") is kind:
                return name, alias
    return type(model).__name__, network_arguments.name_of(kind, {}, "policy")


def _check_tensors(
    kind: Any, spaces: list[Any], arguments: Mapping[str, Any], stored: Mapping[str, TensorType]
) -> None:
    """Compare the tensors of a policy with those of a file, without allocating memory for them.

    With state-dependent exploration (``use_sde``) a policy draws random numbers when it is built, which takes memory.
    In that case the policy without it is compared, which differs in the names of one layer and in ``log_std``, which
    is as large as that layer.
    """
    import torch

    class Sketch(kind):
        """The policy on PyTorch's meta device, which stores shapes only; otherwise its parts would be moved off it."""

        device = property(lambda self: torch.device("meta"))

    noisy = bool(arguments.get("use_sde"))
    without = {"use_sde": False, "squash_output": False} if noisy else {}
    with torch.device("meta"):
        state = Sketch(
            *spaces, **{**arguments, **{name: without[name] for name in without if name in arguments}}
        ).state_dict()
    sketched = {name: TensorType(_DTYPES[str(tensor.dtype)], tuple(tensor.shape)) for name, tensor in state.items()}
    if noisy:
        sketched, stored = _without_noise(sketched), _without_noise(stored)
    for name in {**sketched, **stored}:
        if sketched.get(name) != stored.get(name):
            raise BundleError(
                f"{WEIGHTS}: tensor {name[:80]!r}: the policy has {_described(sketched.get(name))}, the file has "
                f"{_described(stored.get(name))}. Save the policy again."
            )


def _without_noise(tensors: Mapping[str, TensorType]) -> dict[str, TensorType]:
    return {
        name.replace(".mu.0.", ".mu."): tensor for name, tensor in tensors.items() if "log_std" not in name.split(".")
    }


def _described(tensor: TensorType | None) -> str:
    return "none" if tensor is None else f"{tensor.dtype} of shape {list(tensor.shape)}"


def _accepted(kind: type[Any], arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return those arguments that a class takes, since a policy may report those of its base class."""
    parameters = signature(kind).parameters
    if any(parameter.kind is Parameter.VAR_KEYWORD for parameter in parameters.values()):
        return dict(arguments)
    return {name: value for name, value in arguments.items() if name in parameters}


class _NoOptimizer:
    """Replace the optimizer, which would take memory, and seconds to import."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        """Accept and ignore the arguments of an optimizer."""


def _no_learning(_: float) -> float:
    return 0.0


def read_pickled_policy(algorithm: str, data: bytes, device: str) -> BasePolicy:
    """Read the policy of a bundle of version 1, a model that Stable-Baselines3 saved. This runs code from the file.

    Args:
        algorithm: The class of the model, ``module:Name``.
        data: The zip file that ``model.save`` wrote.
        device: Device of the network, such as ``"cpu"``.

    Raises:
        BundleError: The class is not one of Stable-Baselines3, or something that the model needs is missing.
    """
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

    try:
        kind = load_named(algorithm, "the policy's algorithm")
    except (ImportError, ValueError) as error:
        raise BundleError(f"{error} The policy needs it.") from error
    if not (isinstance(kind, type) and issubclass(kind, BaseAlgorithm)):
        raise BundleError(f"the policy's algorithm: expected a class of Stable-Baselines3, got {algorithm!r}.")
    # Hindsight replay asks for an environment, and a buffer takes memory; a policy that only acts needs neither.
    idle: dict[str, Any] = {"replay_buffer_class": None, "replay_buffer_kwargs": {}, "buffer_size": 1}
    try:
        custom = idle if issubclass(kind, OffPolicyAlgorithm) else None
        return kind.load(io.BytesIO(data), device=device, custom_objects=custom).policy
    except _UNPICKLING as error:
        raise BundleError(f"the model cannot be read here: {error}") from error
