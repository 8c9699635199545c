"""Describe the environment of a training as JSON values, and rebuild it from them."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from shape_obs.deploy.policy_bundle.documents import MALFORMED, BundleError, needs_trust
from shape_obs.deploy.policy_bundle.limits import (
    FORMER_ENTRY_POINTS,
    OWN_WRAPPERS,
    check_configuration,
    check_goal,
    check_rebuildable,
    check_wrapper,
    registered_spec,
)

if TYPE_CHECKING:
    import gymnasium as gym
    from gymnasium.envs.registration import EnvSpec, WrapperSpec

MOST_WRAPPERS: Final = 16
_FIELDS: Final = ("id", "entry_point", "max_episode_steps", "order_enforce", "kwargs", "wrappers")
_ID: Final = re.compile(r"(?:[\w.-]+/)?[\w.-]+")
_MOST_EPISODE: Final = 10**9

#: Wrappers that only observe a training. Some take functions, which cannot be written as JSON.
_WATCHERS: Final = ("Monitor", "RecordVideo", "RecordEpisodeStatistics", "PassiveEnvChecker", "HumanRendering")
#: Wrappers that are needed only in training; on a robot, the action limiter clips actions.
_TRAINING: Final = (
    "TimeLimit", "OrderEnforcing", "Curriculum", "ClipAction", "Autoreset", "ClipReward", "NormalizeReward",
)  # fmt: skip
#: Wrappers that turn the detected shape into the observation of the policy.
_READING: Final = ("ShapeGoal", "PointReward", "FlattenObservation", "FilterObservation")
_SHAPE: Final = "ShapeObservation"
_SIMULATION_ONLY: Final = {
    "TrueState": "it reads the simulator's state, which no camera can measure",
    "Pixels": "its goals come from the simulator's state, and it reads the images of one camera",
    "Shuffled": "its points are shuffled for comparison",
}
#: Wrappers of vector environments that leave observations alone, except that Stable-Baselines3 transposes images.
_VECTOR: Final = ("VecNormalize", "VecTransposeImage", "VecMonitor", "VecCheckNan", "VecVideoRecorder")
_ROBOT_KEYS: Final = ("rgb", "depth", "robot")
#: Names of attributes in which wrappers keep statistics, such as "obs_rms", "running_mean" and "std".
_STATISTIC: Final = re.compile(r"(^|_)(mean|average|avg|var|variance|std|m2|rms|stats)(_|$)")


# ---- As JSON values


def to_dict(spec: EnvSpec) -> dict[str, Any]:
    """Describe a spec as JSON values."""
    return {
        "id": spec.id,
        "entry_point": spec.entry_point if isinstance(spec.entry_point, str) else None,
        "max_episode_steps": spec.max_episode_steps,
        "order_enforce": spec.order_enforce,
        "kwargs": dict(spec.kwargs),
        "wrappers": [
            {"name": wrapper.name, "entry_point": wrapper.entry_point, "kwargs": dict(wrapper.kwargs or {})}
            for wrapper in spec.additional_wrappers
        ],
    }


def from_dict(value: Mapping[str, Any], *, trust: bool) -> EnvSpec:
    """Read the description that ``to_dict`` wrote; ``rebuild``, not this function, refuses what needs trust.

    Raises:
        BundleError: It is something else, or the configuration of a wrapper asks for too much.
    """
    from gymnasium.envs.registration import EnvSpec

    if set(value) != set(_FIELDS):
        raise BundleError(f"the environment: expected {', '.join(_FIELDS)}, got {', '.join(sorted(value))[:200]}.")
    name, steps, wrappers = value["id"], value["max_episode_steps"], value["wrappers"]
    if not isinstance(name, str) or not (trust or _ID.fullmatch(name)):
        raise needs_trust(f"the environment's id is {name!r:.100}, which names a module to import")
    if not (steps is None or (type(steps) is int and 0 < steps <= _MOST_EPISODE)):
        raise BundleError(f"the environment's max_episode_steps: expected a whole number above 0, got {steps!r:.40}.")
    if not isinstance(value["kwargs"], Mapping) or not isinstance(wrappers, list) or len(wrappers) > MOST_WRAPPERS:
        raise BundleError(f"the environment: expected arguments by name and at most {MOST_WRAPPERS} wrappers.")
    parts = [_wrapper(wrapper) for wrapper in wrappers]
    for wrapper in parts:
        if not trust and wrapper.name in ("ShapeObservation", "ShapeGoal"):
            check = check_configuration if wrapper.name == "ShapeObservation" else check_goal
            check(wrapper.kwargs or {}, f"the wrapper {wrapper.name}")
    return EnvSpec(
        name,
        value["entry_point"] if trust and isinstance(value["entry_point"], str) else None,
        max_episode_steps=steps,
        order_enforce=value["order_enforce"] is not False,
        kwargs=dict(value["kwargs"]),
        additional_wrappers=tuple(parts),
    )


def from_gymnasium(value: Mapping[str, Any]) -> EnvSpec:
    """Read a spec that Gymnasium wrote, as bundles of version 1 hold it.

    Raises:
        ValueError: It is something else.
    """
    from gymnasium.envs.registration import EnvSpec

    spec = EnvSpec.from_json(json.dumps(value))
    return replace(spec, additional_wrappers=tuple(map(_with_present_path, spec.additional_wrappers)))


def _wrapper(value: Any) -> WrapperSpec:
    from gymnasium.envs.registration import WrapperSpec

    if not isinstance(value, Mapping) or set(value) != {"name", "entry_point", "kwargs"}:
        raise BundleError("the environment's wrappers: expected name, entry_point and kwargs of each.")
    texts = isinstance(value["name"], str) and isinstance(value["entry_point"], str)
    if not texts or not isinstance(value["kwargs"], Mapping):
        raise BundleError("the environment's wrappers: expected two texts and arguments by name of each.")
    return _with_present_path(WrapperSpec(**value))


def _with_present_path(wrapper: WrapperSpec) -> WrapperSpec:
    """Replace an entry point of an earlier release, where this library's wrapper has moved since."""
    if FORMER_ENTRY_POINTS.get(wrapper.entry_point) != wrapper.name:
        return wrapper
    return replace(wrapper, entry_point=OWN_WRAPPERS[wrapper.name])


