"""Limit what a bundle that is not trusted may ask for: environments, wrappers, configurations and numbers.

Without trust, code comes only from what is registered or installed here. The entry point of an environment is the one
in the registry, and wrappers come from a closed list.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import fields, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from shape_obs.config.detector_config import DetectorConfig
from shape_obs.configurations.base import Configuration
from shape_obs.deploy.policy_bundle.documents import BundleError, is_number, needs_trust
from shape_obs.features import Feature, read_features
from shape_obs.geometry.topology import Grid
from shape_obs.spec import did_you_mean, to_plain, without_plugins

if TYPE_CHECKING:
    from gymnasium.envs.registration import EnvSpec, WrapperSpec

#: Largest number by name, wherever the name occurs; all other numbers may be up to ``MOST_NUMBER``.
MOST: Final = {
    "n": 1000, "rows": 100, "cols": 100, "count": 100, "epochs": 100, "harmonics": 64, "degree": 32,
    "coefficients": 200, "open": 255, "close": 255, "n_init": 20, "max_iter": 1000, "steps": 1000,
    "stack_size": 8, "skip": 100, "delay": 100, "max_episode_steps": 10**9,
}  # fmt: skip
MOST_NUMBER: Final = 10**6
MOST_SHAPES, MOST_FEATURES = 8, 16
#: Points of one shape, and of all shapes together.
MOST_POINTS, MOST_POINTS_TOGETHER = 1024, 4096
#: Multiplications for fitting the bases of all features, about a third of a second.
MOST_WORK: Final = 5e9
#: Pixels of one side of an image.
MOST_SIDE: Final = 640

_PACKAGE: Final = "shape_obs_envs"
_SIMULATED: Final = (
    "camera", "renderer", "reward_type", "render_mode", "success_threshold", "difficulty", "render_observation",
    "render_size", "randomize",
)  # fmt: skip
#: The environments of this package, with those of their arguments that name neither code nor files.
OWN_IDS: Final = {
    **dict.fromkeys(("ShapeObs/Cable-v0", "ShapeObs/CableShape-v0"), (*_SIMULATED, "grippers")),
    **dict.fromkeys(
        ("ShapeObs/Ring-v0", "ShapeObs/RingShape-v0", "ShapeObs/Cloth-v0", "ShapeObs/ClothShape-v0"), _SIMULATED
    ),
    **dict.fromkeys(("ShapeObs/Hanging-v0", "ShapeObs/HangingShape-v0"), (*_SIMULATED, "grippers", "view", "step")),
    **dict.fromkeys(("ShapeObs/Cables-v0", "ShapeObs/CablesShape-v0"), (*_SIMULATED, "ropes", "grippers", "rope")),
    "ShapeObs/D455-v0": (
        "source", "rate", "size", "timeout", "settle", "max_age", "max_step", "workspace", "render_mode",
    ),
}  # fmt: skip
_CAMERA: Final = re.compile(r"robot|d455(:[\w-]+)?")
_SIZES: Final = ("camera", "render_size", "size", "shape")
#: The wrappers of this library and their entry points.
OWN_WRAPPERS: Final = {
    "ShapeObservation": "shape_obs.wrappers.shape_observation:ShapeObservation",
    "ShapeGoal": "shape_obs.wrappers.shape_goal:ShapeGoal",
    "Curriculum": "shape_obs.training.curriculum:Curriculum",
    "Pixels": "shape_obs.training.comparisons:Pixels",
    "PointReward": "shape_obs.training.point_reward:PointReward",
    "Shuffled": "shape_obs.training.comparisons:Shuffled",
    "TrueState": "shape_obs.training.comparisons:TrueState",
    "D455Noise": "shape_obs_envs.d455.noise:D455Noise",
}
#: Entry points of this library's wrappers in bundles of earlier releases, and the name of the wrapper.
FORMER_ENTRY_POINTS: Final = {
    "shape_obs.training.pixels:Pixels": "Pixels",
    "shape_obs.training.shuffled:Shuffled": "Shuffled",
    "shape_obs.training.true_state:TrueState": "TrueState",
    "shape_obs_envs.d455.noise:D455Noise": "D455Noise",
}
#: Gymnasium's wrappers that take no function and keep no statistics of observations, and their arguments.
GYMNASIUM_WRAPPERS: Final[Mapping[str, tuple[str, ...]]] = {
    "AddRenderObservation": ("render_only", "render_key", "obs_key"),
    "Autoreset": (),
    "ClipAction": (),
    "ClipReward": ("min_reward", "max_reward"),
    "DelayObservation": ("delay",),
    "FilterObservation": ("filter_keys",),
    "FlattenObservation": (),
    "FrameStackObservation": ("stack_size", "padding_type"),
    "GrayscaleObservation": ("keep_dim",),
    "MaxAndSkipObservation": ("skip",),
    "NormalizeReward": ("gamma", "epsilon"),
    "OrderEnforcing": ("disable_render_order_enforcing",),
    "RescaleAction": ("min_action", "max_action"),
    "RescaleObservation": ("min_obs", "max_obs"),
    "ReshapeObservation": ("shape",),
    "ResizeObservation": ("shape",),
    "StickyAction": ("repeat_action_probability", "repeat_action_duration"),
    "TimeAwareObservation": ("flatten", "normalize_time", "dict_time_key"),
    "TimeLimit": ("max_episode_steps",),
}


# ---- Configurations and numbers


def check_numbers(value: Any, what: str, name: str = "") -> None:
    """Refuse numbers in JSON values that exceed their limits or are not finite.

    Raises:
        BundleError: The message names the number.
    """
    if isinstance(value, Mapping):
        for key, inner in value.items():
            check_numbers(inner, what, str(key))
    elif isinstance(value, list):
        for inner in value:
            check_numbers(inner, what, name)
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        most = MOST.get(name, MOST_NUMBER)
        if not is_number(value) or abs(value) > most:
            raise needs_trust(f"{what}: {name or 'a number'} is {value!r:.40}, expected a finite number up to {most}")


def check_configuration(arguments: Mapping[str, Any], what: str) -> None:
    """Refuse arguments of a ``ShapeObservation`` that are invalid, name a plugin or code, or ask for too much.

    A kind of another package is known if that package has been imported.

    Args:
        arguments: Arguments of a ``ShapeObservation``, or the sections of a configuration.
        what: Where they were found, for error messages.

    Raises:
        BundleError: The message gives the reason.
        ValueError: A value is invalid.
    """
    check_numbers(arguments, what)
    workspace = arguments.get("workspace")
    if workspace is not None and not _is_box(workspace):
        raise BundleError(f"{what}: workspace: expected two corners of three numbers, got {workspace!r:.100}.")
    given = {field.name for field in fields(DetectorConfig)} & arguments.keys()
    with without_plugins():
        config = DetectorConfig.from_dict({name: arguments[name] for name in given})
        features = read_features(arguments.get("features") or ())
    for path in config.code_paths:
        raise needs_trust(_names_code(what, path))
    shapes = config.shapes
    counts = [shape.layout.size for shape in shapes]
    if len(shapes) > MOST_SHAPES or max(counts) > MOST_POINTS or sum(counts) > MOST_POINTS_TOGETHER:
        raise needs_trust(
            f"{what}: expected at most {MOST_SHAPES} shapes of {MOST_POINTS} points, {MOST_POINTS_TOGETHER} together, "
            f"got {len(shapes)} of up to {max(counts)}, {sum(counts)} together"
        )
    if len(features) > MOST_FEATURES:
        raise needs_trust(f"{what}: expected at most {MOST_FEATURES} features, got {len(features)}")
    if sum(_work(feature, shape) for feature in features for shape in shapes) > MOST_WORK:
        raise needs_trust(f"{what}: its features have too many coefficients for so many points")


def check_goal(arguments: Mapping[str, Any], what: str) -> None:
    """Refuse arguments of a ``ShapeGoal``; raise as ``check_configuration`` does."""
    check_numbers(arguments, what)
    goal, features = arguments.get("goal"), arguments.get("features") or ()
    with without_plugins():
        for item in [features] if isinstance(features, (str, Mapping)) else features:
            if isinstance(item, str) and item not in Feature.kinds():
                raise BundleError(f"{what}: unknown feature {item!r}{did_you_mean(item, Feature.kinds())}")
            if not isinstance(item, str):
                read_features(item)
        # The goal of one shape, or a mapping from the names of shapes to their goals.
        for each in [goal, *goal.values()] if isinstance(goal, Mapping) else []:
            if isinstance(each, Mapping) and each.get("configuration") is not None:
                rule = Configuration.from_dict(each["configuration"]).segmentation
                if rule is not None and rule.code_path:
                    raise needs_trust(_names_code(what, rule.code_path))


def _names_code(what: str, path: str) -> str:
    return f"{what}: the segmentation is code to import, {path!r:.100}"


def _is_box(value: Any) -> bool:
    corners = list(value) if isinstance(value, (list, tuple)) else []
    numbers = [
        number for corner in corners if isinstance(corner, (list, tuple)) and len(corner) == 3 for number in corner
    ]
    return len(corners) == 2 and len(numbers) == 6 and all(map(is_number, numbers))


def _work(feature: Feature, shape: Configuration) -> float:
    """Estimate the number of multiplications for fitting the basis of a feature."""
    own = (
        2 * getattr(feature, "harmonics", 0) + 1,
        getattr(feature, "degree", 0) + 1,
        getattr(feature, "coefficients", 0),
    )
    points, functions = shape.layout.size, max(own)
    functions = min(points, functions**2 if isinstance(shape.layout, Grid) else functions)
    return 10.0 * functions**3 + 5.0 * points * functions**2


# ---- Environments and wrappers


def registered_spec(name: str) -> EnvSpec | None:
    """Return the registered spec of an environment; this package's environments are registered on demand."""
    from gymnasium.envs.registration import registry

    if name not in registry and name in OWN_IDS:
        import_module(_PACKAGE)
    return registry.get(name)


