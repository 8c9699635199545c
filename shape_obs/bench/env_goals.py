"""The goals of the simulated environments: how far they are from the start, and whether they are reached and kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from shape_obs.bench.asked import at_most
from shape_obs.bench.env_physics import warnings
from shape_obs.bench.env_runner import Env, make_env

Row = dict[str, Any]

DIFFICULTIES: Final = ("near", "middle", "far")
_REST: Final = 20  # steps after which the object should have come to rest
_FARTHEST: Final = {"near": 50, "middle": 100}  # millimetres, in every episode
_KEPT: Final = 5  # millimetres


class GoalResult(NamedTuple):
    """Goals of one difficulty, and what their own actions lead to; millimetres between corresponding points, mean.

    Args:
        env: The environment.
        difficulty: How far goals should be.
        episodes: How many.
        start_mm: From the start to the goal, mean over the episodes.
        farthest_mm: In the episode where that is most.
        played_mm: Left over after the goal's actions and a second of rest, mean over the episodes.
        worst_played_mm: In the worst episode.
        warnings: Of MuJoCo.
    """

    env: Env
    difficulty: str
    episodes: int
    start_mm: float
    farthest_mm: float
    played_mm: float
    worst_played_mm: float
    warnings: int


def goals(
    env: Env, difficulty: str, seeds: Sequence[int], tick: Callable[[int], object] = lambda done: None
) -> GoalResult:
    """Draw a goal in each episode and play the actions that lead to it, without drawing images."""
    simulated = make_env(env, {"render_observation": False, "difficulty": difficulty})
    simulator: Any = simulated.unwrapped
    starts: list[float] = []
    ends: list[float] = []
    complaints = 0
    for seed in seeds:
        _, info = simulated.reset(seed=seed)
        starts.append(1e3 * info["truth/mean_error"])
        idle = np.zeros((_REST, *simulator.action_space.shape), np.float32)
        for action in [*simulator.goal_actions, *idle]:
            *_, info = simulated.step(action)
        ends.append(1e3 * info["truth/mean_error"])
        complaints += warnings(simulator)
        tick(1)
    simulated.close()
    return GoalResult(
        env,
        difficulty,
        len(starts),
        start_mm=float(np.mean(starts)),
        farthest_mm=max(starts),
        played_mm=float(np.mean(ends)),
        worst_played_mm=max(ends),
        warnings=complaints,
    )


def asked_rows(found: Sequence[GoalResult]) -> list[Row]:
    """What is asked of goals, what was seen."""
    asked: list[Row] = []
    for each in found:
        what = f"{each.env}, {each.difficulty}"
        if each.difficulty in _FARTHEST:
            farthest = f"{what}: the farthest goal from its start"
            asked.append(at_most(farthest, _FARTHEST[each.difficulty], each.farthest_mm, " mm"))
        asked.append(at_most(f"{what}: off the worst goal after its actions", _KEPT, each.worst_played_mm, " mm"))
    return asked
