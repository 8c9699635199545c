"""Run a policy on recorded frames: the actions that it would have taken."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from shape_obs.camera import CameraModel
from shape_obs.policy.contract import Contract
from shape_obs.policy.policy import Policy
from shape_obs.recording.format import Moment, read_moments
from shape_obs.robot import ActionSpec
from shape_obs.shape import Detection
from shape_obs.source import RGBDSource


class RecordedFrames(gym.Env[Any, Any]):
    """Return the frames of a source one after the other; actions have no effect.

    Args:
        source: The source; it is connected if necessary.
        spec: Description of the policy that acts.
        frames: Largest number of frames.

    Attributes:
        moment: The frame of the last observation; before the first one, that of the first.
        coming: The frame of the next observation; None at the end.
        dt: Duration of a step in seconds, that of the training; stamps count before it.
        action_spec: Meaning of the recorded actions, or else of the policy's.

    Raises:
        ValueError: The source has no frames.
    """

    moment: Moment
    coming: Moment | None
    dt: float
    action_spec: ActionSpec | None

    def __init__(self, source: RGBDSource, spec: Contract, frames: int | None = None) -> None:
        self._moments = read_moments(source, frames)
        self.coming = next(self._moments, None)
        if self.coming is None:
            raise ValueError(f"{source.name} has no frames.")
        self.moment, self.dt = self.coming, spec.dt
        recorded = getattr(source, "robot_info", None)
        self.action_spec = (recorded and recorded.action_spec) or spec.action_spec
        self.action_space = gym.spaces.Box(-1.0, 1.0, spec.action.shape)
        seen = self._seen().items()
        self.observation_space = gym.spaces.Dict(
            [(name, gym.spaces.Box(*_range(value), value.shape, value.dtype)) for name, value in seen]
        )

    @property
    def camera_model(self) -> CameraModel | None:
        """Camera of the frame."""
        return self.moment.frame.camera

    @property
    def anchors(self) -> Mapping[str, Sequence[float]]:
        """Points at which the object was held."""
        return self.moment.anchors

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Return the next frame."""
        super().reset(seed=seed)
        assert self.coming is not None
        self.moment, self.coming = self.coming, next(self._moments, None)
        stamp = self.moment.frame.stamp
        return self._seen(), {} if stamp is None else {"stamp": stamp}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Return the next frame."""
        seen, info = self.reset()
        return seen, 0.0, False, False, info

    def _seen(self) -> dict[str, Any]:
        frame, state = self.moment.frame, self.moment.state
        seen = {"rgb": frame.rgb, "depth": frame.depth}
        if state is not None and self.action_spec is not None:
            seen["robot"] = np.array(state[: len(self.action_spec)], np.float32)
        return {name: value for name, value in seen.items() if value is not None}


def _range(values: Any) -> tuple[float, float]:
    return (-np.inf, np.inf) if values.dtype.kind == "f" else (0, np.iinfo(values.dtype).max)


def play(policy: Policy, env: gym.Env[Any, Any]) -> Iterator[tuple[Moment, Detection, Any]]:
    """Yield each frame with the detection in it and the action of a policy for it.

    The policy and the detector are reset at each new episode.

    Args:
        policy: The policy.
        env: ``RecordedFrames``, wrapped by ``policy.wrap``.

    Raises:
        SourceError: The source fails; ``BadRecording`` for a damaged file.
    """
    frames: Any = env.unwrapped
    episode, action = None, None
    while frames.coming is not None:
        if frames.coming.episode != episode:
            episode = frames.coming.episode
            policy.reset()
            observation, _ = env.reset()
        else:
            observation, *_ = env.step(action)
        action = policy.act(observation)
        yield frames.moment, env.get_wrapper_attr("detection"), action