# ---- Rebuild


def rebuild(spec: EnvSpec, *, trust: bool, arguments: Mapping[str, Any]) -> gym.Env[Any, Any]:
    """Make the environment.

    Args:
        spec: Spec as ``from_dict`` returned it.
        trust: Whether to follow entry points and import paths of the file.
        arguments: Arguments for ``gymnasium.make``, which replace those of the spec.

    Raises:
        BundleError: The environment needs trust, or cannot be made.
        ImportError: A simulator is not installed.
    """
    import gymnasium as gym

    if trust:
        spec = _with_entry_point(spec)
    else:
        spec = replace(
            check_rebuildable(spec),
            kwargs=spec.kwargs,
            max_episode_steps=spec.max_episode_steps,
            order_enforce=spec.order_enforce,
            additional_wrappers=tuple(check_wrapper(wrapper) for wrapper in spec.additional_wrappers),
        )
    try:
        return gym.make(spec, **{"disable_env_checker": True, **arguments})
    except (*MALFORMED, OSError, gym.error.Error) as error:
        raise BundleError(f"the environment {spec.id} cannot be rebuilt: {error}") from error


def _with_entry_point(spec: EnvSpec) -> EnvSpec:
    """Fill in the entry point of the registry if the file has none, after importing the module in the id."""
    module, _, name = spec.id.rpartition(":")
    if module:
        import_module(module)
    known = registered_spec(name)
    if spec.entry_point is None and known is not None:
        return replace(spec, id=name, entry_point=known.entry_point)
    return replace(spec, id=name)


# ---- Wrappers of a training


