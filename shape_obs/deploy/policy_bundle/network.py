"""The policy's network in a bundle: its class and arguments as JSON, its weights as tensors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from inspect import Parameter, signature
from typing import TYPE_CHECKING, Any, Final

from shape_obs.deploy.policy_bundle import network_arguments
from shape_obs.deploy.policy_bundle.archive import WEIGHTS
from shape_obs.deploy.policy_bundle.documents import MALFORMED
from shape_obs.deploy.policy_bundle.documents import BundleError
from shape_obs.deploy.policy_bundle.documents import needs_trust
from shape_obs.deploy.policy_bundle.spaces import space_from_dict, space_to_dict
from shape_obs.deploy.policy_bundle.documents import Layout
from shape_obs.deploy.policy_bundle.documents import read_header
from shape_obs.deploy.policy_bundle.documents import read_weights
from shape_obs.utils.documents import load_named

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.policies import BasePolicy

_SB3, _CONTRIB = "stable_baselines3", "sb3_contrib"
#: Algorithms whose ``policy_aliases`` are the policies that are known by name, and the package of each.
ALGORITHMS: Final = {
    **dict.fromkeys(("A2C", "DDPG", "DQN", "PPO", "SAC", "TD3"), _SB3),
    **dict.fromkeys(("ARS", "CrossQ", "MaskablePPO", "QRDQN", "TQC", "TRPO"), _CONTRIB),
}
POLICIES: Final = ("MlpPolicy", "CnnPolicy", "MultiInputPolicy", "LinearPolicy")
#: This library's own, by algorithm.
_OURS: Final = {("SAC", "PixelPolicy"): "shape_obs.training.pixel_policy:PixelPolicy"}
#: As safetensors names PyTorch's types.
_DTYPES: Final = {
    "torch.float64": "F64", "torch.float32": "F32", "torch.float16": "F16", "torch.bfloat16": "BF16",
    "torch.int64": "I64", "torch.int32": "I32", "torch.int16": "I16", "torch.int8": "I8", "torch.uint8": "U8",
    "torch.bool": "BOOL",
}  # fmt: skip


@dataclass(frozen=True)
class Network:
    """What a policy is, without its weights.

    Args:
        algorithm: Its name in ``ALGORITHMS``; of a policy from elsewhere, the name of its class.
        policy: The alias of its policy's class, or ``module:Name``.
        arguments: Of that class, as ``network_arguments.to_json`` gives them.
        observation_space: As ``space_to_dict`` gives it; images are (C,H,W).
        action_space: The same of actions.
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
            BundleError: It is no model of Stable-Baselines3, it has a memory, or it cannot be described.
        """
        from stable_baselines3.common.base_class import BaseAlgorithm

        if not isinstance(model, BaseAlgorithm):
            raise BundleError(f"model: expected one of Stable-Baselines3, got {type(model).__name__}.")
        if hasattr(model, "_last_lstm_states"):
            raise BundleError(f"model: {type(model).__name__} has a recurrent policy, which bundles cannot run.")
        algorithm, policy = _known_names(model)
        arguments = network_arguments.to_json(_accepted(type(model.policy), model.policy._get_constructor_parameters()))
        spaces = space_to_dict(model.observation_space), space_to_dict(model.action_space)
        return cls(algorithm, policy, arguments, *spaces)

    @classmethod
    def from_dict(cls, value: Any) -> Network:
        """Read what was written as ``vars``.

        Raises:
            BundleError: It is something else.
        """
        names = tuple(cls.__dataclass_fields__)
        if not isinstance(value, Mapping) or set(value) != set(names):
            raise BundleError(f"the policy: expected an object of {', '.join(names)}.")
        network = cls(**value)
        if not isinstance(network.algorithm, str) or not isinstance(network.policy, str):
            raise BundleError("the policy: expected the names of an algorithm and of a policy.")
        return network

    def check_known(self) -> None:
        """Refuse what takes trust to build.

        Raises:
            BundleError: A class that is in no closed list, or an argument beyond its limits.
        """
        if self.algorithm not in ALGORITHMS or self.policy not in (*POLICIES, *(name for _, name in _OURS)):
            raise needs_trust(
                f"the policy {self.policy!r} of {self.algorithm!r} is not in the list of those that are read"
            )
        network_arguments.check(self.arguments)

    @property
    def known(self) -> bool:
        """Whether it takes no trust to build."""
        try:
            self.check_known()
        except BundleError:
            return False
        return True

    def build(self, weights: bytes, device: str) -> BasePolicy:
        """Build the policy and load its weights.

        Its shapes are compared with those in the file first, on a device without memory: a few bytes cannot ask for a
        large network. A policy from elsewhere is built at once, since its code was trusted.

        Args:
            weights: The member with its weights.
            device: Where it runs.

        Raises:
            BundleError: The class cannot be had or built, or the weights are another network's.
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
            arguments["ortho_init"] = False  # takes seconds for wide layers, and all weights are replaced
        try:
            if self.known:
                _check_layouts(kind, spaces, arguments, stored)
            state = read_weights(weights, WEIGHTS)
            del weights  # the largest part of a bundle, and the policy is to have its own
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
    """(algorithm, policy) from the closed lists; else the names of the classes themselves."""
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


def _check_layouts(kind: Any, spaces: list[Any], arguments: Mapping[str, Any], stored: Mapping[str, Layout]) -> None:
    """Compare the tensors of a policy, without memory for them, with those of a file.

    With state-dependent exploration a policy draws random numbers when it is built, which takes memory. So the policy
    without it is compared: it differs in the names of one layer and in ``log_std``, which is as large as that layer.
    """
    import torch

    class Sketch(kind):
        """The policy on PyTorch's device for shapes alone, which its parts are otherwise moved away from."""

        device = property(lambda self: torch.device("meta"))

    noisy = bool(arguments.get("use_sde"))
    plain = {"use_sde": False, "squash_output": False} if noisy else {}
    with torch.device("meta"):
        state = Sketch(
            *spaces, **{**arguments, **{name: plain[name] for name in plain if name in arguments}}
        ).state_dict()
    sketched = {name: Layout(_DTYPES[str(tensor.dtype)], tuple(tensor.shape)) for name, tensor in state.items()}
    if noisy:
        sketched, stored = _without_noise(sketched), _without_noise(stored)
    for name in {**sketched, **stored}:
        if sketched.get(name) != stored.get(name):
            raise BundleError(
                f"{WEIGHTS}: tensor {name[:80]!r}: the policy has {_worded(sketched.get(name))}, the file has "
                f"{_worded(stored.get(name))}. Save the policy again."
            )


def _without_noise(layouts: Mapping[str, Layout]) -> dict[str, Layout]:
    return {
        name.replace(".mu.0.", ".mu."): layout for name, layout in layouts.items() if "log_std" not in name.split(".")
    }


def _worded(layout: Layout | None) -> str:
    return "none" if layout is None else f"{layout.dtype} of shape {list(layout.shape)}"


def _accepted(kind: type[Any], arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Those arguments that a class takes: a policy may report its base class's."""
    parameters = signature(kind).parameters
    if any(parameter.kind is Parameter.VAR_KEYWORD for parameter in parameters.values()):
        return dict(arguments)
    return {name: value for name, value in arguments.items() if name in parameters}


class _NoOptimizer:
    """Stands in for an optimizer, which takes memory, and seconds to import."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        """Take what an optimizer takes."""


def _no_learning(_: float) -> float:
    return 0.0
