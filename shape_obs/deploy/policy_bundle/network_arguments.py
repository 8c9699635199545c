"""Convert the arguments of a policy's class to JSON values and back, and limit how large each may be.

Classes among the arguments are named by closed lists; any other class is named ``module:Name`` and needs trust.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any, Final

from shape_obs.deploy.policy_bundle.documents import BundleError, is_number, needs_trust
from shape_obs.utils.documents import load_named

#: Activation functions in ``torch.nn``.
ACTIVATIONS: Final = (
    "CELU", "ELU", "GELU", "Hardswish", "Identity", "LeakyReLU", "Mish", "ReLU", "ReLU6", "SELU", "SiLU", "Sigmoid",
    "Softplus", "Softsign", "Tanh",
)  # fmt: skip
_LAYERS: Final = "stable_baselines3.common.torch_layers"
_OURS: Final = "shape_obs.training.extractors"
#: Feature extractors and their modules.
EXTRACTORS: Final = {
    "FlattenExtractor": _LAYERS,
    "NatureCNN": _LAYERS,
    "CombinedExtractor": _LAYERS,
    "GoalDifference": _OURS,
    "ImageAndGoal": _OURS,
}
#: Known classes and their modules, by argument.
_CLASSES: Final = {
    "activation_fn": dict.fromkeys(ACTIVATIONS, "torch.nn"),
    "features_extractor_class": EXTRACTORS,
}
#: Arguments that a policy does not need for acting.
_TRAINING: Final = ("lr_schedule", "optimizer_class", "optimizer_kwargs", "observation_space", "action_space")
_FLAGS: Final = (
    "use_sde", "full_std", "use_expln", "squash_output", "ortho_init", "share_features_extractor", "normalize_images",
    "with_bias", "batch_norm", "normalized_image",
)  # fmt: skip
MOST_WIDTH: Final = 16_384
#: Smallest and largest value of whole numbers, and of all other numbers.
_WHOLE: Final = {
    "n_critics": (1, 16), "n_quantiles": (1, 1000), "top_quantiles_to_drop_per_net": (0, 1000),
    "renorm_warmup_steps": (0, 10**9), "features_dim": (1, MOST_WIDTH), "cnn_output_dim": (1, MOST_WIDTH),
    "features": (1, MOST_WIDTH), "visible": (1, 10**6),
}  # fmt: skip
_REAL: Final = {
    "log_std_init": (-100, 100), "clip_mean": (0, 1e6), "batch_norm_momentum": (0, 1), "batch_norm_eps": (0, 1),
}  # fmt: skip
MOST_LAYERS: Final = 16


def to_json(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Describe the arguments of a policy's constructor, without those that only training needs.

    Raises:
        BundleError: An argument is neither a JSON value nor a class that can be imported.
    """
    return {name: _to_json(name, value) for name, value in arguments.items() if name not in _TRAINING}


def check(arguments: Any) -> None:
    """Refuse arguments that are not in the closed lists or exceed their limits.

    Raises:
        BundleError: The message names the argument and says that it needs trust.
    """
    if not isinstance(arguments, Mapping):
        raise BundleError(f"the policy's arguments: expected an object, got {type(arguments).__name__}.")
    for name, value in arguments.items():
        if name == "features_extractor_kwargs":
            if not isinstance(value, Mapping) or set(value) & ({"net_arch", name} | set(_CLASSES)):
                raise BundleError(f"the policy's {name}: expected numbers by name, got {value!r:.100}.")
            check(value)
        elif not _allowed(name, value):
            raise needs_trust(f"the policy's argument {name}={value!r:.100} is not in the list of those that are read")


def from_json(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Replace names of classes by the classes, importing those named ``module:Name``.

    Raises:
        BundleError: A class does not exist here.
    """
    return {
        name: named(value, _CLASSES[name], name) if name in _CLASSES and isinstance(value, str) else value
        for name, value in arguments.items()
    }


def name_of(kind: type[Any], closed: Mapping[str, str], what: str) -> str:
    """Return the name of a class in a closed list, else ``module:Name``.

    Raises:
        BundleError: The class was defined inside a function or class, so it cannot be imported.
    """
    if kind.__name__ in closed and getattr(import_module(closed[kind.__name__]), kind.__name__, None) is kind:
        return kind.__name__
    if "<locals>" in kind.__qualname__ or "." in kind.__qualname__:
        raise BundleError(f"{what}: {kind.__qualname__} cannot be imported; define it at the top of a module.")
    return f"{kind.__module__}:{kind.__name__}"


def named(name: str, closed: Mapping[str, str], what: str) -> Any:
    """Return the class of a name that ``name_of`` returned.

    Raises:
        BundleError: There is no such class.
    """
    try:
        return load_named(name if ":" in name else f"{closed[name]}:{name}", what)
    except (KeyError, ImportError, ValueError) as error:
        raise BundleError(f"the policy's {what}: {error}") from error


def _allowed(name: str, value: Any) -> bool:
    if name in _CLASSES:
        return isinstance(value, str) and value in _CLASSES[name]
    if name == "net_arch":
        parts = [*value.values()] if isinstance(value, Mapping) and set(value) <= {"pi", "vf", "qf"} else [value]
        return all(_layers(part) for part in parts)
    if name in _FLAGS:
        return value is None or isinstance(value, bool)
    limits = {**_WHOLE, **_REAL}.get(name)
    if limits is None:
        return False
    if value is None:
        return True
    return is_number(value) and (name in _REAL or isinstance(value, int)) and limits[0] <= value <= limits[1]


def _layers(value: Any) -> bool:
    return (
        isinstance(value, list)
        and len(value) <= MOST_LAYERS
        and all(type(width) is int and 1 <= width <= MOST_WIDTH for width in value)
    )


def _to_json(name: str, value: Any) -> Any:
    if isinstance(value, type):
        return name_of(value, _CLASSES.get(name, {}), name)
    if isinstance(value, Mapping):
        return {str(key): _to_json(str(key), item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_to_json(name, item) for item in value]
    if hasattr(value, "item") and getattr(value, "ndim", None) == 0:
        value = value.item()
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise BundleError(f"the policy's argument {name} is a {type(value).__name__}, which a bundle cannot hold.")
