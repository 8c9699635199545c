"""Express the wrappers of a training as parts of a graph: each as tensors for the file, and as the wrapper itself.

The graph of a policy is checked against the training's own code, so each wrapper stands here twice: ``graph`` computes
with tensors, ``own`` calls the wrapper. Both take and return observations by key; ``""`` is the key of an observation
that is one array.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.vec_env import VecFrameStack, VecNormalize, VecTransposeImage

from shape_obs.policy.contract import PolicyError

Values = dict[str, Any]  # tensors or arrays
#: Maps observations and states to observations and the next states.
Graph = Callable[[Values, Values], tuple[Values, Values]]
#: Maps an observation, and whether it is the first of an episode, to an observation.
Own = Callable[[Any, bool], Any]

_FILLED: Final = "frames_filled"


@dataclass(frozen=True)
class Stage:
    """Describe one wrapper of observations.

    Args:
        name: Name of the wrapper.
        graph: What it computes, as tensors with a first axis of 1.
        own: The wrapper itself, for arrays without that axis.
        states: Zeros of its states, by name.
        moments: Mean and standard deviation of what it reads, by key, if it knows them.
    """

    name: str
    graph: Graph
    own: Own
    states: Values = field(default_factory=dict)
    moments: Mapping[str, tuple[Any, Any]] = field(default_factory=dict)


def by_key(observation: Any) -> Values:
    """Return an observation by key."""
    return dict(observation) if isinstance(observation, Mapping) else {"": observation}


def spaces_by_key(space: Any) -> dict[str, Any]:
    """Return the spaces of an observation by key."""
    return dict(space.spaces) if isinstance(space, gym.spaces.Dict) else {"": space}


def stage_of(wrapper: Any) -> Stage | None:
    """Return a wrapper of observations as a stage; None if it is none of those that a graph can express."""
    for kind, make in _MAKERS.items():
        if isinstance(wrapper, kind):
            return make(wrapper)
    return None


def _observation(wrapper: Any) -> Own:
    return lambda observation, _: wrapper.observation(observation)


def _normalized(wrapper: gym.wrappers.NormalizeObservation) -> Stage:
    frozen: Any = copy.copy(wrapper)
    frozen.update_running_mean = False
    mean, spread = np.asarray(wrapper.obs_rms.mean), np.sqrt(wrapper.obs_rms.var + wrapper.epsilon)
    tensors = torch.from_numpy(mean), torch.from_numpy(np.asarray(spread))

    def graph(values: Values, states: Values) -> tuple[Values, Values]:
        return {"": ((values[""] - tensors[0]) / tensors[1]).float()}, {}

    return Stage("NormalizeObservation", graph, _observation(frozen), moments={"": (mean, spread)})


def _vec_normalized(wrapper: VecNormalize) -> Stage:
    rms: Any = wrapper.obs_rms if isinstance(wrapper.obs_rms, dict) else {"": wrapper.obs_rms}
    keys = [] if not wrapper.norm_obs else wrapper.norm_obs_keys or [""]
    moments = {key: (np.array(rms[key].mean), np.sqrt(rms[key].var + wrapper.epsilon)) for key in keys}
    tensors = {key: tuple(map(torch.from_numpy, pair)) for key, pair in moments.items()}
    clip = wrapper.clip_obs

    def graph(values: Values, states: Values) -> tuple[Values, Values]:
        scaled = {
            key: torch.clamp((values[key].double() - mean) / spread, -clip, clip).float()
            for key, (mean, spread) in tensors.items()
        }
        return {**values, **scaled}, {}

    return Stage("VecNormalize", graph, lambda observation, _: wrapper.normalize_obs(observation), moments=moments)


def _stacked(wrapper: gym.wrappers.FrameStackObservation) -> Stage:
    inner = spaces_by_key(wrapper.env.observation_space)
    fixed = None if wrapper.padding_type == "reset" else by_key(wrapper.padding_value)
    padding = {key: torch.from_numpy(np.asarray(value)) for key, value in (fixed or {}).items()}
    states = {
        f"frames_{key}": torch.from_numpy(np.zeros((1, wrapper.stack_size, *space.shape), space.dtype))
        for key, space in inner.items()
    }
    again: Any = copy.copy(wrapper)
    again.obs_queue, again.stacked_obs = copy.deepcopy((wrapper.obs_queue, wrapper.stacked_obs))

    def graph(values: Values, states: Values) -> tuple[Values, Values]:
        started, stacks = states[_FILLED], {}
        for key, value in values.items():
            old = states[f"frames_{key}"]
            fill = padding[key] if padding else value
            first = fill.reshape(1, 1, *old.shape[2:]).expand(old.shape)
            old = torch.where(started.reshape((1,) * old.dim()) > 0, old, first)
            stacks[key] = torch.cat([old[:, 1:], value[:, None]], dim=1)
        following = {f"frames_{key}": stack for key, stack in stacks.items()}
        return stacks, {**following, _FILLED: torch.clamp(started + 1, max=1)}

    def own(observation: Any, start: bool) -> Any:
        again.env = _Player(wrapper.env, observation)
        return again.reset()[0] if start else again.step(None)[0]

    return Stage("FrameStackObservation", graph, own, {**states, _FILLED: torch.zeros(1)})


class _Player(gym.Env[Any, Any]):
    """Return a given observation."""

    def __init__(self, env: Any, observation: Any) -> None:
        self.observation_space, self.action_space, self._observation = (
            env.observation_space,
            env.action_space,
            observation,
        )

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        return self._observation, {}

    def step(self, action: Any) -> Any:
        return self._observation, 0.0, False, False, {}


def _vec_stacked(wrapper: VecFrameStack) -> Stage:
    stacks: Any = wrapper.stacked_obs
    parts = getattr(stacks, "sub_stacked_observations", None) or {"": stacks}
    again = copy.deepcopy(stacks)
    for part in (getattr(again, "sub_stacked_observations", None) or {"": again}).values():
        part.stacked_obs = part.stacked_obs[:1]
    states = {f"stack_{key}": torch.from_numpy(np.zeros_like(part.stacked_obs[:1])) for key, part in parts.items()}

    def graph(values: Values, states: Values) -> tuple[Values, Values]:
        following = {}
        for key, value in values.items():
            axis = 1 if parts[key].channels_first else value.dim() - 1
            old = states[f"stack_{key}"].narrow(
                axis, value.shape[axis], states[f"stack_{key}"].shape[axis] - value.shape[axis]
            )
            following[key] = torch.cat([old, value], dim=axis)
        return following, {f"stack_{key}": stack for key, stack in following.items()}

    def own(observation: Any, start: bool) -> Any:
        batch = _batch(observation)
        return _first(again.reset(batch) if start else again.update(batch, np.array([False]), [{}])[0])

    return Stage("VecFrameStack", graph, own, states)


def _transposed(wrapper: VecTransposeImage) -> Stage:
    turned = [] if wrapper.skip else getattr(wrapper, "image_space_keys", [""])

    def graph(values: Values, states: Values) -> tuple[Values, Values]:
        return {**values, **{key: values[key].permute(0, 3, 1, 2) for key in turned}}, {}

    return Stage(
        "VecTransposeImage", graph, lambda observation, _: _first(wrapper.transpose_observations(_batch(observation)))
    )


def _flattened(wrapper: gym.wrappers.FlattenObservation) -> Stage:
    inner, dtype = spaces_by_key(wrapper.env.observation_space), np.dtype(wrapper.observation_space.dtype)
    if not all(isinstance(space, gym.spaces.Box) for space in inner.values()):
        raise PolicyError("FlattenObservation: expected arrays (Box) under it.")
    wide = torch.from_numpy(np.zeros(0, dtype)).dtype

    def graph(values: Values, states: Values) -> tuple[Values, Values]:
        return {"": torch.cat([values[key].flatten(1).to(wide) for key in inner], dim=1)}, {}

    return Stage("FlattenObservation", graph, _observation(wrapper))


def _filtered(wrapper: gym.wrappers.FilterObservation) -> Stage:
    keys = list(wrapper.observation_space.spaces)  # type: ignore[attr-defined]
    return Stage("FilterObservation", lambda values, _: ({key: values[key] for key in keys}, {}), _observation(wrapper))


def _reshaped(wrapper: gym.wrappers.ReshapeObservation) -> Stage:
    shape = wrapper.observation_space.shape or ()
    return Stage(
        "ReshapeObservation", lambda values, _: ({"": values[""].reshape(1, *shape)}, {}), _observation(wrapper)
    )


def _batch(observation: Any) -> Any:
    values = {key: np.asarray(value)[None] for key, value in by_key(observation).items()}
    return values.get("", values)


def _first(observation: Any) -> Any:
    values = {key: np.array(value[0]) for key, value in by_key(observation).items()}
    return values.get("", values)


_MAKERS: Final[Mapping[type, Callable[[Any], Stage]]] = {
    gym.wrappers.NormalizeObservation: _normalized,
    gym.wrappers.FrameStackObservation: _stacked,
    gym.wrappers.FlattenObservation: _flattened,
    gym.wrappers.FilterObservation: _filtered,
    gym.wrappers.ReshapeObservation: _reshaped,
    VecNormalize: _vec_normalized,
    VecFrameStack: _vec_stacked,
    VecTransposeImage: _transposed,
}


def action_stage(wrapper: Any) -> Callable[[torch.Tensor], torch.Tensor] | None:
    """Return what a wrapper of actions computes, as tensors; None if it is none of those that a graph can express."""
    if not isinstance(wrapper, (gym.wrappers.RescaleAction, gym.wrappers.ClipAction)):
        return None
    inner, outer = wrapper.env.action_space, wrapper.action_space
    assert isinstance(inner, gym.spaces.Box)
    assert isinstance(outer, gym.spaces.Box)
    low, high = torch.from_numpy(inner.low), torch.from_numpy(inner.high)
    if isinstance(wrapper, gym.wrappers.ClipAction):
        return lambda action: torch.minimum(torch.maximum(action, low), high)
    gain = torch.from_numpy((inner.high - inner.low) / (outer.high - outer.low))
    start = torch.from_numpy(outer.low)
    return lambda action: low + (action - start) * gain