def check_rebuildable(spec: EnvSpec) -> EnvSpec:
    """Return the registered spec of the same id; refuse a spec that needs trust to be rebuilt.

    Raises:
        BundleError: The message names the part that needs trust.
    """
    known = registered_spec(spec.id)
    if known is None:
        raise needs_trust(
            f"the environment {spec.id} is not registered here. Import the package that registers it first. The file "
            "also names code for it"
        )
    if spec.id in OWN_IDS:
        _check_own(spec)
    else:
        for name, value in spec.kwargs.items():
            if name not in known.kwargs or to_plain(known.kwargs[name]) != value:
                _check_foreign(value, f"the argument {name} of {spec.id}")
    names = [wrapper.name for wrapper in spec.additional_wrappers]
    for wrapper in spec.additional_wrappers:
        check_wrapper(wrapper)
        if names.count(wrapper.name) > 1:
            raise needs_trust(f"the environment has two wrappers {wrapper.name}")
    return known


def check_wrapper(wrapper: WrapperSpec) -> WrapperSpec:
    """Return a wrapper with the entry point of the closed list; refuse one that is not in the list.

    Raises:
        BundleError: The message names the wrapper.
    """
    name, path, kwargs = wrapper.name, wrapper.entry_point, wrapper.kwargs or {}
    own = OWN_WRAPPERS.get(name)
    module = path.partition(":")[0]
    theirs = GYMNASIUM_WRAPPERS.get(name) if f"{module}.".startswith("gymnasium.wrappers.") else None
    if path != own and theirs is None:
        raise needs_trust(f"the wrapper {name} ({path:.100}) is not in the list of those that are rebuilt")
    unknown = [key for key in kwargs if theirs is not None and key not in theirs]
    if unknown:
        raise needs_trust(f"the wrapper {name} has the argument {unknown[0]!r}, which is not in the list")
    check_numbers(kwargs, f"the wrapper {name}")
    if name != "ShapeGoal":  # whose shape= is a name or several
        _check_sizes(kwargs, f"the wrapper {name}")
    return replace(wrapper, entry_point=own or f"gymnasium.wrappers:{name}")