def training_spec(env: Any) -> EnvSpec:
    """Return the spec of an environment, or of the first of a vector environment, without wrappers that only observe.

    Raises:
        BundleError: The environment cannot be rebuilt from its spec; the message names the wrapper or argument.
    """
    from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

    normalized = 0
    while isinstance(env, VecEnvWrapper):
        normalized += type(env).__name__ == "VecNormalize"
        if type(env).__name__ not in _VECTOR or normalized > 1:
            raise BundleError(
                f"a bundle cannot store how {type(env).__name__} changes observations; known wrappers of vector "
                f"environments are {', '.join(_VECTOR)}, each once."
            )
        env = env.venv
    spec = env.get_attr("spec")[0] if isinstance(env, VecEnv) else env.spec
    if spec is None:
        raise BundleError("the environment has no spec to be rebuilt from: make it with gymnasium.make.")
    kept = tuple(wrapper for wrapper in spec.additional_wrappers if wrapper.name not in _WATCHERS)
    unknown = [wrapper.name for wrapper in kept if wrapper.kwargs is None]
    if unknown:
        raise BundleError(
            f"the wrapper {unknown[0]} does not record its arguments, so the environment cannot be rebuilt: derive it "
            "from gymnasium.utils.RecordConstructorArgs too."
        )
    place = f"the environment {spec.id}"
    try:
        json.dumps(dict(spec.kwargs))
        for wrapper in kept:
            place = f"the wrapper {wrapper.name}"
            json.dumps(dict(wrapper.kwargs or {}))
        described = json.loads(json.dumps(to_dict(replace(spec, additional_wrappers=kept))))
    except (TypeError, ValueError) as error:
        raise BundleError(
            f"{place}: its arguments cannot be written as JSON: {error}: give plain numbers and texts."
        ) from error
    return from_dict(described, trust=True)


def check_statistics(rebuilt: gym.Env[Any, Any], trained: Sequence[Any]) -> None:
    """Refuse wrappers whose statistics of the training are not in the spec, and would be lost.

    Args:
        rebuilt: The environment that was made from the spec.
        trained: Environments of the training, vector environments or not.

    Raises:
        BundleError: The message names the wrapper.
    """
    import gymnasium as gym

    env = rebuilt
    while isinstance(env, gym.Wrapper):
        for name, value in vars(env).items():
            counted = all(hasattr(value, part) for part in ("mean", "var", "count"))
            numbers = isinstance(value, (float, np.ndarray)) and _STATISTIC.search(name.lower()) is not None
            differs = numbers and not all(np.array_equal(value, _attribute(each, name)) for each in trained)
            if (counted or differs) and not isinstance(env, (gym.wrappers.NormalizeReward, gym.RewardWrapper)):
                raise BundleError(
                    f"a bundle cannot store the statistics that the wrapper {type(env).__name__} keeps in {name!r}: "
                    "normalise with VecNormalize of Stable-Baselines3, whose statistics it stores."
                )
        env = env.env


def _attribute(env: Any, name: str) -> Any:
    """Return an attribute of a wrapper, of the first environment if there are several; None if there is none."""
    from stable_baselines3.common.vec_env import VecEnv

    try:
        return env.get_attr(name)[0] if isinstance(env, VecEnv) else env.get_wrapper_attr(name)
    except AttributeError:
        return None


def reading_wrappers(spec: EnvSpec) -> list[WrapperSpec]:
    """Return the policy's own wrappers around its ``ShapeObservation``, the innermost first."""
    shape = _shape_at([wrapper.name for wrapper in spec.additional_wrappers])
    return [wrapper for wrapper in spec.additional_wrappers[shape + 1 :] if wrapper.name in _READING]


def obstacle(spec: EnvSpec) -> str:
    """Return why a policy that was trained in this environment cannot run with a camera; ``""`` if it can."""
    names = [wrapper.name for wrapper in spec.additional_wrappers]
    for name, reason in _SIMULATION_ONLY.items():
        if name in names:
            return f"{reason} ({name})"
    if _SHAPE not in names:
        return "it does not read shapes: there is no ShapeObservation in its environment"
    kept = (spec.additional_wrappers[_shape_at(names)].kwargs or {}).get("keep") or ()
    return _missing(kept) or unknown_wrapper(spec)


def _missing(kept: Iterable[str]) -> str:
    missing = [key for key in kept if key not in _ROBOT_KEYS]
    return f"it also reads {', '.join(missing)}, which only its simulator provides (keep)" if missing else ""


def unknown_wrapper(spec: EnvSpec) -> str:
    """Return which wrapper around the ``ShapeObservation`` has an unknown effect on a robot; ``""`` if none has."""
    names = [wrapper.name for wrapper in spec.additional_wrappers]
    around = names[_shape_at(names) + 1 :]
    unknown = [name for name in around if name not in (*_READING, *_TRAINING, *_SIMULATION_ONLY)]
    return f"it is not known what the wrapper {unknown[0]} does on a robot" if unknown else ""


def _shape_at(names: Sequence[str]) -> int:
    """Return the place of the outermost ``ShapeObservation`` among wrappers; past all of them if there is none."""
    return len(names) - 1 - names[::-1].index(_SHAPE) if _SHAPE in names else len(names)
