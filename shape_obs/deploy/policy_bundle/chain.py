"""The wrappers of a training env: which of them can be rebuilt, and which belong to the policy on a robot."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from shape_obs.deploy.policy_bundle.environment import from_dict, to_dict
from shape_obs.deploy.policy_bundle.errors import BundleError

if TYPE_CHECKING:
    from gymnasium.envs.registration import EnvSpec, WrapperSpec

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
