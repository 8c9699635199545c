"""Turn a policy of Stable-Baselines3 or sb3-contrib, with the wrappers of its training, into one graph of ONNX.

The graph follows the learner's own ``_predict``. Only wrappers are written here a second time: ``_stage`` computes with
tensors what ``_own`` gets from the wrapper itself, and the actions of both are compared when the policy is saved.
"""

from __future__ import annotations

import copy
import inspect
import logging
import math
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any, Final

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import BaseModel
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecFrameStack, VecNormalize

from shape_obs.policy.contract import ARRAY, TRANSPARENT, PolicyError, describe
from shape_obs.policy.policy import MASK

Values = dict[str, Any]  # tensors with a first axis of 1, by the name of the input
#: Maps observations to observations, and replaces the states in its second argument.
Compute = Callable[[Values, Values], Values]

#: Steps of the replay, in two episodes.
_REPLAYED: Final = 64
#: Names of attributes in which wrappers keep statistics, such as "obs_rms", "running_mean" and "std".
_STATISTIC: Final = re.compile(r"(^|_)(mean|average|avg|var|variance|std|m2|rms|stats)(_|$)")


def export(model: BaseAlgorithm, env: Any) -> tuple[gym.Env[Any, Any], bytes, dict[str, Any]]:
    """Return the environment that a policy reads, its graph, and arguments for ``save_policy_onnx``."""
    source, observing, acting = _wrappers(model, env)
    policy: Any = model.policy
    inputs = describe(source).inputs
    network = _Network(model, [_stage(wrapper) for wrapper in observing], acting, source.unwrapped.action_space.dtype)
    following, masks = {name: f"{name}_next" for name in network.zeros}, {}
    logger, validated = logging.getLogger("torch.onnx"), torch.distributions.Distribution._validate_args
    level = logger.level
    try:
        if "action_masks" in inspect.signature(policy._predict).parameters:
            masks = {MASK: torch.ones((1, policy.action_net.out_features), dtype=torch.bool)}
        logger.setLevel(logging.ERROR)  # it names libraries that are not installed
        # PyTorch cannot export questions about values, such as whether the parameters of a distribution are valid.
        torch.distributions.Distribution.set_default_validate_args(False)
        policy.set_training_mode(False)
        policy.to("cpu")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tensors = {
                name: torch.zeros((1, *one.shape), dtype=getattr(torch, one.dtype)) for name, one in inputs.items()
            }
            program: Any = torch.onnx.export(
                network,
                kwargs={"inputs": tensors, "states": network.zeros, "masks": masks},
                input_names=[*inputs, *network.zeros, *masks],
                output_names=["action", *following.values()],
                dynamo=True,
                external_data=False,
                verbose=False,
            )
    except (torch.onnx.errors.OnnxExporterError, RuntimeError, ValueError, TypeError, AttributeError) as error:
        what = f"the policy {type(policy).__name__} of {type(model).__name__} cannot be exported"
        raise PolicyError(f"{what}; export it yourself, and use save_policy_onnx. {error!s:.500}") from error
    finally:
        if isinstance(policy, torch.nn.Module):
            policy.to(model.device)
        torch.distributions.Distribution.set_default_validate_args(validated)
        logger.setLevel(level)
    played = _play(model, source.observation_space, observing, acting, masks[MASK].shape[1] if masks else 0)
    return source, program.model_proto.SerializeToString(), {**played, "states": following}


