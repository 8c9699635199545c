"""Export the networks of Stable-Baselines3 and sb3-contrib: the deterministic action as one ONNX graph."""

from __future__ import annotations

import contextlib
import io
import logging
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.policies import BaseModel

from shape_obs.policy.contract import PolicyError, observation_inputs
from shape_obs.policy.stages import Stage, Values, spaces_by_key

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

MASK = "action_mask"
_MASKED = -1e8  # logit of a forbidden action, as in sb3-contrib


@dataclass(frozen=True)
class Head:
    """Describe the network of a learner.

    Args:
        compute: Maps observations, states and mask to the action and the next states.
        states: Zeros of its states, by name.
        mask: Number of actions that may be masked; None without masks.
    """

    compute: Callable[[Any, Values, Any], tuple[torch.Tensor, Values]]
    states: Values = field(default_factory=dict)
    mask: int | None = None


def head_of(model: BaseAlgorithm) -> Head:
    """Return the deterministic action of a learner as tensors.

    Raises:
        PolicyError: The structure of the policy is unknown; the message names its class.
    """
    policy: Any = model.policy
    space = policy.action_space
    if hasattr(policy, "quantile_net") and hasattr(policy.quantile_net, "n_quantiles"):  # QR-DQN
        return Head(lambda seen, states, mask: (policy.quantile_net(seen).mean(1).argmax(1), {}))
    if hasattr(policy, "q_net"):  # DQN
        return Head(lambda seen, states, mask: (policy.q_net(seen).argmax(1), {}))
    if hasattr(policy, "lstm_actor"):  # RecurrentPPO
        return Head(
            _recurrent(policy), {name: torch.zeros(policy.lstm_hidden_state_shape) for name in ("lstm_h", "lstm_c")}
        )
    if hasattr(policy, "action_net") and hasattr(policy, "mlp_extractor"):  # PPO, A2C, TRPO, MaskablePPO
        masked = type(policy).__module__.startswith("sb3_contrib.common.maskable") or hasattr(
            policy.action_dist, "apply_masking"
        )
        mask = _mask_size(space) if masked else None

        def act(seen: Any, states: Values, mask: Any) -> tuple[torch.Tensor, Values]:
            latent = policy.mlp_extractor.forward_actor(_features(policy, seen, policy.pi_features_extractor))
            return _mode(policy, policy.action_net(latent), mask), {}

        return Head(act, mask=mask)
    if hasattr(policy, "action_net"):  # ARS
        return Head(lambda seen, states, mask: (_bounded(policy, policy(seen)), {}))
    if hasattr(policy, "actor") and hasattr(policy.actor, "latent_pi"):  # SAC, TQC, CrossQ

        def squashed(seen: Any, states: Values, mask: Any) -> tuple[torch.Tensor, Values]:
            features = _features(policy.actor, seen, policy.actor.features_extractor)
            return _bounded(policy, torch.tanh(policy.actor.mu(policy.actor.latent_pi(features)))), {}

        return Head(squashed)
    if hasattr(policy, "actor") and hasattr(policy.actor, "mu"):  # TD3, DDPG
        return Head(lambda seen, states, mask: (_bounded(policy, policy.actor(seen)), {}))
    raise PolicyError(
        f"the policy {type(policy).__name__} of {type(model).__name__} is none of those that can be exported; export "
        "its network yourself, and use save_policy_onnx."
    )


def _features(module: Any, seen: Any, extractor: Any) -> torch.Tensor:
    return BaseModel.extract_features(module, seen, extractor)


def _recurrent(policy: Any) -> Any:
    def act(seen: Any, states: Values, mask: Any) -> tuple[torch.Tensor, Values]:
        features = _features(policy, seen, policy.pi_features_extractor)
        latent, (hidden, cell) = policy.lstm_actor(features[None], (states["lstm_h"], states["lstm_c"]))
        action = _mode(policy, policy.action_net(policy.mlp_extractor.forward_actor(latent[0])), None)
        return action, {"lstm_h": hidden, "lstm_c": cell}

    return act


def _mask_size(space: Any) -> int:
    if isinstance(space, gym.spaces.Discrete):
        return int(space.n)
    return int(sum(space.nvec)) if isinstance(space, gym.spaces.MultiDiscrete) else 2 * int(np.prod(space.shape))


