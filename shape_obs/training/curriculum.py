"""Curriculum: episodes of several difficulties in one training."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs


class Curriculum(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Draws the env's ``difficulty`` anew for each episode.

    Args:
        env: An environment whose ``difficulty`` may be set between episodes, as those of ``shape_obs_envs``.
        difficulties: What is drawn from; a name that stands twice is drawn twice as often.
        after: Episodes before which the first difficulty alone is played; then one more joins after each so many
            episodes, in their order. 0 draws from all of them at once.

    Attributes:
        episodes: How many have begun.

    Raises:
        ValueError: No difficulties, a negative number of episodes, or an environment without difficulties.

    Example:
        >>> env = Curriculum(gym.make("shape_obs_envs:ShapeObs/Cable-v0"), ["near", "far"])  # doctest: +SKIP
    """

    def __init__(
        self, env: gym.Env[Any, Any], difficulties: Sequence[str] = ("near", "middle", "far"), after: int = 0
    ) -> None:
        self._difficulties = [str(name) for name in difficulties]
        if not self._difficulties or isinstance(difficulties, str):
            raise ValueError(f"difficulties: expected a list of names, got {difficulties!r}.")
        if after < 0:
            raise ValueError(f"after: expected a number of episodes, 0 or more, got {after}.")
        if not hasattr(env.unwrapped, "difficulty"):
            raise ValueError(f"{env.unwrapped!r} has no 'difficulty' to be set; leave Curriculum out.")
        RecordConstructorArgs.__init__(self, difficulties=self._difficulties, after=after)
        gym.Wrapper.__init__(self, env)
        self._after, self.episodes = int(after), 0
        self._rng = np.random.default_rng()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Draw a difficulty and reset the env; a seed starts the draws anew, not the count of episodes."""
        if seed is not None:
            self._rng = np.random.default_rng(seed)
        known = len(self._difficulties)
        if self._after:
            known = min(known, 1 + self.episodes // self._after)
        drawn = self._difficulties[int(self._rng.integers(known))]
        self.env.unwrapped.difficulty = drawn  # type: ignore[attr-defined]
        self.episodes += 1
        return self.env.reset(seed=seed, options=options)

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """The env's own."""
        return self.env.get_wrapper_attr("compute_reward")(achieved_goal, desired_goal, info)