def _wrappers(model: BaseAlgorithm, env: Any) -> tuple[gym.Env[Any, Any], list[Any], list[Any]]:
    """Return the environment that the policy reads, and the wrappers of observations and of actions, innermost first.

    It is the outermost one whose observations are no longer changed by wrappers that a graph can express.
    """
    layers: list[Any] = []
    inner: Any = env
    if not isinstance(env, VecEnv) and (normalize := model.get_vec_normalize_env()) is not None:
        layers.append(normalize)
    while isinstance(inner, (VecEnv, gym.Wrapper)):
        if isinstance(inner, (VecEnvWrapper, gym.Wrapper)):
            layers += [] if type(inner).__name__ in TRANSPARENT else [inner]
            inner = inner.venv if isinstance(inner, VecEnvWrapper) else inner.env
        elif envs := getattr(inner, "envs", ()):
            inner = envs[0]
        elif spec := inner.get_attr("spec")[0]:
            inner = gym.make(spec, disable_env_checker=True)
        else:
            raise PolicyError("the environment is in another process and has no spec: use gymnasium.make.")
    source, observing, acting = None, [], []
    for layer in layers:
        name = type(layer).__name__
        if isinstance(layer, _ACTIONS):
            acting.insert(0, layer)
        elif isinstance(layer, _STAGES) and source is None:
            if isinstance(layer, gym.wrappers.NormalizeObservation) and getattr(env, "num_envs", 1) > 1:
                raise PolicyError(f"{name}: each of several environments has its own: normalise with VecNormalize.")
            observing.insert(0, layer)
        elif isinstance(layer, (gym.ActionWrapper, VecEnvWrapper)):
            known = ", ".join(kind.__name__ for kind in (*_STAGES, *_ACTIONS))
            raise PolicyError(f"a policy cannot hold what {name} changes; it can hold {known}.")
        else:
            source = source or layer
            _refuse_statistics(layer)
    return source or inner, observing, acting


def _refuse_statistics(wrapper: Any) -> None:
    for name, value in vars(wrapper).items():
        counted = all(hasattr(value, part) for part in ("mean", "var", "count"))
        numbers = isinstance(value, (float, np.ndarray)) and _STATISTIC.search(name.lower()) is not None
        if (counted or numbers) and not isinstance(wrapper, gym.RewardWrapper):
            keeps = f"the statistics that the wrapper {type(wrapper).__name__} keeps in {name!r}"
            raise PolicyError(
                f"a policy cannot hold {keeps}: normalise with VecNormalize or NormalizeObservation, outermost."
            )


# ---- Wrappers as parts of a graph

_STAGES: Final = (
    gym.wrappers.NormalizeObservation, gym.wrappers.FrameStackObservation, gym.wrappers.FlattenObservation,
    gym.wrappers.FilterObservation, gym.wrappers.ReshapeObservation, VecNormalize, VecFrameStack,
)  # fmt: skip
_ACTIONS: Final = gym.wrappers.RescaleAction, gym.wrappers.ClipAction


def _named(value: Any) -> dict[str, Any]:
    """Return observations or spaces by key."""
    value = value.spaces if isinstance(value, gym.spaces.Dict) else value
    return dict(value) if isinstance(value, Mapping) else {ARRAY: value}


def _stage(wrapper: Any) -> tuple[Compute, Values]:
    """Return what a wrapper of observations computes, as tensors, and zeros of its states."""
    if isinstance(wrapper, (gym.wrappers.NormalizeObservation, VecNormalize)):
        clip = getattr(wrapper, "clip_obs", math.inf)
        moments = {name: tuple(map(torch.from_numpy, pair)) for name, pair in _moments(wrapper).items()}

        def normalize(values: Values, states: Values) -> Values:
            scaled = {name: (values[name].double() - mean) / spread for name, (mean, spread) in moments.items()}
            return {**values, **{name: torch.clamp(value, -clip, clip).float() for name, value in scaled.items()}}

        return normalize, {}
    if isinstance(wrapper, (gym.wrappers.FrameStackObservation, VecFrameStack)):
        return _stack(wrapper)
    if isinstance(wrapper, gym.wrappers.FlattenObservation):
        keys, dtype = list(_named(wrapper.env.observation_space)), getattr(torch, str(wrapper.observation_space.dtype))
        return lambda values, _: {ARRAY: torch.cat([values[key].flatten(1).to(dtype) for key in keys], dim=1)}, {}
    if isinstance(wrapper, gym.wrappers.ReshapeObservation):
        return lambda values, _: {ARRAY: values[ARRAY].reshape(1, *wrapper.observation_space.shape or ())}, {}
    return lambda values, _: {key: values[key] for key in wrapper.observation_space.spaces}, {}  # FilterObservation


def _moments(wrapper: Any) -> dict[str, tuple[Any, Any]]:
    """Return mean and standard deviation of what a wrapper reads, by key, if it normalises."""
    kinds = gym.wrappers.NormalizeObservation, VecNormalize
    if not isinstance(wrapper, kinds) or not getattr(wrapper, "norm_obs", True):
        return {}
    keys, found = getattr(wrapper, "norm_obs_keys", None) or [ARRAY], _named(wrapper.obs_rms)
    return {key: (np.array(found[key].mean), np.sqrt(found[key].var + wrapper.epsilon)) for key in keys}