def _check_own(spec: EnvSpec) -> None:
    """Refuse arguments of this package's environments that name code or files, or ask for large images."""
    for name, value in spec.kwargs.items():
        if name not in OWN_IDS[spec.id] and value is not None:
            raise needs_trust(f"the environment {spec.id} has {name}={value!r:.100}, which may name code or a file")
    source = spec.kwargs.get("source")
    if source is not None and not (isinstance(source, str) and _CAMERA.fullmatch(source)):
        raise needs_trust(f"the environment {spec.id} has source={source!r:.100}; only a camera is opened")
    check_numbers(spec.kwargs, f"the environment {spec.id}")
    _check_sizes(spec.kwargs, f"the environment {spec.id}")


def _check_sizes(arguments: Mapping[str, Any], what: str) -> None:
    for name in _SIZES:
        sides = arguments.get(name)
        if isinstance(sides, list) and any(not isinstance(side, int) or side > MOST_SIDE for side in sides):
            raise needs_trust(f"{what}: {name} is {sides!r:.60}, expected sides of at most {MOST_SIDE} pixels")


def _check_foreign(value: Any, what: str) -> None:
    """Refuse values that an environment of another package may read as code, a file or a large number."""
    if isinstance(value, Mapping):
        for inner in value.values():
            _check_foreign(inner, what)
    elif isinstance(value, list):
        for inner in value:
            _check_foreign(inner, what)
    elif isinstance(value, str):
        if len(value) > 100 or re.search(r"[:/\\]|\.\w", value):
            raise needs_trust(f"{what} is {value!r:.100}, which may name code or a file")
    else:
        check_numbers(value, what)
