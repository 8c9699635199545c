"""Replace the shape in an observation, for comparison: by the image, by the true state, or by unordered points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs

from shape_obs.wrappers.env_protocol import GOALS, has_goals

Vector = npt.NDArray[np.float32]


class Pixels(gym.ObservationWrapper[Any, Any, Any], RecordConstructorArgs):
    """Observe the camera's image and the goals of a goal-conditioned simulated environment.

    ``achieved_goal`` comes from the simulator, since an image has no points. It is needed for the reward and for
    hindsight replay, and a policy for a fair comparison must not read it (``ImageAndGoal`` does not). ``desired_goal``
    holds the points of the goal, which such a policy reads.

    Args:
        env: A goal-conditioned environment with an RGB image.
        key: Key of the image, of shape ``(H, W, 3)`` uint8.

    Raises:
        ValueError: The environment has no goals, or no such image.
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
        """Return image and goals."""
        return {"observation": observation[self._key], **{name: observation[name] for name in GOALS}}

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """Return the environment's own reward."""
        return self.env.get_wrapper_attr("compute_reward")(achieved_goal, desired_goal, info)


class TrueState(gym.ObservationWrapper[Any, Any, Any], RecordConstructorArgs):
    """Observe the true state of a goal-conditioned simulated environment, in the layout of ``ShapeObservation``.

    A Dict of ``observation`` (the environment's ``achieved_goal``, then the vectors in ``keep``), ``achieved_goal`` and
    ``desired_goal``: flat points in metres in the base frame. Make the environment with ``render_observation=False``,
    since its images are not used.

    Args:
        env: A goal-conditioned environment with the simulator's goals.
        keep: Keys of vectors in the environment's observation to append, such as ``["gripper"]``.

    Raises:
        ValueError: The environment has no goals, or no such vector.
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
        """Return the true state and the goals, as new arrays."""
        parts = [observation["achieved_goal"], *(observation[key] for key in self._keep)]
        state = np.concatenate(parts, dtype=np.float32)
        # Clipped, since values may exceed their bounds slightly.
        box = self.observation_space["observation"]  # type: ignore[index]
        return {
            "observation": np.clip(state, box.low, box.high),
            **{key: observation[key].astype(np.float32) for key in GOALS},
        }

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """Return the environment's own reward."""
        return self.env.get_wrapper_attr("compute_reward")(achieved_goal, desired_goal, info)


class Shuffled(gym.ObservationWrapper[Any, Any, Any], RecordConstructorArgs):
    """Shuffle the points of a goal-conditioned environment in every frame, like a clustering without order.

    ``observation`` and the first ``visible`` numbers of the goals, which are all that a policy may read, hold the
    detected and the desired points, shuffled separately. The points in their original order follow, for the reward.

    Args:
        env: A goal-conditioned environment whose goals are flat points (x, y, z).

    Attributes:
        visible: How many numbers of a goal a policy may read.

    Raises:
        ValueError: The environment has no such goals.
    """

    visible: int

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        RecordConstructorArgs.__init__(self)
        gym.ObservationWrapper.__init__(self, env)
        space = env.observation_space
        if not isinstance(space, spaces.Dict) or not all(key in space.spaces for key in GOALS):
            raise ValueError(f"Shuffled needs an environment with goals, got the observation space {space}.")
        points = space["desired_goal"]
        if not isinstance(points, spaces.Box) or len(points.shape) != 1 or points.shape[0] % 3:
            raise ValueError(f"Shuffled needs goals of flat points (x, y, z), got {points}.")
        # The same bounds for all points, since each may be at any index.
        low, high = points.low.reshape(-1, 3), points.high.reshape(-1, 3)
        anywhere = np.tile(low.min(axis=0), len(low)), np.tile(high.max(axis=0), len(high))
        self.visible = points.shape[0]
        goal = spaces.Box(
            np.concatenate([anywhere[0], points.low]), np.concatenate([anywhere[1], points.high]), dtype=np.float32
        )
        detected = spaces.Box(*anywhere, dtype=np.float32)
        self.observation_space = spaces.Dict({"observation": detected, **dict.fromkeys(GOALS, goal)})
        self._rng = np.random.default_rng()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment; a seed restarts the shuffling."""
        if seed is not None:
            self._rng = np.random.default_rng(seed)
        return super().reset(seed=seed, options=options)

    def observation(self, observation: Any) -> dict[str, Any]:
        """Return the points shuffled, followed in the goals by the points in order."""
        achieved, desired = (np.asarray(observation[key], np.float32) for key in GOALS)
        detected, desired_shuffled = self._shuffle(achieved), self._shuffle(desired)
        return {
            "observation": detected,
            "achieved_goal": np.concatenate([detected, achieved]),
            "desired_goal": np.concatenate([desired_shuffled, desired]),
        }

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """Return the environment's own reward, of the points in order."""
        achieved, desired = (np.asarray(goal)[..., self.visible :] for goal in (achieved_goal, desired_goal))
        return self.env.get_wrapper_attr("compute_reward")(achieved, desired, info)

    def _shuffle(self, points: Vector) -> Vector:
        return self._rng.permutation(points.reshape(-1, 3)).ravel()