def _stacks(stacks: Any) -> dict[str, Any]:
    return getattr(stacks, "sub_stacked_observations", None) or {ARRAY: stacks}


def _stack(wrapper: Any) -> tuple[Compute, Values]:
    """Return a stack of frames, along a new axis (Gymnasium) or along the channels (Stable-Baselines3)."""
    name, repeats = type(wrapper).__name__, getattr(wrapper, "padding_type", "zero") == "reset"
    if isinstance(wrapper, VecFrameStack):
        parts = _stacks(wrapper.stacked_obs)
        axes = {key: 1 if part.channels_first else -1 for key, part in parts.items()}
        zeros = {key: np.zeros_like(part.stacked_obs[:1]) for key, part in parts.items()}
    else:
        spaces, axes = _named(wrapper.env.observation_space), {}
        zeros = {key: np.zeros((1, wrapper.stack_size, *one.shape), one.dtype) for key, one in spaces.items()}

    def compute(values: Values, states: Values) -> Values:
        started, stacks = states[f"{name}_started"], {}
        for key, value in values.items():
            frame, axis = (value, axes[key]) if axes else (value[:, None], 1)
            old = states[f"{name}_{key}"]
            frame = frame.to(old.dtype)
            first = frame.expand_as(old) if repeats else torch.zeros_like(old)
            old = torch.where(started > 0, old, first)
            kept = old.narrow(axis, frame.shape[axis], old.shape[axis] - frame.shape[axis])
            stacks[key] = states[f"{name}_{key}"] = torch.cat([kept, frame], dim=axis)
        states[f"{name}_started"] = torch.clamp(started + 1, max=1)
        return stacks

    states = {f"{name}_{key}": torch.from_numpy(value) for key, value in zeros.items()}
    return compute, {**states, f"{name}_started": torch.zeros(1)}


class _Network(torch.nn.Module):
    """Compute the action for the observation of the environment, with all stages of the training."""

    def __init__(self, model: BaseAlgorithm, stages: Any, acting: Sequence[Any], dtype: Any) -> None:
        super().__init__()
        self.policy: Any = model.policy
        self.space = model.observation_space
        self.stages, self.acting, self.dtype = [compute for compute, _ in stages], acting, getattr(torch, str(dtype))
        self.zeros = {name: zeros for _, states in stages for name, zeros in states.items()}
        if hasattr(self.policy, "lstm_actor"):
            self.zeros |= {name: torch.zeros(self.policy.lstm_hidden_state_shape) for name in ("lstm_h", "lstm_c")}

    def forward(self, inputs: Values, states: Values, masks: Values) -> tuple[torch.Tensor, ...]:
        policy, values, memory = self.policy, inputs, dict(states)
        for stage in self.stages:
            values = stage(values, memory)
        for key, space in _named(self.space).items():
            if isinstance(space, gym.spaces.Box) and tuple(values[key].shape[1:]) != space.shape:  # an image (H, W, C)
                values = {**values, key: values[key].permute(0, 3, 1, 2)}
        seen = values if isinstance(self.space, gym.spaces.Dict) else values[ARRAY]
        if "lstm_h" in memory:  # as its ``_predict`` does, but for its question whether an episode starts
            features = BaseModel.extract_features(policy, seen, policy.pi_features_extractor)
            latent, following = policy.lstm_actor(features[None], (memory["lstm_h"], memory["lstm_c"]))
            memory["lstm_h"], memory["lstm_c"] = following
            latent = policy.mlp_extractor.forward_actor(latent[0])
            action = policy._get_action_dist_from_latent(latent).get_actions(deterministic=True)
        else:
            options = {"action_masks": masks[MASK]} if masks else {}
            action = policy._predict(seen, deterministic=True, **options)
        space = policy.action_space
        action = action.reshape(1, *space.shape)
        if isinstance(space, gym.spaces.Box):  # as ``predict`` does
            low, high = torch.from_numpy(space.low), torch.from_numpy(space.high)
            action = low + 0.5 * (action + 1.0) * (high - low) if policy.squash_output else _clip(action, low, high)
        for wrapper in reversed(self.acting):
            inner, outer = wrapper.env.action_space, wrapper.action_space
            low, high = torch.from_numpy(inner.low), torch.from_numpy(inner.high)
            if isinstance(wrapper, gym.wrappers.ClipAction):
                action = _clip(action, low, high)
            else:
                gain = torch.from_numpy((inner.high - inner.low) / (outer.high - outer.low))
                action = low + (action - torch.from_numpy(outer.low)) * gain
        return action.to(self.dtype), *(memory[name] for name in states)


