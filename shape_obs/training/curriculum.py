"""Draw episodes of several difficulties in one training."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs


class Curriculum(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Draw the environment's ``difficulty`` at the start of each episode.

    Args:
        env: An environment whose ``difficulty`` can be set between episodes, such as those of ``shape_obs_envs``.
        difficulties: Difficulties to draw from; a name that occurs twice is drawn twice as often.
        after: Number of episodes after which the next difficulty is added to the first, in order. 0 draws from all
            difficulties at once.

    Attributes:
        episodes: Number of episodes that have started.

    Raises:
        ValueError: No difficulties, a negative number of episodes, or an environment without difficulties.

    Example:
        >>> env = Curriculum(gym.make("shape_obs_envs:ShapeObs/Cable-v0"), ["near", "far"])  # doctest: +SKIP
    """

    episodes: int

    def __init__(
        self, env: gym.Env[Any, Any], difficulties: Sequence[str] = ("near", "middle", "far"), after: int = 0
    ) -> None:
        self._difficulties = [str(name) for name in difficulties]
        if not self._difficulties or isinstance(difficulties, str):
            raise ValueError(f"difficulties: expected a list of names, got {difficulties!r}.")
        if after < 0:
            raise ValueError(f"after: expected a number of episodes, 0 or more, got {after}.")
        if not hasattr(env.unwrapped, "difficulty"):
            raise ValueError(f"{env.unwrapped!r} has no attribute 'difficulty' that can be set; leave Curriculum out.")
        RecordConstructorArgs.__init__(self, difficulties=self._difficulties, after=after)
        gym.Wrapper.__init__(self, env)
        self._after, self.episodes = int(after), 0
        self._rng = np.random.default_rng()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Draw a difficulty and reset the environment; a seed restarts the draws, but not the count of episodes."""
        if seed is not None:
            self._rng = np.random.default_rng(seed)
        count = len(self._difficulties)
        if self._after:
            count = min(count, 1 + self.episodes // self._after)
        drawn = self._difficulties[int(self._rng.integers(count))]
        self.env.unwrapped.difficulty = drawn  # type: ignore[attr-defined]
        self.episodes += 1
        return self.env.reset(seed=seed, options=options)

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """Return the environment's own reward."""
        return self.env.get_wrapper_attr("compute_reward")(achieved_goal, desired_goal, info)
