"""TrueState: what the simulator knows in place of what a camera sees, for comparison."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs

from shape_obs.wrappers.env_protocol import GOALS, has_goals


class TrueState(gym.ObservationWrapper[Any, Any, Any], RecordConstructorArgs):
    """The privileged state of a goal-conditioned simulated env, in the layout that ``ShapeObservation`` gives.

    A Dict of ``observation`` (the env's own ``achieved_goal``, then the vectors it keeps), ``achieved_goal`` and
    ``desired_goal``, flat points in metres, base frame. Make the env with ``render_observation=False``: nobody looks at
    its images.

    Args:
        env: Goal-conditioned; its goals are the simulator's.
        keep: Keys of vectors of the env's observation to append, such as ``["gripper"]``.

    Raises:
        ValueError: The env has no goals, or no such vector.
    """

    def __init__(self, env: gym.Env[Any, Any], keep: Sequence[str] = ()) -> None:
        RecordConstructorArgs.__init__(self, keep=list(keep))
        gym.ObservationWrapper.__init__(self, env)
        space = env.observation_space
        if not isinstance(space, spaces.Dict) or not has_goals(space):
            raise ValueError(f"TrueState needs an environment with goals, got the observation space {space}.")
        boxes = [space["achieved_goal"]]
        for key in keep:
            if key not in space.spaces or len(space[key].shape or ()) != 1:
                raise ValueError(f"keep: expected vectors of {list(space)}, got {key!r}.")
            boxes.append(space[key])
        assert all(isinstance(box, spaces.Box) for box in boxes)
        low = np.concatenate([box.low for box in boxes])  # type: ignore[attr-defined]
        high = np.concatenate([box.high for box in boxes])  # type: ignore[attr-defined]
        goals = {key: space[key] for key in GOALS}
        self.observation_space = spaces.Dict({"observation": spaces.Box(low, high, dtype=np.float32), **goals})
        self._keep = list(keep)

    def observation(self, observation: Any) -> dict[str, Any]:
        """The privileged state and the goals, fresh arrays."""
        parts = [observation["achieved_goal"], *(observation[key] for key in self._keep)]
        state = np.concatenate(parts, dtype=np.float32)
        # What is filtered or measured a little out of its bounds is no reason to leave the space.
        box = self.observation_space["observation"]  # type: ignore[index]
        return {
            "observation": np.clip(state, box.low, box.high),
            **{key: observation[key].astype(np.float32) for key in GOALS},
        }

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """The env's own."""
        return self.env.get_wrapper_attr("compute_reward")(achieved_goal, desired_goal, info)