def _clip(action: torch.Tensor, low: torch.Tensor, high: torch.Tensor) -> torch.Tensor:
    return torch.minimum(torch.maximum(action, low), high)


# ---- The learner's own actions


def _own(wrapper: Any) -> Callable[[Any, bool], Any]:
    """Return what a wrapper itself makes of an observation, and of whether an episode starts; it stays as it is.

    Wrappers of vector environments take a batch of one observation.
    """
    if isinstance(wrapper, VecNormalize):
        return lambda seen, _: wrapper.normalize_obs(seen)
    if isinstance(wrapper, VecFrameStack):
        stacks: Any = copy.deepcopy(wrapper.stacked_obs)
        for part in _stacks(stacks).values():
            part.stacked_obs = part.stacked_obs[:1]
        return lambda seen, start: stacks.reset(seen) if start else stacks.update(seen, np.array([False]), [{}])[0]
    again: Any = copy.copy(wrapper)
    if isinstance(wrapper, gym.wrappers.NormalizeObservation):
        again.update_running_mean = False
    if not isinstance(wrapper, gym.wrappers.FrameStackObservation):
        return lambda seen, _: again.observation(seen)
    again.obs_queue, again.stacked_obs = copy.deepcopy((wrapper.obs_queue, wrapper.stacked_obs))

    def queue(seen: Any, start: bool) -> Any:
        result = (seen, 0.0, False, False, {})
        space = wrapper.env.observation_space
        again.env = SimpleNamespace(observation_space=space, reset=lambda **_: (seen, {}), step=lambda _: result)
        return (again.reset() if start else again.step(None))[0]

    return queue


def _play(model: BaseAlgorithm, space: Any, observing: list[Any], acting: list[Any], masked: int) -> dict[str, Any]:
    """Return observations, and the actions that the learner itself computes for them behind its own wrappers."""
    random, moments = np.random.default_rng(0), _moments(observing[0] if observing else None)
    spaces = copy.deepcopy(_named(space))
    for one in spaces.values():
        one.seed(0)
    single = sum(isinstance(wrapper, gym.Wrapper) for wrapper in observing)
    own = [_own(wrapper) for wrapper in observing]
    observations, actions, masks, state = [], [], [], None
    starts = np.arange(_REPLAYED) % (_REPLAYED // 2) == 0
    for start in starts:
        values = {key: _drawn(one, random, moments.get(key)) for key, one in spaces.items()}
        observations.append(seen := values if isinstance(space, gym.spaces.Dict) else values[ARRAY])
        for wrap in own[:single]:
            seen = wrap(seen, bool(start))
        batch = {key: np.asarray(value)[None] for key, value in _named(seen).items()}
        seen = batch if isinstance(seen, Mapping) else batch[ARRAY]
        for wrap in own[single:]:
            seen = wrap(seen, bool(start))
        options: dict[str, Any] = {}
        if masked:
            masks.append(np.append(random.random(masked - 1) < 0.7, True))  # at least one action is allowed
            options["action_masks"] = masks[-1]
        action, state = model.predict(seen, state=state, episode_start=np.array([start]), deterministic=True, **options)
        action = action[0]
        for wrapper in reversed(acting):
            action = wrapper.action(action)
        actions.append(action)
    return {"observations": observations, "actions": actions, "starts": starts, "masks": masks or None}


def _drawn(space: Any, random: np.random.Generator, moments: Any) -> Any:
    """Draw a sample of a space: around the mean of the training if it is known; never a number beyond all use."""
    sample, normal = np.asarray(space.sample()), random.standard_normal(space.shape)
    if sample.dtype.kind != "f":
        return sample
    if moments is not None and np.shape(moments[0]) == space.shape:
        sample = moments[0] + moments[1] * np.clip(normal, -1, 1)
    return np.clip(np.where(abs(sample) < 1e6, sample, normal), space.low, space.high).astype(space.dtype)