def _mode(policy: Any, outcome: torch.Tensor, mask: Any) -> torch.Tensor:
    """Return the most likely action of a distribution with these parameters."""
    space = policy.action_space
    if isinstance(space, gym.spaces.Box):
        return _bounded(policy, torch.tanh(outcome) if policy.squash_output else outcome)
    if isinstance(space, gym.spaces.MultiBinary) and mask is None:
        return torch.round(torch.sigmoid(outcome))
    logits = outcome if mask is None else torch.where(mask, outcome, _MASKED)
    if isinstance(space, gym.spaces.Discrete):
        return logits.argmax(1)
    sizes = space.nvec.tolist() if isinstance(space, gym.spaces.MultiDiscrete) else [2] * int(np.prod(space.shape))
    return torch.stack([part.argmax(1) for part in torch.split(logits, sizes, dim=1)], dim=1)


def _bounded(policy: Any, action: torch.Tensor) -> torch.Tensor:
    """Scale or clip an action to its space, as ``predict`` does."""
    space = policy.action_space
    if not isinstance(space, gym.spaces.Box):
        return action
    low, high = torch.from_numpy(space.low), torch.from_numpy(space.high)
    action = action.reshape(1, *space.shape)
    if policy.squash_output:
        return low + 0.5 * (action + 1.0) * (high - low)
    return torch.minimum(torch.maximum(action, low), high)


class _Network(torch.nn.Module):
    """Compute the action for the observation of the environment, with all stages of the training."""

    def __init__(
        self, model: BaseAlgorithm, stages: Sequence[Stage], head: Head, actions: Sequence[Any], dtype: Any
    ) -> None:
        super().__init__()
        self.policy, self.stages, self.head, self.actions, self.dtype = model.policy, stages, head, actions, dtype
        self.spaces = spaces_by_key(model.observation_space)

    def forward(self, inputs: Values, states: Values, masks: Values) -> tuple[torch.Tensor, ...]:
        values, following = inputs, {}
        for stage in self.stages:
            values, new = stage.graph(values, {name: states[name] for name in stage.states})
            following |= new
        for key, space in self.spaces.items():
            if isinstance(space, gym.spaces.Box) and tuple(values[key].shape[1:]) != space.shape:  # an image (H, W, C)
                values = {**values, key: values[key].permute(0, 3, 1, 2)}
        seen = values.get("", values)
        action, new = self.head.compute(seen, {name: states[name] for name in self.head.states}, masks.get(MASK))
        following |= new
        for change in reversed(self.actions):
            action = change(action)
        return action.to(self.dtype), *(following[name] for name in states)


def export(
    model: BaseAlgorithm, source: gym.Env[Any, Any], stages: Sequence[Stage], head: Head, actions: Sequence[Any]
) -> tuple[bytes, dict[str, Any]]:
    """Return the network as a file of ONNX, and its states as the contract describes them.

    Args:
        model: Trained model.
        source: Environment whose observations the network reads.
        stages: Wrappers of observations, the innermost first.
        head: The learner.
        actions: Wrappers of actions, the innermost first, as ``action_stage`` returns them.

    Raises:
        PolicyError: PyTorch cannot export it.
    """
    described = observation_inputs(source.observation_space)
    tensors = {
        value["key"]: torch.zeros((1, *value["shape"]), dtype=getattr(torch, value["dtype"]))
        for value in described.values()
    }
    states = {name: zeros for stage in stages for name, zeros in stage.states.items()} | head.states
    masks = {MASK: torch.ones((1, head.mask), dtype=torch.bool)} if head.mask else {}
    dtype = getattr(torch, str(source.unwrapped.action_space.dtype))
    model.policy.set_training_mode(False)
    network = _Network(model, stages, head, actions, dtype).eval()
    before = next(iter(model.policy.parameters())).device
    outputs = {name: f"{name}_next" for name in states}
    try:
        network.to("cpu")
        with torch.no_grad(), warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()), _quiet():
            warnings.simplefilter("ignore")
            program = torch.onnx.export(
                network,
                kwargs={"inputs": tensors, "states": states, "masks": masks},
                input_names=[*described, *states, *masks],
                output_names=["action", *outputs.values()],
                dynamo=True,
                external_data=False,
                optimize=True,
                verbose=False,
            )
    except (torch.onnx.errors.OnnxExporterError, RuntimeError, ValueError, TypeError) as error:
        raise PolicyError(f"PyTorch cannot export {type(model.policy).__name__}: {error!s:.500}") from error
    finally:
        network.to(before)
    data = program.model_proto.SerializeToString()  # type: ignore[union-attr]
    dtypes = {name: str(zeros.dtype).removeprefix("torch.") for name, zeros in states.items()}
    return data, {
        name: {"shape": list(zeros.shape), "dtype": dtypes[name], "key": "", "output": outputs[name]}
        for name, zeros in states.items()
    }


@contextlib.contextmanager
def _quiet() -> Any:
    """Leave out the exporter's log of operators of libraries that are not installed."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(level)
