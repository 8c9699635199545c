"""The environment of a training in a bundle: its id, arguments and wrappers, and how it is rebuilt.

Without trust, code comes from what is registered or installed here alone: the entry point of an id is that of the
registry, and wrappers come from a closed list.

The wrappers of a training env: which of them can be rebuilt, and which belong to the policy on a robot.
"""

from __future__ import annotations
import re
from collections.abc import Mapping
from dataclasses import replace
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final
from shape_obs.deploy.policy_bundle.documents import MALFORMED
from shape_obs.deploy.policy_bundle.documents import BundleError
from shape_obs.deploy.policy_bundle.documents import needs_trust
from shape_obs.deploy.policy_bundle.limits import check_configuration, check_goal, check_numbers
from shape_obs.spec import to_plain
if TYPE_CHECKING:
    import gymnasium as gym
    from gymnasium.envs.registration import EnvSpec, WrapperSpec
import json
from collections.abc import Iterable
if TYPE_CHECKING:
    from gymnasium.envs.registration import EnvSpec, WrapperSpec


_PACKAGE: Final = "shape_obs_envs"

_SIMULATED: Final = (
    "camera", "renderer", "reward_type", "render_mode", "success_threshold", "difficulty", "render_observation",
    "render_size", "randomize",
)  # fmt: skip

#: This package's environments, and the arguments of each that name no code and no file.
OWN_IDS: Final = {
    **dict.fromkeys(("ShapeObs/Cable-v0", "ShapeObs/CableShape-v0"), (*_SIMULATED, "grippers")),
    **dict.fromkeys(
        ("ShapeObs/Ring-v0", "ShapeObs/RingShape-v0", "ShapeObs/Cloth-v0", "ShapeObs/ClothShape-v0"), _SIMULATED
    ),
    "ShapeObs/D455-v0": (
        "source", "rate", "size", "timeout", "settle", "max_age", "max_step", "workspace", "render_mode",
    ),
}  # fmt: skip

_CAMERA: Final = re.compile(r"robot|d455(:[\w-]+)?")

_SIZES: Final = ("camera", "render_size", "size", "shape")

#: Pixels of a side of an image.
MOST_SIDE: Final = 640

#: This library's wrappers: where each is.
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

#: Gymnasium's wrappers that take no function and keep no statistics, and their arguments.
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
    "OrderEnforcing": ("disable_render_order_enforcing",),
    "RescaleAction": ("min_action", "max_action"),
    "RescaleObservation": ("min_obs", "max_obs"),
    "ReshapeObservation": ("shape",),
    "ResizeObservation": ("shape",),
    "StickyAction": ("repeat_action_probability", "repeat_action_duration"),
    "TimeAwareObservation": ("flatten", "normalize_time", "dict_time_key"),
    "TimeLimit": ("max_episode_steps",),
}

MOST_WRAPPERS: Final = 16

_FIELDS: Final = ("id", "entry_point", "max_episode_steps", "order_enforce", "kwargs", "wrappers")

_ID: Final = re.compile(r"(?:[\w.-]+/)?[\w.-]+")

_MOST_EPISODE: Final = 10**9



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
    """Read what ``to_dict`` described; what needs trust to be rebuilt is refused by ``rebuild``, not here.

    Raises:
        BundleError: It is something else, or the configuration of a wrapper asks for too much.
    """
    from gymnasium.envs.registration import EnvSpec, WrapperSpec

    if set(value) != set(_FIELDS):
        raise BundleError(f"the environment: expected {', '.join(_FIELDS)}, got {', '.join(sorted(value))[:200]}.")
    name, steps, wrappers = value["id"], value["max_episode_steps"], value["wrappers"]
    if not isinstance(name, str) or not (trust or _ID.fullmatch(name)):
        raise needs_trust(f"the environment's id is {name!r:.100}, which names a module to import")
    if not (steps is None or (type(steps) is int and 0 < steps <= _MOST_EPISODE)):
        raise BundleError(f"the environment's max_episode_steps: expected a whole number above 0, got {steps!r:.40}.")
    if not isinstance(value["kwargs"], Mapping) or not isinstance(wrappers, list) or len(wrappers) > MOST_WRAPPERS:
        raise BundleError(f"the environment: expected arguments by name and at most {MOST_WRAPPERS} wrappers.")
    parts = []
    for wrapper in wrappers:
        if not isinstance(wrapper, Mapping) or set(wrapper) != {"name", "entry_point", "kwargs"}:
            raise BundleError("the environment's wrappers: expected name, entry_point and kwargs of each.")
        texts = isinstance(wrapper["name"], str) and isinstance(wrapper["entry_point"], str)
        if not texts or not isinstance(wrapper["kwargs"], Mapping):
            raise BundleError("the environment's wrappers: expected two texts and arguments by name of each.")
        parts.append(WrapperSpec(**wrapper))
        if not trust and wrapper["name"] in ("ShapeObservation", "ShapeGoal"):
            check = check_configuration if wrapper["name"] == "ShapeObservation" else check_goal
            check(wrapper["kwargs"], f"the wrapper {wrapper['name']}")
    return EnvSpec(
        name,
        value["entry_point"] if trust and isinstance(value["entry_point"], str) else None,
        max_episode_steps=steps,
        order_enforce=value["order_enforce"] is not False,
        kwargs=dict(value["kwargs"]),
        additional_wrappers=tuple(parts),
    )



