"""How near a policy brings the shape to its goal, in millimetres of the true points."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

Act = Callable[[Any], Any]


class Score(NamedTuple):
    """One episode.

    Attributes:
        difficulty: How far the goal was.
        seed: Of start and goal.
        start_mm: Mean distance of the true points from the true goal's, millimetres, in the beginning.
        final_mm: After the last step.
        success: Whether it is below the environment's ``success_threshold`` after the last step.
        ms: What a step took with the policy, milliseconds.
    """

    difficulty: str
    seed: int
    start_mm: float
    final_mm: float
    success: bool
    ms: float


def play(
    env: gym.Env[Any, Any], act: Act, difficulties: Sequence[str], seeds: Sequence[int], steps: int
) -> Iterator[Score]:
    """Play episodes: every seed of every difficulty.

    Args:
        env: A simulated environment as the policy knows it, with ``truth/mean_error`` in its ``info``.
        act: An action for an observation.
        difficulties: Of the environment.
        seeds: Of starts and goals.
        steps: Of an episode.
    """
    simulator: Any = env.unwrapped
    for difficulty in difficulties:
        simulator.difficulty = difficulty
        for seed in seeds:
            observation, info = env.reset(seed=seed)
            first = float(info["truth/mean_error"])
            begin = time.perf_counter()
            for _ in range(steps):
                observation, _, _, _, info = env.step(act(observation))
            ms = 1e3 * (time.perf_counter() - begin) / steps
            last = float(info["truth/mean_error"])
            reached = last < simulator.success_threshold
            yield Score(difficulty, seed, 1e3 * first, 1e3 * last, bool(reached), ms)


def success(scores: Sequence[Score]) -> float:
    """Share of the goals that were reached."""
    return float(np.mean([score.success for score in scores]))
