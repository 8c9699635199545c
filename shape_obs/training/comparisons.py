"""Pixels: the raw image in place of a shape, for comparison.

Shuffled: points without their order, as a control.

TrueState: what the simulator knows in place of what a camera sees, for comparison.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs

from shape_obs.wrappers.env_protocol import GOALS, has_goals


class Pixels(gym.ObservationWrapper[Any, Any, Any], RecordConstructorArgs):
    """The camera's image as ``observation``, beside the goals of a goal-conditioned simulated env.

    ``achieved_goal`` is the simulator's, since an image tells no points: it is there for the reward and for hindsight
    replay, and a policy that is to be compared must not read it (``ImageAndGoal`` does not). ``desired_goal`` are the
    points of the goal, which such a policy is told.

    Args:
        env: Goal-conditioned, with an RGB image.
        key: Of the image, (H, W, 3) uint8.

    Raises:
        ValueError: The env has no goals, or no such image.
    """

    def __init__(self, env: gym.Env[Any, Any], key: str = "rgb") -> None:
        RecordConstructorArgs.__init__(self, key=key)
        gym.ObservationWrapper.__init__(self, env)
        space = env.observation_space
        if not isinstance(space, spaces.Dict) or not has_goals(space):
            raise ValueError(f"Pixels needs an environment with goals, got the observation space {space}.")
        if key not in space.spaces or space[key].dtype != np.uint8 or len(space[key].shape or ()) != 3:
            raise ValueError(f"key: expected an image (H, W, 3) uint8 of {list(space)}, got {key!r}.")
        self.observation_space = spaces.Dict({"observation": space[key], **{name: space[name] for name in GOALS}})
        self._key = key

    def observation(self, observation: Any) -> dict[str, Any]:
        """Image and goals."""
        return {"observation": observation[self._key], **{name: observation[name] for name in GOALS}}

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """The env's own."""
        return self.env.get_wrapper_attr("compute_reward")(achieved_goal, desired_goal, info)


Vector = npt.NDArray[np.float32]


class Shuffled(gym.ObservationWrapper[Any, Any, Any], RecordConstructorArgs):
    """Shows the points of a goal-conditioned env in another order in every frame, as an unordered clustering would.

    ``observation`` and the first ``visible`` numbers of the two goals, all that a policy may read of them, are the
    points, seen and desired, shuffled apart; the points in their order follow them for the reward.

    Args:
        env: Goal-conditioned, goals of flat points (x, y, z).

    Attributes:
        visible: How many numbers of a goal a policy may read.

    Raises:
        ValueError: The env has no such goals.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        RecordConstructorArgs.__init__(self)
        gym.ObservationWrapper.__init__(self, env)
        space = env.observation_space
        if not isinstance(space, spaces.Dict) or not all(key in space.spaces for key in GOALS):
            raise ValueError(f"Shuffled needs an environment with goals, got the observation space {space}.")
        points = space["desired_goal"]
        if not isinstance(points, spaces.Box) or len(points.shape) != 1 or points.shape[0] % 3:
            raise ValueError(f"Shuffled needs goals of flat points (x, y, z), got {points}.")
        # One box for all points: each of them may stand anywhere.
        low, high = points.low.reshape(-1, 3), points.high.reshape(-1, 3)
        anywhere = np.tile(low.min(axis=0), len(low)), np.tile(high.max(axis=0), len(high))
        self.visible = points.shape[0]
        goal = spaces.Box(
            np.concatenate([anywhere[0], points.low]), np.concatenate([anywhere[1], points.high]), dtype=np.float32
        )
        seen = spaces.Box(*anywhere, dtype=np.float32)
        self.observation_space = spaces.Dict({"observation": seen, **dict.fromkeys(GOALS, goal)})
        self._rng = np.random.default_rng()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the env; a seed starts the shuffling anew."""
        if seed is not None:
            self._rng = np.random.default_rng(seed)
        return super().reset(seed=seed, options=options)

    def observation(self, observation: Any) -> dict[str, Any]:
        """Points in another order, then in theirs."""
        achieved, desired = (np.asarray(observation[key], np.float32) for key in GOALS)
        seen, wanted = self._shuffle(achieved), self._shuffle(desired)
        return {
            "observation": seen,
            "achieved_goal": np.concatenate([seen, achieved]),
            "desired_goal": np.concatenate([wanted, desired]),
        }

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """The env's own, of the points in their order."""
        achieved, desired = (np.asarray(goal)[..., self.visible :] for goal in (achieved_goal, desired_goal))
        return self.env.get_wrapper_attr("compute_reward")(achieved, desired, info)

    def _shuffle(self, points: Vector) -> Vector:
        return self._rng.permutation(points.reshape(-1, 3)).ravel()


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