def rebuild(spec: EnvSpec, *, trust: bool, arguments: Mapping[str, Any]) -> gym.Env[Any, Any]:
    """Make the environment.

    Args:
        spec: What ``from_dict`` read.
        trust: Whether entry points and import paths of the file are followed.
        arguments: Of ``gymnasium.make``, over those of the spec.

    Raises:
        BundleError: It needs trust, or it cannot be made.
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



def check_rebuildable(spec: EnvSpec) -> EnvSpec:
    """Return the registered spec of the same id; refuse what needs trust to be rebuilt.

    Raises:
        BundleError: The message names it.
    """
    known = _registered(spec.id)
    if known is None:
        raise needs_trust(
            f"the environment {spec.id} is not registered here. Import the package that registers it first. The file "
            "names code for it too"
        )
    if spec.id in OWN_IDS:
        _check_own(spec)
    else:
        for name, value in spec.kwargs.items():
            if name not in known.kwargs or plain(known.kwargs[name]) != value:
                _check_foreign(value, f"the argument {name} of {spec.id}")
    names = [wrapper.name for wrapper in spec.additional_wrappers]
    for wrapper in spec.additional_wrappers:
        check_wrapper(wrapper)
        if names.count(wrapper.name) > 1:
            raise needs_trust(f"the wrapper {wrapper.name} stands twice")
    return known



def check_wrapper(wrapper: WrapperSpec) -> WrapperSpec:
    """Return a wrapper with the entry point of the closed list; refuse one that is not in it.

    Raises:
        BundleError: The message names it.
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
    _check_sizes(kwargs, f"the wrapper {name}")
    return replace(wrapper, entry_point=own or f"gymnasium.wrappers:{name}")



def _with_entry_point(spec: EnvSpec) -> EnvSpec:
    """The spec with the entry point of the file, else that of the registry, after importing the module of its id."""
    module, _, name = spec.id.rpartition(":")
    if module:
        import_module(module)
    known = _registered(name)
    if spec.entry_point is None and known is not None:
        return replace(spec, id=name, entry_point=known.entry_point)
    return replace(spec, id=name)



def _registered(name: str) -> EnvSpec | None:
    """The registered spec; this package registers its own when they are asked for."""
    from gymnasium.envs.registration import registry

    if name not in registry and name in OWN_IDS:
        import_module(_PACKAGE)
    return registry.get(name)



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
    """Refuse what another package's environment may take for code, a file or a large number."""
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



#: Look at a training and change nothing; some take functions, which no JSON tells.
_WATCHERS: Final = ("Monitor", "RecordVideo", "RecordEpisodeStatistics", "PassiveEnvChecker", "HumanRendering")

#: Between the policy and what it reads or what it moves only in training; actions are clipped by the robot's guard.
_TRAINING: Final = ("TimeLimit", "OrderEnforcing", "Curriculum", "ClipAction", "Autoreset")

#: Make what the policy reads of what the camera saw.
_READING: Final = ("ShapeGoal", "PointReward", "FlattenObservation", "FilterObservation")

_SHAPE: Final = "ShapeObservation"

_OF_SIMULATION: Final = {
    "TrueState": "it reads the simulator's state, which no camera tells",
    "Pixels": "its goals come from the simulator's state, and it reads the images of one camera",
    "Shuffled": "its points are shuffled for comparison",
}

#: Of vector environments: what leaves observations alone, but for what Stable-Baselines3 does to images by itself.
_VECTOR: Final = ("VecNormalize", "VecTransposeImage", "VecMonitor", "VecCheckNan", "VecVideoRecorder")

_CELL_KEYS: Final = ("rgb", "depth", "robot")



def training_spec(env: Any) -> EnvSpec:
    """Return the spec of an env, or of the first of a vector env, without what only watches a training.

    Raises:
        BundleError: It cannot be rebuilt from its spec; the message names the wrapper or argument.
    """
    from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

    while isinstance(env, VecEnvWrapper):
        if type(env).__name__ not in _VECTOR:
            raise BundleError(
                f"a bundle cannot hold what {type(env).__name__} does to observations; it knows {', '.join(_VECTOR)}."
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
    try:
        described = json.loads(json.dumps(to_dict(replace(spec, additional_wrappers=kept))))
    except (TypeError, ValueError) as error:
        raise BundleError(f"the environment {spec.id} cannot be written as JSON: {error}") from error
    return from_dict(described, trust=True)



def reading_wrappers(spec: EnvSpec) -> list[WrapperSpec]:
    """What belongs to the policy outside of its ``ShapeObservation``: from the inside out."""
    names = [wrapper.name for wrapper in spec.additional_wrappers]
    at = len(names) - 1 - names[::-1].index(_SHAPE)
    return [wrapper for wrapper in spec.additional_wrappers[at + 1 :] if wrapper.name in _READING]



def obstacle(spec: EnvSpec) -> str:
    """Why a policy that was trained in such an env cannot run before a camera; empty where it can."""
    names = [wrapper.name for wrapper in spec.additional_wrappers]
    for name, reason in _OF_SIMULATION.items():
        if name in names:
            return f"{reason} ({name})"
    if _SHAPE not in names:
        return "it does not read shapes: there is no ShapeObservation in its environment"
    at = len(names) - 1 - names[::-1].index(_SHAPE)
    kept = (spec.additional_wrappers[at].kwargs or {}).get("keep") or ()
    return _missing(kept) or _unknown(names[at + 1 :])



def _missing(kept: Iterable[str]) -> str:
    """What only a simulator gives."""
    missing = [key for key in kept if key not in _CELL_KEYS]
    return f"it reads {', '.join(missing)} beside the shape, which only its simulator gives (keep)" if missing else ""



def _unknown(names: Iterable[str]) -> str:
    unknown = [name for name in names if name not in (*_READING, *_TRAINING)]
    return f"nobody here knows what the wrapper {unknown[0]} does on a robot" if unknown else ""

